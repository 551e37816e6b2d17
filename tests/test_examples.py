"""The examples, run as they stand."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import trimesh
import xarray
from PIL import Image

from insonify import load_map

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
EXAMPLES = sorted(path.name for path in (ROOT / "examples").glob("*.py"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("examples")


def _run(name: str, folder: Path) -> str:
    command = [sys.executable, "-W", "error", str(ROOT / "examples" / name), str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def _number(text: str, pattern: str) -> float:
    found = re.search(pattern, text)
    assert found, f"{pattern} is not in {text}"
    return float(found[1])


def test_there_is_one_for_each_subject() -> None:
    subjects = ("first_ping", "first_scan", "own_sonar", "own_planner", "own_recording", "dataset",
                "vehicle", "own_mapper", "campaign", "gym", "load_pings")  # fmt: skip
    assert [f"{k:02d}_{subject}.py" for k, subject in enumerate(subjects, 1)] == EXAMPLES


def test_first_ping(folder: Path) -> None:
    said = _run("01_first_ping.py", folder)
    # the tetrapod stands at the origin, 8 m ahead, and is some 4 m across
    assert 5.0 < _number(said, r"tetrapod from ([\d.]+) m") < 8.0
    assert len(np.unique(np.asarray(Image.open(folder / "first-ping.png")))) > 50


def test_first_scan(folder: Path) -> None:
    said = _run("02_first_scan.py", folder)
    scores = [float(score) for score in re.findall(r"F1 ([\d.]+)", said)]
    assert len(scores) >= 2 and scores[-1] > scores[0] > 0.3
    assert (load_map(folder / "first-scan.bt").log_odds > 0).sum() > 1000
    assert (folder / "first-scan.html").stat().st_size > 100_000


def test_own_sonar(folder: Path) -> None:
    said = _run("03_own_sonar.py", folder)
    assert _number(said, r"my sonar: ([\d.]+) degrees") == pytest.approx(70.0 / 128, abs=0.005)
    assert _number(said, r"([\d.]+) cm a bin") == pytest.approx(100 * 11.5 / 600, abs=0.05)
    assert len(list(folder.glob("own-sonar-*.png"))) == 2


def test_own_planner(folder: Path) -> None:
    said = _run("04_own_planner.py", folder)
    assert re.search(r"least known side: 3 scans, \d+ m, solid F1 0\.[4-9]", said)
    assert re.search(r"entropy: \d scans, \d+ m, solid F1 0\.[4-9]", said)


def test_own_recording(folder: Path) -> None:
    said = _run("05_own_recording.py", folder)
    assert "NumPy arrays: 30 pings" in said
    assert _number(said, r"along ([\d.]+) m") == pytest.approx(5.0)
    assert _number(said, r"(\d+) occupied voxels") > 1000
    scene = trimesh.load_scene(folder / "dive.glb")
    assert 1.0 < scene.extents.max() < 40.0


def test_dataset(folder: Path) -> None:
    said = _run("06_dataset.py", folder)
    views = xarray.open_zarr(folder / "views" / "dataset.zarr")
    label = views.attrs["labels"].index("manifold")
    pixels = int((views.label == label).sum())
    assert f"{pixels} pixels" in said.splitlines()[0]


def test_vehicle(folder: Path) -> None:
    said = _run("07_vehicle.py", folder)
    assert 10.0 < _number(said, r"flew (\d+) m") < 300.0
    assert 0.0 < _number(said, r"off by ([\d.]+) m") < 1.0
    assert _number(said, r"solid F1 ([\d.]+),") > 0.3
    assert (folder / "vehicle.html").is_file()


def test_own_mapper(folder: Path) -> None:
    said = _run("08_own_mapper.py", folder)
    scores = [float(score) for score in re.findall(r": \d scans, solid F1 ([\d.]+)", said)]
    assert len(scores) == 2 and min(scores) > 0.4


def test_campaign(folder: Path) -> None:
    said = _run("09_campaign.py", folder)
    assert 0.3 < _number(said, r"after one scan: F1 ([\d.]+)") < 0.9
    assert len(re.findall(r"^entropy - uniform: F1 [+-]0\.\d+, p [\d.]+", said, re.M)) == 2
    assert len(re.findall(r"^bayes - Despeckled: ", said, re.M)) == 2
    assert (folder / "campaign/report.html").is_file()


def test_gym(folder: Path) -> None:
    said = _run("10_gym.py", folder)
    scores = [float(score) for score in re.findall(r"solid F1 ([\d.]+) after 60 pings", said)]
    assert len(scores) == 3 and scores[2] > scores[0] and scores[2] > 0.5
    assert len(re.findall(r"[\d.]+ steps/s", said)) == 3


@pytest.mark.parametrize(
    ("option", "plugin", "key"),
    [
        ("--planner", "04_own_planner.py:LeastKnownSide", "planner"),
        ("--mapper", "08_own_mapper.py:Despeckled", "mapper"),
    ],
)
def test_own_parts_run_from_the_command_line(
    option: str, plugin: str, key: str, tmp_path: Path
) -> None:
    quick = ["--set", "mapping.voxel_m=0.25", "--set", "survey.waypoints=6"]
    named = [option, str(ROOT / "examples" / plugin), "--out", "run"]
    command = [sys.executable, "-m", "insonify", "scan", "tetrapod", *quick, *named]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stderr
    config = tomllib.loads((tmp_path / "run/config.toml").read_text())
    assert config[key] == str(ROOT / "examples" / plugin)


def test_load_pings(folder: Path) -> None:
    said = _run("11_load_pings.py", folder)
    assert said.count("the strongest echo is") == 3
    assert 1.0 < _number(said, r"strongest echo is ([\d.]+) m away") < 8.0
    assert _number(said, r"floor: (\d+) pixels") > 1000
