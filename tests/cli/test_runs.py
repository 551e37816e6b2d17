"""`runs`: what lies in a folder of results, and what is cleared."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest


def _run(
    *arguments: str, cwd: Path, typed: str = "", columns: int = 80
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "insonify", *arguments],
        cwd=cwd, capture_output=True, text=True, check=False, input=typed,
        env=os.environ | {"COLUMNS": str(columns)},
    )  # fmt: skip


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two runs of one scan, one of another seed, what is no result, and what is damaged."""
    folder = tmp_path_factory.mktemp("runs")
    quick = [
        "--planner",
        "uniform",
        "--set",
        "survey.baseline_scans=1",
        "--set",
        "survey.waypoints=4",
    ]
    quick += ["--set", "mapping.voxel_m=0.5"]
    for seed in ("0", "0", "1"):
        done = _run("scan", "tetrapod", *quick, "--seed", seed, cwd=folder)
        assert done.returncode == 0, done.stderr
    assert "insonify-runs/tetrapod-uniform-seed1 takes" in done.stderr
    (folder / "insonify-runs/own").mkdir()
    (folder / "insonify-runs/damaged").mkdir()
    (folder / "insonify-runs/damaged/result.json").write_text("{")
    for age, name in enumerate(("seed1", "seed0-2", "seed0")):
        file = folder / f"insonify-runs/tetrapod-uniform-{name}/result.json"
        os.utime(file, (file.stat().st_mtime - 100 * age,) * 2)
    return folder


@pytest.fixture
def copied(place: Path, tmp_path: Path) -> Path:
    """The same, to be changed."""
    shutil.copytree(place, tmp_path / "c")
    return tmp_path / "c"


def test_results_are_listed_with_size_age_and_figures(place: Path) -> None:
    done = _run("runs", "--json", cwd=place)
    rows = {row["name"]: row for row in json.loads(done.stdout)}
    assert set(rows) == {
        "damaged", "tetrapod-uniform-seed0", "tetrapod-uniform-seed0-2", "tetrapod-uniform-seed1"
    }  # fmt: skip
    folder = place / "insonify-runs/tetrapod-uniform-seed1"
    row = rows["tetrapod-uniform-seed1"]
    assert row["bytes"] == sum(file.stat().st_size for file in folder.iterdir())
    f1 = json.loads((folder / "result.json").read_text())["metrics"]["solid"]["exact"]["f1"]
    assert row["figures"].startswith(f"F1 {f1:.3f}, 4 pings")
    assert rows["damaged"]["figures"] == "cannot be read"


@pytest.mark.parametrize("columns", [60, 80])
def test_the_table_fits(place: Path, columns: int) -> None:
    done = _run("runs", cwd=place, columns=columns)
    assert max(map(len, done.stdout.splitlines())) <= columns
    assert "tetrapod-uniform-seed0-2" in done.stdout
    assert "4 results" in done.stderr


def test_only_older_runs_of_the_same_config_are_cleared_and_only_if_one_says_so(
    copied: Path,
) -> None:
    folder = copied / "insonify-runs"
    before = {path.name for path in folder.iterdir()}
    refused = _run("runs", "--prune", cwd=copied, typed="n\n")
    assert refused.returncode != 0 and {path.name for path in folder.iterdir()} == before
    done = _run("runs", "--prune", "--yes", "--json", cwd=copied)
    assert json.loads(done.stdout) == {"removed": ["tetrapod-uniform-seed0"]}
    assert {path.name for path in folder.iterdir()} == before - {"tetrapod-uniform-seed0"}
    again = _run("runs", "--prune", cwd=copied)
    assert again.returncode == 0 and "Nothing" in again.stdout


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    done = _run("runs", "none", cwd=tmp_path)
    assert done.returncode == 2 and "none" in done.stderr and "Traceback" not in done.stderr
