"""`info`, `map` and `plan` as a person types them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from benchmarks import samples
from typer.testing import CliRunner

from insonify.cli import app
from insonify.errors import InsonifyError
from insonify.io.maps import load_map, save_map
from insonify.mapping.voxels import VoxelMap
from insonify.sonar.devices import named_device

pytestmark = pytest.mark.slow


def _run(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "insonify", *arguments],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


@pytest.fixture
def folder(tmp_path: Path, rng: np.random.Generator) -> Path:
    (tmp_path / "a.aris").write_bytes(samples.aris(samples.pixels(rng, 3, 40, 48)))
    images = np.where(rng.random((4, 30, 12)) > 0.97, 255, 0).astype(np.uint8)
    samples.image_folder(tmp_path / "images", images, samples.tum_rows(4))
    (tmp_path / "text").write_text("nothing")
    save_map(VoxelMap(0.2), tmp_path / "map.npz")
    return tmp_path


def test_info_tells_and_draws(folder: Path) -> None:
    done = _run("info", "a.aris", "--json", "--picture", "fan.png", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["pings"] == 3
    assert (folder / "fan.png").read_bytes().startswith(b"\x89PNG")
    people = _run("info", "images", cwd=folder)
    assert people.returncode == 0 and "4 of 4 pings" in people.stdout


def test_map_writes_everything(folder: Path) -> None:
    done = _run("map", "images", "--voxel", "0.2", "--out", "m", "--json", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert {p.name for p in (folder / "m").iterdir()} == {
        "result.json",
        "map.npz",
        "map.ply",
        "entropy.npz",
        "sonar.toml",
        "config.toml",
        "report.html",
    }
    result = json.loads(done.stdout)
    assert result == json.loads((folder / "m/result.json").read_text())
    assert load_map(folder / "m/map.npz").voxel_m == 0.2
    assert named_device(str(folder / "m/sonar.toml")).tilt_deg == pytest.approx(15.0)
    pose = ["--from", "0 0 0 90", "--datum", "60 10", "--set", "entropy.termination=0"]
    refused = _run("plan", "m", *pose, "--out", "p", cwd=folder)  # from within what is mapped
    assert refused.returncode == 2 and not (folder / "p").exists()
    assert "0.4 m is the least" in refused.stderr
    planned = _run("plan", "m", *pose, "--clearance", "0", "--out", "p", "--json", cwd=folder)
    assert planned.returncode == 0, planned.stderr
    document = json.loads(planned.stdout)
    assert document["stop"] is None
    assert set(document["files"]) < {p.name for p in (folder / "p").iterdir()}
    never = ["--set", "entropy.termination=1"]
    enough = _run("plan", "m", *pose[:4], *never, "--out", "q", cwd=folder)
    assert enough.returncode == 3 and not (folder / "q").exists(), enough.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["info", "none"], ["none", "no such recording"]),
        (["info", "text"], ["no known format"]),
        (["info", "a.aris", "--sonar", "asdic"], ["asdic"]),
        (["map", "a.aris", "--out", "m"], ["has a pose", "--poses"]),
        (["map", "images", "--out", "m", "--region", "1 2 3"], ["--region", "1 2 3"]),
        (["map", "images", "--out", "m", "--set", "sonar.beams=2"], ["mapping.KEY", "sonar"]),
        (["map", "images", "--out", "m", "--voxel", "0"], ["voxel_m"]),
        (["plan", "none", "--from", "0 0 0 0"], ["none", "no such map file"]),
        (["plan", "text", "--from", "0 0 0 0"], ["text", "insonify-map"]),
        (["plan", "map.npz", "--from", "0 0 0"], ["--from", "'0 0 0'"]),
        (["plan", "map.npz", "--from", "0 0 0 0", "--datum", "1"], ["--datum", "'1'"]),
        (["plan", "map.npz", "--from", "0 0 0 0"], ["--sonar"]),
    ],
)
def test_bad_input_is_one_sentence(
    folder: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], words: list[str]
) -> None:
    monkeypatch.chdir(folder)
    done = CliRunner().invoke(app, arguments)
    assert isinstance(done.exception, InsonifyError), done.output
    for word in words:
        assert word in str(done.exception)
    assert not (folder / "m").exists()
