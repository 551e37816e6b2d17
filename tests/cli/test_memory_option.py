"""``--memory``: every command that takes it, beside the same command without it."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from insonify.cli import app
from insonify.cli.root import memory_limit
from insonify.errors import ConfigError, InsonifyError, MapFileError, MemoryLimitError, OutputError
from insonify.io.maps import load_map, ondisk
from insonify.io.maps.ondisk import BYTES_PER_BLOCK
from insonify.io.recordings.arrays import save_arrays
from insonify.types import FanGeometry, Ping, Pose, PosedPing
from insonify.view.sources import map_story

FAN = FanGeometry(1.2, 0.4, 16, 32, 0.5, 6.0)
LIMIT = 800 * BYTES_PER_BLOCK
MEMORY = ("--memory", f"{LIMIT / 1e6:f}MB")


@pytest.fixture
def folder(tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A recording whose map at 0.1 m takes more than the limit, which is small."""
    monkeypatch.setattr(ondisk, "LEAST_BYTES", 100)
    for name in ("_PICKED_BYTES", "_DENSE_BYTES"):  # what is picked would not fit there
        monkeypatch.setattr(f"insonify.mapping.voxels.{name}", 1e-9)
    monkeypatch.chdir(tmp_path)
    images = np.where(rng.random((40, 32, 16)) > 0.95, 0.9, 0.0).astype(np.float32)
    pings = [
        PosedPing(Ping(image, FAN, float(k)), Pose(0.8 * k, 3.0 * np.sin(k / 5.0), -2.0))
        for k, image in enumerate(images)
    ]
    save_arrays(tmp_path / "r.npz", pings)
    return tmp_path


def _do(*words: str) -> str:
    done = CliRunner().invoke(app, list(words), catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


def _refused(*words: str) -> InsonifyError:
    done = CliRunner().invoke(app, list(words))
    assert isinstance(done.exception, InsonifyError), done.output
    return done.exception


def test_what_is_left_is_the_same_but_for_where_the_map_is(folder: Path) -> None:
    told = [json.loads(_do("map", "r.npz", "--out", "memory", "--json"))]
    told.append(json.loads(_do("map", "r.npz", "--out", "disk", *MEMORY, "--json")))
    for one in told:
        del one["seconds"]
    assert told[0] == told[1]
    assert load_map("memory").block_count * BYTES_PER_BLOCK > 1.5 * LIMIT
    names = [{path.name for path in (folder / name).iterdir()} for name in ("memory", "disk")]
    assert names[0] - names[1] == {"map.npz"} and names[1] - names[0] == {"map.zarr"}
    for name in ("map.ply", "entropy.npz", "sonar.toml", "config.toml"):
        assert (folder / "memory" / name).read_bytes() == (folder / "disk" / name).read_bytes()

    for suffix in (".npz", ".ot", ".ply", ".xyz"):
        rows = [json.loads(_do("export", "memory", f"a{suffix}", "--json"))]
        rows.append(json.loads(_do("export", "disk", f"b{suffix}", *MEMORY, "--json")))
        assert [row.pop("file") for row in rows] == [f"a{suffix}", f"b{suffix}"]
        assert rows[0] == rows[1]
        assert (folder / f"a{suffix}").read_bytes() == (folder / f"b{suffix}").read_bytes()
    _do("export", "memory", "again.zarr")
    for chunk in (folder / "disk" / "map.zarr").rglob("*"):
        again = folder / "again.zarr" / chunk.relative_to(folder / "disk" / "map.zarr")
        assert chunk.is_dir() or chunk.read_bytes() == again.read_bytes()
    region = ("--region", "0 -2 -3 4 2 -1")
    _do("export", "disk", "part.npz", *region)
    _do("export", "memory", "same.npz", *region)
    assert (folder / "part.npz").read_bytes() == (folder / "same.npz").read_bytes()

    pose = ("--from", "0 0 0 0", "--clearance", "0", "--set", "entropy.termination=0", "--json")
    plans = [json.loads(_do("plan", "memory", *pose, "--out", "p"))]
    plans.append(json.loads(_do("plan", "disk", *pose, *MEMORY, "--out", "q")))
    assert plans[0] == plans[1] and plans[0]["stop"] is None

    stories = [map_story(folder / "memory"), map_story(folder / "disk", memory_bytes=LIMIT)]
    pictures = [story.maps.at(10) for story in stories]
    for shown in ("occupied", "elsewhere", "undecided"):
        ours, theirs = (getattr(picture[1], shown) for picture in pictures if picture)
        assert ours.count == theirs.count and ours.times == theirs.times
        assert sorted(map(tuple, ours.index.tolist())) == sorted(map(tuple, theirs.index.tolist()))


DIES = """
import os, signal, sys
from insonify.cli import app
from insonify.io.maps import ondisk
from insonify.results import kept

ondisk.LEAST_BYTES, kept._LEAST_S, kept._SHARE = 100, 0.0, 1e9
had, integrate = 0, kept.KeptMapper.integrate

def dying(self, ping, pose):
    global had
    integrate(self, ping, pose)
    had += 1
    if had == int(sys.argv[1]):
        os.kill(os.getpid(), signal.SIGKILL)

kept.KeptMapper.integrate = dying
app(sys.argv[2:], standalone_mode=False)
"""


def test_the_same_command_goes_on_after_kills(folder: Path) -> None:
    _do("map", "r.npz", "--out", "memory")
    command = ["map", "r.npz", "--out", "disk", *MEMORY]
    for dies_at in (12, 31):
        (folder / "dies.py").write_text(DIES)
        died = subprocess.run(
            [sys.executable, "dies.py", str(dies_at), *command], cwd=folder, capture_output=True,
            check=False,
        )  # fmt: skip
        assert died.returncode == -signal.SIGKILL, died.stderr
        assert not (folder / "disk").exists()
    done = CliRunner().invoke(app, command, catch_exceptions=False)
    assert "going on after 31 pings that are mapped already" in done.stderr
    results = [
        json.loads((folder / name / "result.json").read_text()) for name in ("memory", "disk")
    ]
    for result in results:
        del result["seconds"]
    assert results[0] == results[1]
    _do("export", "disk", "disk.npz")
    assert (folder / "disk.npz").read_bytes() == (folder / "memory" / "map.npz").read_bytes()
    assert (folder / "disk" / "map.ply").read_bytes() == (folder / "memory/map.ply").read_bytes()
    assert not list((folder / "disk" / "map.zarr").glob("*.npz*"))
    assert [path.name for path in folder.iterdir() if path.name.startswith(".")] == []


COUNTS = """
import numpy as np
from insonify import BayesMapper

class Counts(BayesMapper):
    name = "counts"
    heard = ended = 0

    def integrate(self, ping, pose):
        self.heard += 1
        super().integrate(ping, pose)

    def finish_scan(self):
        self.ended += 100 + self.heard
        held = self.voxels.hold(np.array([[0, 0, -3]], np.int32))
        held.log_odds[held.slots, 0] += 0.001 * self.heard + 0.1

    def save(self):
        return {"counts": np.array([self.heard, self.ended])}

    def load(self, arrays):
        self.heard, self.ended = arrays["counts"].tolist()
"""


@pytest.mark.parametrize("dies_at", [40, 60])
def test_a_mapper_of_ones_own_goes_on_with_what_it_keeps(folder: Path, dies_at: int) -> None:
    (folder / "own.py").write_text(COUNTS)
    (folder / "dies.py").write_text(DIES)
    command = ["map", "r.npz", "r.npz", "--mapper", "own.py:Counts"]
    _do(*command, "--out", "memory")
    command += ["--out", "disk", *MEMORY]
    words = [sys.executable, "dies.py", str(dies_at), *command]
    died = subprocess.run(words, cwd=folder, capture_output=True, check=False)
    assert died.returncode == -signal.SIGKILL, died.stderr
    done = CliRunner().invoke(app, command, catch_exceptions=False)
    assert f"going on after {dies_at} pings" in done.stderr
    _do("export", "disk", "disk.npz")
    assert (folder / "disk.npz").read_bytes() == (folder / "memory" / "map.npz").read_bytes()
    for name in ("memory", "disk"):
        with np.load(folder / name / "mapper.npz") as kept:
            assert kept["state_counts"].tolist() == [80, 320]


def test_a_size_is_read_as_people_write_it() -> None:
    for text, size in {"500MB": 500e6, "2 GB": 2e9, "64MiB": 64 * 2**20, "1.5G": 1.5e9}.items():
        assert memory_limit(text) == size
    for text in ("much", "-1MB", "1e9", "5 XB", ""):
        with pytest.raises(ConfigError, match="500MB"):
            memory_limit(text)


def test_what_cannot_be_is_one_sentence(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said = _refused("map", "r.npz", "--out", "m", "--mapper", "carving", *MEMORY)
    assert isinstance(said, ConfigError) and "leave --memory out" in str(said)
    assert isinstance(_refused("map", "r.npz", "--out", "m", "--memory", "9"), MemoryLimitError)
    said = _refused("map", "r.npz", "--out", "m", "--memory", "0.05MB")
    assert isinstance(said, MemoryLimitError) and "--voxel" in str(said)
    assert not (folder / "m").exists() and len(list(folder.iterdir())) == 1
    _do("map", "r.npz", "--out", "memory")
    said = _refused("export", "memory", "x.npz", *MEMORY)
    assert isinstance(said, MapFileError) and "give a .zarr" in str(said)
    assert isinstance(_refused("export", "memory", "x.rrd", *MEMORY), OutputError)
    assert "--memory is for maps" in str(_refused("view", "r.npz", *MEMORY, "--json"))
    monkeypatch.setattr(ondisk, "LEAST_BYTES", 10**7)
    assert "10MB or more" in str(_refused("map", "r.npz", "--out", "m", *MEMORY))
