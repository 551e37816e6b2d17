"""``insonify explain`` as a person types it."""

from __future__ import annotations

import json
import math
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from insonify.cli import app
from insonify.errors import InsonifyError
from insonify.io.maps import load_map
from insonify.io.recordings.arrays import save_arrays
from insonify.mapping.voxels import SURFACE
from insonify.types import FanGeometry, Ping, Pose, PosedPing

pytestmark = pytest.mark.slow

QUICK = ["--planner", "uniform", "--set", "survey.baseline_scans=2", "--set",
         "mapping.voxel_m=0.25", "--set", "survey.waypoints=6"]  # fmt: skip


def _run(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "insonify", *words]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)


def _call(*words: str) -> str:
    done = CliRunner().invoke(app, list(words), catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


def _told(*words: str) -> dict[str, Any]:
    told = json.loads(_call("explain", *words, "--json"))
    assert isinstance(told, dict)
    return told


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scan by each mapper, and a dive mapped of two recordings, in a folder."""
    folder = tmp_path_factory.mktemp("explain")
    for mapper in ("bayes", "carving"):
        _call("scan", "tetrapod", "--mapper", mapper, *QUICK, "--out", str(folder / mapper))
    rng = np.random.default_rng(3)
    fan = FanGeometry(0.7, 0.2, 8, 16, 0.2, 2.0)
    pings = [
        PosedPing(
            Ping((rng.random((16, 8)) > 0.9).astype(np.float32), fan, float(k)),
            Pose(0.0, 0.1 * k, -2.0),
        )
        for k in range(8)
    ]
    save_arrays(folder / "a.npz", pings[:5])
    save_arrays(folder / "b.npz", pings[5:])
    done = _run("map", "a.npz", "b.npz", "--mount", "0 0 0 0 5 0", "--out", "dive", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder


def _places(run: Path) -> dict[str, list[str]]:
    """A voxel of each kind of a map, as words of a command line."""
    voxels = load_map(run)
    slots, cells = {}, {}
    seen, odds = voxels.seen > 0, voxels.log_odds
    for kind, mask in (("occupied", odds > 0), ("free", odds < -1), ("unknown", ~seen)):
        slots[kind], cells[kind] = (int(part[0]) for part in np.nonzero(mask))
    index = {
        kind: voxels.coords[slot] * 8 + np.unravel_index(cells[kind], (8, 8, 8))
        for kind, slot in slots.items()
    }
    return {kind: [f"{c:.3f}" for c in (at + 0.5) * voxels.voxel_m] for kind, at in index.items()}


@pytest.mark.parametrize("name", ["bayes", "carving"])
def test_a_scans_voxels_are_explained(name: str, runs: Path) -> None:
    run, voxels = runs / name, load_map(runs / name)
    for kind, place in _places(run).items():
        told = _told(str(run), "--voxel", *place)
        assert told["state"] == kind and told["voxels_differing"] == 0
        log_odds, seen = voxels.at(tuple(told["voxel"]))
        assert told["probability"] == pytest.approx(1 / (1 + math.exp(-log_odds)))
        assert told["surface"] is (bool(seen & SURFACE) if name == "carving" else None)
        assert told["centre_m"] == pytest.approx([float(c) for c in place], abs=1e-3)
        shown = [one for one in told["reached_by"] if one["lit"] or one["dark"]]
        assert bool(shown) == (kind != "unknown") or name == "carving"
        steps = [0.5] + [one["probability"] for one in told["reached_by"]]
        befores = [one["probability_before"] for one in told["reached_by"]]
        assert befores == steps[:-1] and steps[-1] == told["probability"]


def test_it_is_a_table_and_a_picture(runs: Path, tmp_path: Path) -> None:
    place = _places(runs / "bayes")["occupied"]
    picture = tmp_path / "voxel.png"
    done = _run("explain", str(runs / "bayes"), "--voxel", *place, "--picture", str(picture),
                cwd=tmp_path)  # fmt: skip
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].startswith("Voxel at (") and ": occupied, p = 0." in lines[0]
    assert lines[1].split()[:2] == ["ping", "time"] and "pings reach it" in lines[-1]
    assert any("lit: raised" in line for line in lines)
    assert f"Picture: {picture}" in done.stderr
    with Image.open(picture) as drawn:
        assert min(drawn.size) > 300
    unknown = _places(runs / "bayes")["unknown"]
    never = _run("explain", str(runs / "bayes/map.npz"), "--voxel", *unknown, "--picture", "n.png",
                 cwd=tmp_path)  # fmt: skip
    assert never.returncode == 0 and ": unknown, p = 0.500" in never.stdout
    assert not (tmp_path / "n.png").exists() or "reach it" in never.stdout


def test_a_recorded_dives_voxels_are_explained(
    runs: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(runs)
    place = _places(runs / "dive")["occupied"]
    mount = ["--mount", "0 0 0 0 5 0"]
    told = _told("dive", "--voxel", *place, *mount)
    assert told["voxels_differing"] == 0 and told["state"] == "occupied" and told["pings"] == 8
    assert {one["recording"] for one in told["reached_by"]} <= {"a.npz", "b.npz"}
    other = _run("explain", "dive", "--voxel", *place, cwd=runs)  # at another mount
    assert other.returncode == 0 and "warning: mapped again, it has" in other.stderr
    monkeypatch.chdir(tmp_path)
    now = [word for name in ("a", "b") for word in ("--recording", str(runs / f"{name}.npz"))]
    again = _told(str(runs / "dive"), "--voxel", *place, *mount, *now)
    assert again["voxels_differing"] == 0 and again["probability"] == told["probability"]


def test_what_is_not_at_hand_is_one_sentence(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(runs / "bayes", tmp_path / "lost")
    (tmp_path / "lost/recording.mcap").unlink()
    shutil.copytree(runs / "dive", tmp_path / "dive")
    shutil.copy(runs / "bayes/map.npz", tmp_path / "alone.npz")
    shutil.copytree(runs / "bayes", tmp_path / "mute")
    (tmp_path / "mute.py").write_text(
        "from insonify import BayesMapper\nclass Mute(BayesMapper):\n    explain = None\n"
    )
    config = (tmp_path / "mute/config.toml").read_text()
    named = config.replace('mapper = "bayes"', f'mapper = "{tmp_path / "mute.py"}:Mute"')
    (tmp_path / "mute/config.toml").write_text(named)
    (tmp_path / "tour").mkdir()
    tour = {"kind": "tour", "world": "tank", "vehicle": "bluerov2", "seed": 0, "time_s": 1.0,
            "stop_reason": "plan_flown", "path_m": 1.0, "pose_error": {}, "pings": {"fls": 1},
            "schema_version": 1}  # fmt: skip
    (tmp_path / "tour/result.json").write_text(json.dumps(tour))
    (tmp_path / "tour/config.toml").touch()
    at = ["--voxel", *_places(runs / "bayes")["occupied"]]
    run = str(runs / "bayes")
    for words, sentence in [
        (["lost", *at], "there is no such recording, so the scan's pings are not at hand"),
        (["dive", "--voxel", "0.5", "0", "-2"], "a.npz: there is no such recording, so the pings"),
        (["alone.npz", *at], "nothing beside it says of which pings it was made"),
        (["nowhere", *at], "there is no such result or map"),
        (["tour", *at], "`fly` leaves pings and no map; map them first"),
        (["mute", *at], "mapper 'bayes' cannot say what made a voxel"),
        ([run, "--voxel", "nan", "0", "0"], "--voxel takes three finite numbers in metres"),
        ([run, "--voxel", "500", "0", "0"], "(500, 0, 0) m lies outside the map"),
        ([run, *at, "--recording", "x", "--recording", "y"], "a scan has one recording, not 2"),
        (["dive", "--voxel", "0.5", "0", "-2", "--recording", "x"], "give them all, in this order"),
        ([run, *at, "--picture", "no/such/folder/v.png"], "cannot be written"),
    ]:
        with pytest.raises(InsonifyError, match=re.escape(sentence)):
            _call("explain", *words)
    assert not [path for path in tmp_path.iterdir() if path.suffix in (".png", ".part")]
    for words, sentence in [(["lost", *at], "not at hand"), ([run, "--voxel", "1", "2"], "voxel")]:
        done = _run("explain", *words, cwd=tmp_path)
        (line,) = done.stderr.splitlines()
        assert (done.returncode, done.stdout) == (2, "")
        assert line.startswith("insonify: ") and sentence in line
