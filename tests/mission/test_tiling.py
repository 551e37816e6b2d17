"""Maps made in parts, by the workers of a cluster: the same as by one process."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from insonify.io.recordings import open_recording
from insonify.io.recordings.arrays import save_arrays
from insonify.io.recordings.recording import Reading
from insonify.mapping.bayes import BayesMapper
from insonify.mapping.mapper import MappingSettings
from insonify.mission.crew import Failure
from insonify.mission.tiling import Order, Part, divided, map_part
from insonify.types import FanGeometry, Ping, Pose, PosedPing

FAN = FanGeometry(1.2, 0.4, 16, 32, 0.5, 6.0)
CLUSTER = """
import logging, subprocess, sys
from distributed import LocalCluster

if __name__ == "__main__":
    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=logging.CRITICAL
    ) as cluster:
        words = [sys.executable, "-m", "insonify", "map", *sys.argv[1:]]
        sys.exit(subprocess.run([*words, "--scheduler", cluster.scheduler_address]).returncode)
"""


def _pings(rng: np.random.Generator) -> list[PosedPing]:
    images = np.where(rng.random((40, 32, 16)) > 0.95, 0.9, 0.0).astype(np.float32)
    return [
        PosedPing(
            Ping(image, FAN, float(k)),
            Pose(5e5 + 0.8 * k, 3.0 * np.sin(k / 5.0), -2.0, yaw_rad=(0.4 * k) % 6.0),
        )
        for k, image in enumerate(images)
    ]


def _run(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *words], cwd=cwd, capture_output=True, text=True, timeout=300, check=False
    )


def _bytes(folder: Path) -> dict[str, bytes]:
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def test_two_workers_map_as_one_process(tmp_path: Path, rng: np.random.Generator) -> None:
    pytest.importorskip("distributed")
    pings = _pings(rng)
    save_arrays(tmp_path / "a.npz", pings[:25])
    save_arrays(tmp_path / "b.npz", pings[25:])
    (tmp_path / "cluster.py").write_text(CLUSTER)
    (tmp_path / "config.toml").write_text("[mapping]\nvoxel_m = 0.1\n")
    what = ["a.npz", "b.npz", "--config", "config.toml", "--json"]
    here = _run("-m", "insonify", "map", *what, "--out", "here", "--memory", "500MB", cwd=tmp_path)
    there = _run("cluster.py", *what, "--out", "there", cwd=tmp_path)
    assert (here.returncode, there.returncode) == (0, 0), here.stderr + there.stderr
    told = [json.loads(done.stdout) for done in (here, there)]
    assert told[1].pop("seconds").keys() == told[0].pop("seconds").keys()
    assert told[0] == told[1] and told[0]["origin_m"][0] > 4e5
    ours, theirs = (_bytes(tmp_path / name) for name in ("here", "there"))
    assert ours.keys() == theirs.keys()
    timed = {"result.json", "report.html"}
    assert {name for name in ours if ours[name] != theirs[name]} <= timed

    refused = _run("cluster.py", *what, "--out", "c", "--mapper", "carving", cwd=tmp_path)
    assert refused.returncode == 2 and "leave --scheduler out" in refused.stderr
    assert "Traceback" not in refused.stderr and not (tmp_path / "c").exists()


def test_nobody_at_the_address_is_one_sentence(tmp_path: Path, rng: np.random.Generator) -> None:
    pytest.importorskip("distributed")
    save_arrays(tmp_path / "a.npz", _pings(rng))
    done = _run("-m", "insonify", "map", "a.npz", "--out", "m", "--scheduler", "tcp://127.0.0.1:9",
                cwd=tmp_path)  # fmt: skip
    assert done.returncode == 2 and "no Dask scheduler answers there" in done.stderr
    assert not (tmp_path / "m").exists()


def _part(folder: Path, file: Path) -> Part:
    settings = MappingSettings(voxel_m=0.1)
    order = Order((file,), Reading(), "bayes", settings, {}, folder, 50_000_000)
    return Part(order, (5e5, 0.0, 0.0), (-1, -2), (2, 0))


def test_a_part_is_what_all_would_be_there_whatever_a_killed_worker_left(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    pings = _pings(rng)
    save_arrays(tmp_path / "a.npz", pings)
    whole = BayesMapper(MappingSettings(voxel_m=0.1))
    for posed in open_recording(tmp_path / "a.npz"):
        assert posed.pose is not None
        whole.integrate(posed.ping, posed.pose.relative_to((5e5, 0.0, 0.0)))
    folder = tmp_path / "map.zarr"
    part = _part(folder, tmp_path / "a.npz")
    missing = map_part(part)
    assert isinstance(missing, Failure) and "do not see this folder" in missing.message
    folder.mkdir()
    (folder / "part--1--2.txt").write_text("log_odds/c/1/2/3\n")
    done = map_part(part)
    assert not isinstance(done, Failure) and done.bits == 3
    assert not list(folder.glob("*.txt")) and not list(folder.rglob("*.new"))
    low, high = np.array([-8, -16, -(10**6)]), np.array([23, 7, 10**6])
    coords = whole.voxels.coords
    wanted = coords[((coords >= low) & (coords <= high)).all(axis=1)]
    assert 100 < len(wanted) < len(coords)
    np.testing.assert_array_equal(np.unique(done.coords, axis=0), np.unique(wanted, axis=0))
    garbled = dataclasses.replace(part.order, files=(tmp_path / "none.npz",))
    assert isinstance(map_part(dataclasses.replace(part, order=garbled)), Failure)


@given(
    st.dictionaries(
        st.tuples(st.integers(-9, 9), st.integers(-9, 9)), st.integers(1, 50), max_size=60
    ),
    st.integers(1, 9),
)
def test_every_column_is_in_one_part(columns: dict[tuple[int, int], int], count: int) -> None:
    parts = divided(columns, count)
    assert len(parts) <= count
    for x, y in columns:
        inside = [low[0] <= x <= high[0] and low[1] <= y <= high[1] for low, high in parts]
        assert sum(inside) == 1
