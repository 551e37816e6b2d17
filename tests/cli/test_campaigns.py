"""Campaigns as a person starts, kills and asks them, in processes of their own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

CAMPAIGN = """
title = "Small"
seeds = 4
scenarios = ["tetrapod"]
planners = ["uniform", "entropy", "lawnmower"]
[set]
mapping.voxel_m = 0.25
survey.waypoints = 6
"""
RUNS = 12
TABLES = ("runs.parquet", "curves.parquet")
OWN = """
import os, signal
from insonify.planning.baselines import UniformPlanner

class Fickle(UniformPlanner):
    name = "fickle"

    def __init__(self, area, geometry):
        super().__init__(area, 1)

    def next_scan(self, belief, nav):
        how = os.environ.get("FICKLE")
        if how == "killed":
            os.kill(os.getpid(), signal.SIGKILL)
        if how == "raises":
            raise IndexError("no way from here")
        return super().next_scan(belief, nav)
"""


def _run(*words: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "insonify", *words],
        cwd=cwd, env=os.environ | environment, capture_output=True, text=True, timeout=300,
        check=False,
    )  # fmt: skip


def _tables(folder: Path) -> list[bytes]:
    return [(folder / name).read_bytes() for name in TABLES]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where a campaign was flown into ``whole``, by one process without a break."""
    folder = tmp_path_factory.mktemp("campaign")
    (folder / "c.toml").write_text(CAMPAIGN)
    done = _run("campaign", "c.toml", "--workers", "1", "--out", "whole", "--json", cwd=folder)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert (told["runs"], told["planned"], told["failed"]) == (RUNS, RUNS, 0)
    assert told == json.loads((folder / "whole/result.json").read_text())
    return folder


def _broken_off(place: Path, out: str, number: signal.Signals) -> subprocess.Popen[str]:
    """A campaign that is sent a signal as soon as some runs are complete."""
    process = subprocess.Popen(
        [sys.executable, "-m", "insonify", "campaign", "c.toml", "--workers", "2", "--out", out],
        cwd=place, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    while len(list((place / out / "parts").glob("*.parquet"))) < 2:
        assert process.poll() is None, process.stderr
        time.sleep(0.02)
    process.send_signal(number)
    return process


def test_killed_and_gone_on_with_it_gives_the_same_table(place: Path) -> None:
    process = _broken_off(place, "killed", signal.SIGKILL)
    process.communicate()
    there = {file: file.stat().st_mtime_ns for file in (place / "killed/parts").iterdir()}
    assert 2 <= len(there) < RUNS
    assert not (place / "killed/runs.parquet").exists()
    asked = _run("results", "killed", "--sql", "select count(*) from runs", "--json", cwd=place)
    parts = [file for file in there if file.suffix == ".parquet"]
    assert json.loads(asked.stdout) == [{"count_star()": len(parts)}]
    again = _run("campaign", "killed", "--workers", "2", cwd=place)
    assert again.returncode == 0, again.stderr
    assert _tables(place / "killed") == _tables(place / "whole")
    assert {file: file.stat().st_mtime_ns for file in there} == there


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_asked_to_stop_it_keeps_what_is_complete(place: Path, number: signal.Signals) -> None:
    process = _broken_off(place, number.name, number)
    _, told = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in told and "what is complete is kept" in told
    parts = list((place / number.name / "parts").iterdir())
    assert 2 <= len(parts) < RUNS
    assert f"interrupted after {len(parts)} of {RUNS} runs" in told
    result = json.loads((place / number.name / "result.json").read_text())
    assert (result["runs"], result["planned"]) == (len(parts), RUNS)


CLUSTER = """
import logging, subprocess, sys, time
from pathlib import Path
from distributed import LocalCluster

if __name__ == "__main__":
    out, *words = sys.argv[1:]
    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=logging.CRITICAL
    ) as cluster:
        flown = subprocess.Popen(
            [sys.executable, "-m", "insonify", "campaign", "c.toml", "--out", out,
             "--scheduler", cluster.scheduler_address]
        )
        while "leave" in words and len(list(Path(out).glob("parts/*.parquet"))) < 2:
            time.sleep(0.02)
        if "leave" not in words:
            flown.wait()
    sys.exit(flown.wait())
"""


def _on_a_cluster(*words: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """A campaign on two worker processes of Dask."""
    (cwd / "cluster.py").write_text(CLUSTER)
    return subprocess.run(
        [sys.executable, "cluster.py", *words],
        cwd=cwd, env=os.environ | environment, capture_output=True, text=True, timeout=300,
        check=False,
    )  # fmt: skip


def test_a_dask_cluster_gives_the_same_table(place: Path) -> None:
    done = _on_a_cluster("dask", cwd=place)
    assert done.returncode == 0, done.stderr
    assert _tables(place / "dask") == _tables(place / "whole")


def test_a_cluster_that_goes_away_is_one_sentence_and_what_is_complete_is_kept(place: Path) -> None:
    done = _on_a_cluster("lost", "leave", cwd=place)
    assert done.returncode == 2
    lines = [line for line in done.stderr.splitlines() if line.startswith("insonify: ")]
    assert len(lines) == 1 and "the connection was lost; what is complete is kept" in lines[0]
    assert 2 <= len(list((place / "lost/parts").iterdir())) < RUNS


def test_a_run_that_kills_every_worker_of_a_cluster_fails_alone(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(OWN)
    own = CAMPAIGN.replace('"entropy"', '"own.py:Fickle"').replace("seeds = 4", "seeds = 1")
    (tmp_path / "c.toml").write_text(own)
    done = _on_a_cluster("o", cwd=tmp_path, FICKLE="killed")
    assert done.returncode == 1, done.stderr
    assert "1 of 3 runs failed: the workers that had it died" in done.stderr
    assert len(list((tmp_path / "o/parts").iterdir())) == 2


@pytest.mark.parametrize(
    ("how", "words", "traced"),
    [
        ("raises", "IndexError: no way from here", True),
        ("killed", "was killed (signal 9), most likely for want of memory", False),
    ],
)
def test_a_run_that_fails_is_recorded_and_the_others_are_flown(
    tmp_path: Path, how: str, words: str, traced: bool
) -> None:
    (tmp_path / "own.py").write_text(OWN)
    own = CAMPAIGN.replace('"entropy"', '"own.py:Fickle"').replace("seeds = 4", "seeds = 1")
    (tmp_path / "c.toml").write_text(own)
    command = ("campaign", "c.toml", "--workers", "2", "--out", "o")
    done = _run(*command, cwd=tmp_path, FICKLE=how)
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert "1 of 3 runs failed: " in done.stderr and words in done.stderr
    (record,) = (tmp_path / "o/failed").iterdir()
    told = json.loads(record.read_text())
    assert told["planner"] == f"{tmp_path}/own.py:Fickle" and told["seed"] == 0
    assert words in told["message"] and ("own.py" in told["traceback"]) == traced
    assert words in (tmp_path / "o/report.html").read_text()
    rows = _run("results", "o", "--sql", "select planner from runs", "--json", cwd=tmp_path)
    assert json.loads(rows.stdout) == [{"planner": "uniform"}, {"planner": "lawnmower"}]
    again = _run(*command, cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    assert not (tmp_path / "o/failed").exists()
    assert len(list((tmp_path / "o/parts").iterdir())) == 3


def test_results_for_people_and_programs(place: Path) -> None:
    people = _run("results", "whole", cwd=place)
    assert people.returncode == 0, people.stderr
    assert "tetrapod, park-2025, cerqueira, none" in people.stdout and "lawnmower" in people.stdout
    rows = json.loads(_run("results", "whole", "--json", cwd=place).stdout)
    assert [row["planner"] for row in rows] == ["entropy", "uniform", "lawnmower"]
    sql = "select planner, avg(solid_exact_f1) as f1, max(seed) as seed from runs group by 1"
    asked = json.loads(_run("results", "whole", "--sql", sql, "--json", cwd=place).stdout)
    for row in rows:
        (same,) = (one for one in asked if one["planner"] == row["planner"])
        assert same["f1"] == pytest.approx(row["solid_exact_f1"]["mean"])
        assert same["seed"] == 3
    table = _run("results", "whole", "--sql", "select scan, pings from curves limit 1", cwd=place)
    assert "pings" in table.stdout and " 6 " in table.stdout


def test_report_is_made_again(place: Path) -> None:
    before = (place / "whole/report.html").read_bytes()
    done = _run("report", "whole", "--out", "again.html", cwd=place)
    assert done.returncode == 0, done.stderr
    assert (place / "again.html").read_bytes() == before


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["campaign", "none.toml"], ["none.toml", "no such campaign file"]),
        (["campaign", "bad.toml"], ["bad.toml", "scenario", "did you mean 'scenarios'"]),
        (["campaign", "c.toml", "--set", "survey.waypoint=3"], ["did you mean 'survey.waypoints'"]),
        (["campaign", "c.toml", "--workers", "0"], ["--workers"]),
        (["campaign", "c.toml", "--out", "taken"], ["taken", "no campaign", "--out"]),
        (["campaign", "c.toml", "--out", "c.toml/below"], ["cannot be written"]),
        (["campaign", "c.toml", "--workers", "2", "--scheduler", "x"], ["give one"]),
        (["campaign", "c.toml", "--scheduler", "tcp://127.0.0.1:9"], ["127.0.0.1:9", "answers"]),
        (["results", "taken"], ["taken", "no folder of a campaign"]),
        (["results", "none"], ["none", "no folder of a campaign"]),
        (["results", "whole", "--sql", "selec 1"], ["--sql", "selec", "runs, curves, seconds"]),
        (["results", "whole", "--sql", "select f1 from runs"], ["f1", "`describe runs`"]),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_2(
    place: Path, words: list[str], told: list[str]
) -> None:
    (place / "bad.toml").write_text('scenario = ["tetrapod"]')
    (place / "taken").mkdir(exist_ok=True)
    (place / "taken/mine").write_text("precious")
    before = _tables(place / "whole")
    done = _run(*words, cwd=place)
    assert (done.returncode, done.stdout) == (2, ""), done.stderr
    assert "Traceback" not in done.stderr
    for word in told:
        assert word in done.stderr
    assert _tables(place / "whole") == before
    assert [file.name for file in (place / "taken").iterdir()] == ["mine"]


def test_compare_in_processes_gives_the_same_rows(tmp_path: Path) -> None:
    quick = ["--set", "mapping.voxel_m=0.25", "--set", "survey.waypoints=6", "--json"]
    told = []
    for workers in ("1", "2"):
        command = ["compare", "tetrapod", "--seeds", "2", "--workers", workers, *quick]
        done = _run(*command, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        document = json.loads(done.stdout)
        assert all(run.pop("seconds") for run in document["runs"])
        told.append(document)
    assert told[0] == told[1]
