"""Commands that fly a vehicle, as a person types them."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

from insonify.cli.vehicles import wall_clock

pytestmark = pytest.mark.slow

QUICK = ["--planner", "uniform", "--set", "survey.baseline_scans=1", "--set",
         "survey.approach_m=1", "--set", "mapping.voxel_m=0.25"]  # fmt: skip


def _run(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    program = [sys.executable, "-m", "insonify", *arguments]
    return subprocess.run(program, cwd=cwd, capture_output=True, text=True, check=False)


def test_a_flown_scan_writes_its_track_and_its_config_flies_again(tmp_path: Path) -> None:
    flown = ["--vehicle", "bluerov2", "--current", "0.1 0 0", *QUICK]
    first = _run("scan", "tetrapod", *flown, "--out", "a", "--json", cwd=tmp_path)
    assert first.returncode == 0, first.stderr
    result = json.loads(first.stdout)
    assert result["vehicle"]["name"] == "bluerov2"
    with (tmp_path / "a/trajectory.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert float(rows[-1]["time_s"]) == pytest.approx(result["vehicle"]["time_s"], abs=0.3)
    assert "[vehicle.current]" in (tmp_path / "a/config.toml").read_text()
    again = _run("scan", "--config", "a/config.toml", "--out", "b", cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    assert "Mapped at the true poses" in again.stdout
    for name in ("map.npz", "trajectory.csv", "config.toml"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_navigations_compared(tmp_path: Path) -> None:
    quick = [*QUICK[2:], "--set", "planner=uniform"]
    arguments = ["compare", "tetrapod", "--vehicle", "bluerov2", "--seeds", "2", *quick]
    done = _run(*arguments, "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert len(document["runs"]) == 4
    by = document["table"]["tetrapod"]
    key = "solid f1, exact"
    cost = by["dvl"][key]["mean"] - by["truth"][key]["mean"]
    assert by["cost"][key]["mean"] == pytest.approx(cost)
    error = "largest position error, m"
    assert by["truth"][error]["mean"] == 0.0 < by["dvl"][error]["mean"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["scan", "tetrapod", "--vehicle", "submarine"], ["'submarine'", "bluerov2"]),
        (["scan", "tetrapod", "--vehicle", "none.toml"], ["none.toml", "no such vehicle file"]),
        (["scan", "tetrapod", "--vehicle", "bad.toml"], ["bad.toml", "cannot be read as TOML"]),
        (["scan", "tetrapod", "--vehicle", "bluerov2", "--current", "nan 0 0"], ["finite", "nan"]),
        (["scan", "tetrapod", "--vehicle", "bluerov2", "--current", "1 0"], ["three numbers"]),
        (["scan", "tetrapod", "--current", "1 0 0"], ["--current needs a vehicle"]),
        (["scan", "tetrapod", "--real-time"], ["--real-time needs a vehicle"]),
        (["scan", "tetrapod", "--vehicle", "bluerov2", "--navigation", "gps"], ["'truth'", "gps"]),
        (["scan", "tetrapod", "--set", "vehicle.ping_hz=0"], ["vehicle.ping_hz", "0"]),
        (["compare", "tetrapod", "--current", "1 0 0"], ["--current needs a vehicle"]),
        (["compare", "tetrapod", "--vehicle", "submarine"], ["'submarine'"]),
        (["fly", "tank"], ["--waypoints"]),
        (["fly", "tank", "--waypoints", "0 0 0; 1 x 0"], ["--waypoints", "1 x 0"]),
        (["fly", "nowhere", "--waypoints", "0 0 0; 1 1 0"], ["nowhere"]),
    ],
)
def test_bad_input_is_one_sentence(tmp_path: Path, arguments: list[str], words: list[str]) -> None:
    (tmp_path / "bad.toml").write_text("mass_kg = = 3")
    done = _run(*arguments, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr and done.stdout == ""
    for word in words:
        assert word in done.stderr


def test_vehicles_are_listed_with_their_sources(tmp_path: Path) -> None:
    rows = json.loads(_run("vehicles", "--json", cwd=tmp_path).stdout)
    assert {"bluerov2", "cyclops", "rexrov2"} <= {row["name"] for row in rows}
    assert all("Assumed" in row["source"] or "letter" in row["source"] for row in rows)
    assert "rexrov2" in _run("vehicles", cwd=tmp_path).stdout


def test_the_wall_clock_makes_each_tick_wait_for_its_time() -> None:
    wait = wall_clock()
    start = time.monotonic()
    for tick in range(1, 6):
        wait(5.0 + 0.02 * tick)
    assert time.monotonic() - start >= 0.079
