"""Shared small worlds."""

from __future__ import annotations

import os
import signal
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

if "PYTEST_XDIST_WORKER" in os.environ:  # a process for each core is enough; their children too
    for name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")

import numpy as np
import pytest
from benchmarks.chromium import chromium, missing, resize
from hypothesis import settings

from insonify.cli import main
from insonify.mapping.voxels import IN_VIEW, OBSERVED, VoxelMap
from insonify.types import Float32, Float64, Pose
from insonify.vehicle.craft import Craft
from insonify.vehicle.description import vehicle_named
from insonify.vehicle.settings import VehicleSettings

settings.register_profile("same", derandomize=True)  # the same examples on every machine
settings.register_profile("many", max_examples=500)  # others each time: pytest --hypothesis-profile
settings.load_profile("same")

MakeMap = Callable[..., VoxelMap]
DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


@pytest.fixture
def real_mesh() -> Path:
    path = DATA / "models/sunken_ship_distorted/meshes/sunkenship_distort.dae"
    if not path.is_file():
        pytest.skip(f"needs {path.name} in ../shared/data, which is not here")
    return path


FLOOR_M = -20.0


def level_bottom(origin_m: Float64, directions: Float32) -> tuple[Float64, Float64]:
    """What rays find over a level bottom."""
    down = -directions[:, 2].astype(np.float64)
    with np.errstate(divide="ignore"):
        range_m = (origin_m[2] - FLOOR_M) / down
    return np.where(down > 0.0, range_m, np.inf), np.abs(down)


@pytest.fixture
def launch() -> Callable[..., Craft]:
    def put(seed: int = 0, name: str = "bluerov2", **settings: Any) -> Craft:
        chosen = VehicleSettings.model_validate({"name": name, **settings})
        vehicle, start = vehicle_named(name), Pose(0.0, 0.0, -15.0)
        return Craft(vehicle, chosen, start, level_bottom, np.random.default_rng(seed))

    return put


@pytest.fixture(scope="session")
def make_map() -> MakeMap:
    """Random maps as a mapper leaves them: log-odds only where something was observed."""

    def make(seed: int, blocks: int = 6, reach: int = 40, voxel_m: float = 0.1) -> VoxelMap:
        rng = np.random.default_rng(seed)
        voxels = VoxelMap(voxel_m)
        voxels.allocate(rng.integers(-reach, reach + 1, (blocks, 3)).astype(np.int32))
        shape = voxels.log_odds.shape
        voxels.log_odds[:] = rng.normal(0.0, 2.0, shape)
        voxels.log_odds[rng.random(shape) < 0.02] = 0.0
        voxels.seen[:] = rng.choice([0, IN_VIEW, IN_VIEW | OBSERVED], shape)
        for slot in range(0, voxels.block_count, 2):  # half of the blocks can be pruned
            voxels.seen[slot, : rng.choice([64, 256, 512])] = IN_VIEW | OBSERVED
            voxels.log_odds[slot] = rng.choice([-1.5, 0.5, 3.75])
        voxels.log_odds[voxels.seen != (IN_VIEW | OBSERVED)] = 0.0
        return voxels

    return make


@pytest.fixture(scope="session")
def open_chromium() -> Iterator[Any]:
    """One browser for all tests that need one."""
    if missing():
        pytest.skip(missing())
    with chromium(1200, 900) as opened:
        yield opened


@pytest.fixture
def browser(open_chromium: Any) -> Any:
    """The browser with an empty page and an empty log."""
    resize(open_chromium, (1200, 900))
    open_chromium.get("about:blank")
    open_chromium.get_log("browser")
    return open_chromium


LONGEST_S = 30.0


@pytest.fixture
def run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Iterator[Callable[..., str]]:
    """The command line with its boundary, in this process; what it printed on stderr.

    It must end with bad input, one line, no trace, and nothing left; with ``code=0``, well.
    """
    monkeypatch.chdir(tmp_path)
    told, heard = warnings.showwarning, signal.getsignal(signal.SIGINT)

    def command(*words: str, code: int = 2) -> str:
        before = {path.name for path in tmp_path.iterdir()}
        monkeypatch.setattr(sys, "argv", ["insonify", *words])
        started = time.monotonic()
        with pytest.raises(SystemExit) as ended, warnings.catch_warnings():
            warnings.simplefilter("default")
            main()
        shown = capsys.readouterr().err
        lines = [line for line in shown.splitlines() if "warning:" not in line]
        assert (ended.value.code or 0) == code, shown
        assert time.monotonic() - started < LONGEST_S
        if code:
            assert len(lines) == 1 and lines[0].startswith("insonify: "), shown
            assert len(lines[0]) <= 1000 and lines[0].isprintable()
            assert {path.name for path in tmp_path.iterdir()} == before
        return shown

    yield command
    warnings.showwarning = told
    signal.signal(signal.SIGINT, heard)


LOOPBACK = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo' multicast='false'/>"
    "</Interfaces><AllowMulticast>false</AllowMulticast></General><Discovery>"
    "<ParticipantIndex>auto</ParticipantIndex><Peers><Peer Address='localhost'/></Peers>"
    "</Discovery></Domain></CycloneDDS>"
)


@pytest.fixture
def domain(monkeypatch: pytest.MonkeyPatch) -> int:
    """A bus of a test's own, on the loopback interface alone; its number."""
    pytest.importorskip("cyclonedds")
    number = 90 + os.getpid() % 100
    monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    return number
