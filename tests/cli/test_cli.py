"""The command line as a person types it, in processes of its own."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from insonify.io.maps import load_map
from insonify.planning.factory import COMPARED

pytestmark = pytest.mark.slow

QUICK = ["--set", "mapping.voxel_m=0.25", "--set", "survey.waypoints=6"]


def _run(
    *arguments: str, cwd: Path, threads: int | None = None, columns: int = 80
) -> subprocess.CompletedProcess[str]:
    environment = os.environ | ({"NUMBA_NUM_THREADS": str(threads)} if threads else {})
    environment["COLUMNS"] = str(columns)
    return subprocess.run(
        [sys.executable, "-m", "insonify", *arguments],
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def _refused(done: subprocess.CompletedProcess[str], *words: str) -> None:
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    flat = " ".join(done.stderr.replace("│", " ").split())
    for word in words:
        assert word in flat


def test_ctrl_c_while_it_starts_shows_no_traceback(tmp_path: Path) -> None:
    """A stand-in for typer takes its time to be imported."""
    (tmp_path / "typer.py").write_text("open('begun', 'w').close()\nimport time\ntime.sleep(60)\n")
    with subprocess.Popen(
        [sys.executable, "-m", "insonify", "scan"],
        cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(tmp_path)},
        stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        while not (tmp_path / "begun").exists():
            assert process.poll() is None
        process.send_signal(signal.SIGINT)
        assert process.stderr is not None
        told = process.stderr.read()
    assert process.returncode == 130
    assert told == "insonify: interrupted; nothing was written\n"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["scan", "--seed", "x"], r"'--seed': .*integer.*, not 'x' \(see `insonify scan --help`\)"),
        (["scan", "--seed=x"], r", not 'x' \("),
        (["scan", "--sead", "1"], r"no such option: --sead .*--seed"),
        (["sacn"], r"no such command 'sacn'.*'scan'.*\(see `insonify --help`\)"),
        (["map"], r"missing argument 'RECORDING"),
    ],
)
def test_a_wrong_command_line_is_one_sentence(words: list[str], told: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "insonify", *words], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2 and done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert re.match(rf"insonify: .*{told}", line), line


def test_scan_writes_everything_and_the_config_runs_again(tmp_path: Path) -> None:
    first = _run("scan", "tetrapod", *QUICK, "--seed", "4", "--out", "a", "--json", cwd=tmp_path)
    assert first.returncode == 0, first.stderr
    assert {p.name for p in (tmp_path / "a").iterdir()} == {
        "result.json",
        "config.toml",
        "map.npz",
        "map.ply",
        "report.html",
        "decisions.npz",
        "truth.npz",
        "recording.mcap",
        "foxglove.json",
    }
    result = json.loads(first.stdout)
    assert result == json.loads((tmp_path / "a/result.json").read_text())
    assert {"scenario", "planner", "mapper", "seed", "scans", "pings", "path_m"} <= set(result)
    assert {"stop_reason", "metrics", "history", "seconds"} <= set(result)
    assert set(result["seconds"]) == {"setup", "sonar", "mapping", "planning"}
    assert len(result["history"]) == result["scans"]
    for kind in ("surface", "solid"):
        for match in ("exact", "within_one_voxel"):
            assert set(result["metrics"][kind][match]) == {"precision", "recall", "f1", "f2", "f3"}
    assert load_map(tmp_path / "a/map.npz").voxel_m == 0.25

    again = _run(
        "scan", "--config", "a/config.toml", "--out", "b", "--json", cwd=tmp_path, threads=1
    )
    assert again.returncode == 0, again.stderr
    repeated = json.loads(again.stdout)
    assert repeated | {"seconds": 0} == result | {"seconds": 0}
    for name in ("map.npz", "map.ply", "config.toml", "recording.mcap"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_scan_of_ones_own_mesh_with_a_table_for_people(tmp_path: Path) -> None:
    trimesh.creation.icosphere(radius=1.2).export(tmp_path / "ball.glb")
    mesh = ["--object", "ball.glb"]
    done = _run("scan", "tetrapod", *mesh, "--planner", "uniform", *QUICK, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "precision" in done.stdout and "All planned scans are flown." in done.stdout
    assert (tmp_path / "insonify-runs/tetrapod-uniform-seed0/report.html").is_file()
    assert "report.html" in done.stderr


def test_compare_prints_the_runs_and_the_papers_figures(tmp_path: Path) -> None:
    done = _run("compare", "tetrapod", "--seeds", "2", *QUICK, "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert len(document["runs"]) == 10
    for seed in (0, 1):
        runs = [run for run in document["runs"] if run["seed"] == seed]
        assert tuple(run["planner"] for run in runs) == COMPARED
        assert len({(run["scans"], run["pings"]) for run in runs}) == 1
    table = document["table"]["tetrapod"]
    assert table["entropy"]["paper"]["f1"] == 0.527
    f1 = [
        r["metrics"]["solid"]["exact"]["f1"] for r in document["runs"] if r["planner"] == "uniform"
    ]
    figure = table["uniform"]["solid"]["exact"]["f1"]
    assert figure["mean"] == pytest.approx(np.mean(f1))
    # Student's t for two values: 12.706 standard errors
    assert figure["ci95"] == pytest.approx(12.7062 * abs(f1[0] - f1[1]) / 2, rel=1e-4)
    people = _run("compare", "tetrapod", "--seeds", "1", *QUICK, cwd=tmp_path)
    assert people.returncode == 0 and "0.527" in people.stdout
    assert "surface" in people.stdout and "recall" not in people.stdout
    assert max(map(len, people.stdout.splitlines())) <= 80
    every = _run("compare", "tetrapod", "--seeds", "1", "--all", *QUICK, cwd=tmp_path)
    assert every.returncode == 0 and "recall" in every.stdout and "0.811" in every.stdout
    assert max(map(len, every.stdout.splitlines())) <= 80 and "…" not in every.stdout


@pytest.mark.parametrize("columns", [60, 80])
def test_tables_fit(columns: int, tmp_path: Path) -> None:
    one = [*QUICK, "--set", "survey.baseline_scans=1"]
    commands = (
        ["scan", "tetrapod", *one, "--planner", "uniform", "--out", "s"],
        ["compare", "tetrapod", *one, "--planner", "lawnmower-near", "--seeds", "2"],
        ["plan", "s", "--from", "0 9 -14 -90", "--set", "entropy.termination=0", "--out", "p"],
        ["info", "s/recording.mcap"],
    )
    for command in commands:
        done = _run(*command, cwd=tmp_path, columns=columns)
        assert done.returncode == 0, done.stderr
        tables = [line for line in done.stdout.splitlines() if line[:1] in " ┏┃┡│└"]
        assert len(tables) > 4, command
        assert max(map(len, tables)) <= columns and "…" not in done.stdout, command


@pytest.mark.parametrize("command", ["scenarios", "sonars"])
def test_listings(command: str, tmp_path: Path) -> None:
    rows = json.loads(_run(command, "--json", cwd=tmp_path).stdout)
    assert isinstance(rows, list) and rows
    done = _run(command, cwd=tmp_path)
    assert done.returncode == 0
    assert all(row["name"] in done.stdout for row in rows)


def test_printed_config_is_taken_back(tmp_path: Path) -> None:
    printed = _run("config", "wreck", cwd=tmp_path).stdout
    (tmp_path / "c.toml").write_text(printed)
    again = _run("config", "wreck", "--config", "c.toml", cwd=tmp_path)
    assert again.stdout == printed
    document = json.loads(_run("config", "wreck", "--json", cwd=tmp_path).stdout)
    assert document["survey"]["altitude_m"] == 8.0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["scan", "nonesuch"], ["no scenario named 'nonesuch'"]),
        (["scan"], ["name a scenario"]),
        (["scan", "tetrapod", "--planner", "random"], ["lawnmower", "random"]),
        (["scan", "tetrapod", "--sonar", "asdic"], ["asdic", "insonify sonars"]),
        (["scan", "tetrapod", "--object", "none.stl"], ["none.stl", "no such mesh"]),
        (["scan", "tetrapod", "--set", "mapping.voxels=1"], ["mapping.voxels"]),
        (["scan", "tetrapod", "--set", "mapping.voxel_m=-0.1"], ["mapping.voxel_m", "-0.1"]),
        (["scan", "tetrapod", "--set", "mapping.voxel_m=0.0005"], ["GB", "fit"]),
        (["scan", "tetrapod", "--set", "entropy.candidates=0"], ["entropy.candidates"]),
        (["scan", "tetrapod", "--set", "survey.altitude_m=1"], ["altitude_m"]),
        (["scan", "tetrapod", "--config", "none.toml"], ["none.toml"]),
        (["scan", "tetrapod", "--out", "taken"], ["taken", "--force"]),
        (["scan", "tetrapod", "--out", "file/below"], ["cannot be written"]),
        (["scan", "tetrapod", "--out", "new/" + 300 * "x"], ["cannot be written", "too long"]),
        (["scan", "tetrapod", "--seed", "x"], ["seed"]),
        (["compare", "tetrapod", "nonesuch"], ["nonesuch"]),
        (["compare", "tetrapod", "--seeds", "0"], ["seeds"]),
        (["config", "nonesuch"], ["nonesuch"]),
        (["dance"], ["dance"]),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_2(
    tmp_path: Path, arguments: list[str], words: list[str]
) -> None:
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken/mine").write_text("precious")
    (tmp_path / "file").write_text("")
    _refused(_run(*arguments, cwd=tmp_path), *words)
    left = {p.name for p in tmp_path.rglob("*")} - {"insonify-runs"}
    assert left == {"taken", "mine", "file"}


def test_a_warning_is_a_sentence_too(tmp_path: Path) -> None:
    coarse = ["--set", "sampling.over_elevation=8", "--planner", "uniform"]
    done = _run("scan", "tetrapod", *QUICK, *coarse, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "insonify: warning: sampling.over_elevation=8 is too coarse" in done.stderr
    assert ".py" not in done.stderr


def test_force_replaces_results_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/mine").write_text("precious")
    (tmp_path / "out/result.json").write_text("old")
    into = ["--planner", "uniform", "--out", "out", "--force"]
    done = _run("scan", "tetrapod", *QUICK, *into, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out/mine").read_text() == "precious"
    assert json.loads((tmp_path / "out/result.json").read_text())["planner"] == "uniform"


def test_ctrl_c_ends_cleanly_and_keeps_what_is_complete(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", _ANNOUNCING, "scan", "tetrapod", "--out", "out"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    while "PING 50" not in process.stderr.readline():
        assert process.poll() is None
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=120)
    assert process.returncode == 130, error
    assert "Traceback" not in error
    result = json.loads((tmp_path / "out/result.json").read_text())
    assert result["stop_reason"] == "interrupted"
    assert 50 <= result["pings"] < 120
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


_ANNOUNCING = """
import sys, time
import insonify.mission.run
from insonify.cli import main
from insonify.mission.loop import Pinged
note = insonify.mission.run._note_ping
def announce(run, step):
    note(run, step)
    print("PING", run.pings, file=sys.stderr, flush=True)
    time.sleep(0.02)
insonify.mission.run._note_ping = announce
main()
"""


@pytest.mark.parametrize(
    ("model", "how"),
    [
        ("cerqueira", [signal.SIGKILL]),
        ("physical", [signal.SIGKILL]),
        ("cerqueira", [signal.SIGINT]),
        ("cerqueira", [signal.SIGINT, signal.SIGINT]),
    ],
)
def test_a_scan_that_was_broken_off_goes_on_where_it_was_with_the_same_result(
    model: str, how: list[signal.Signals], tmp_path: Path
) -> None:
    quick = ["--set", "mapping.voxel_m=0.25", "--set", "survey.waypoints=12"]
    quick += ["--set", f"model={model}", "--set", "survey.approach_m=1.0"]
    scan = ["scan", "tetrapod", *quick, "--json"]
    whole = _run(*scan, "--out", "whole", cwd=tmp_path)
    assert whole.returncode == 0, whole.stderr
    process = subprocess.Popen(
        [sys.executable, "-c", _ANNOUNCING, *scan, "--out", "out"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    while "PING 20" not in process.stderr.readline():
        assert process.poll() is None
    for number, one in enumerate(how):
        if number > 0:
            assert "the same command" in process.stderr.readline()
        process.send_signal(one)
    process.communicate(timeout=120)
    assert process.returncode == (-9 if how == [signal.SIGKILL] else 130)
    left = list(tmp_path.glob(".out-*"))
    assert (len(left), (tmp_path / "out").exists()) == (
        (0, True) if how == [signal.SIGINT] else (1, False)
    )
    again = _run(*scan, "--out", "out", cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    (pings,) = re.findall(r"going on after the (\d+) pings", again.stderr)
    assert 8 <= int(pings) <= 23
    assert not list(tmp_path.glob(".out-*"))
    first, second = json.loads(whole.stdout), json.loads(again.stdout)
    assert first | {"seconds": 0} == second | {"seconds": 0}
    for name in ("map.npz", "map.ply", "config.toml", "recording.mcap"):
        same = (tmp_path / "whole" / name).read_bytes() == (tmp_path / "out" / name).read_bytes()
        assert same, name


def test_ctrl_c_before_the_first_ping_leaves_nothing(tmp_path: Path) -> None:
    code = "import signal; signal.raise_signal(signal.SIGINT)"
    program = (
        f"from insonify.cli import main, scans\nscans.configure = lambda *a: exec({code!r})\nmain()"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, "scan", "tetrapod", "--out", "out"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 130
    assert "Traceback" not in done.stderr and "nothing was written" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_help_names_the_commands_and_needs_no_heavy_library(tmp_path: Path) -> None:
    done = _run("--help", cwd=tmp_path)
    assert done.returncode == 0
    for command in ("scan", "compare", "scenarios", "sonars", "config"):
        assert command in done.stdout
    code = (
        "import sys; from insonify.cli import app\n"
        "heavy = {'numpy', 'numba', 'scipy', 'trimesh', 'matplotlib', 'pydantic'}\n"
        "sys.exit(', '.join(heavy & set(sys.modules)) or None)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
