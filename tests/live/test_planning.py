"""The next path: never nearer to what is mapped than the clearance, whatever is mapped."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from insonify.live.planning import Pilot
from insonify.mapping.bayes import BayesMapper
from insonify.mapping.mapper import MappingSettings
from insonify.mapping.voxels import IN_VIEW, OBSERVED, VoxelMap
from insonify.planning.active import EntropySettings
from insonify.types import FanGeometry, Pose, ScanPath

FAN = FanGeometry(1.2, 0.3, 16, 40, 0.5, 8.0, Pose(0.0, 0.0, 0.0, pitch_rad=0.3))
VOXEL_M = 0.25


def random_map(seed: int, blocks: int) -> VoxelMap:
    """Blobs that are occupied, free and undecided, around where the vehicle is."""
    rng = np.random.default_rng(seed)
    voxels = VoxelMap(VOXEL_M)
    voxels.allocate(rng.integers(-4, 4, (blocks, 3)).astype(np.int32))
    shape = voxels.log_odds.shape
    voxels.log_odds[:] = rng.choice([-3.0, 0.0, 0.05, 3.0], shape, p=[0.5, 0.3, 0.1, 0.1])
    voxels.seen[:] = rng.choice([0, IN_VIEW, IN_VIEW | OBSERVED], shape)
    return voxels


def nearest_m(voxels: VoxelMap, way: list[Pose]) -> float:
    """Least distance of a way, sampled every centimetre, to a cube that is occupied."""
    centres = voxels.occupied_m()
    least = math.inf
    for start, end in itertools.pairwise(way):
        steps = max(2, round(math.dist(start.position_m, end.position_m) / 0.05))
        for share in np.linspace(0.0, 1.0, steps):
            place = (1 - share) * np.array(start.position_m) + share * np.array(end.position_m)
            outside = np.maximum(np.abs(centres - place) - voxels.voxel_m / 2, 0.0)
            least = min(least, float(np.linalg.norm(outside, axis=1).min(initial=math.inf)))
    return least


@settings(max_examples=500, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    blocks=st.integers(1, 12),
    x=st.floats(-9.0, 9.0),
    y=st.floats(-9.0, 9.0),
    z=st.floats(-2.0, 6.0),
    clearance_m=st.floats(0.0, 3.0),
)
def test_no_path_comes_below_the_clearance(
    seed: int, blocks: int, x: float, y: float, z: float, clearance_m: float
) -> None:
    mapper = BayesMapper(MappingSettings(voxel_m=VOXEL_M))
    mapper.voxels = random_map(seed, blocks)
    pose = Pose(x, y, z, yaw_rad=0.3)
    chosen = EntropySettings(termination=0.0, high_entropy=0.9, min_samples=2)
    answer = Pilot(None, chosen, 5, clearance_m).next_scan(mapper, FAN, pose)
    if answer.path is None:
        assert answer.why
        return
    assert nearest_m(mapper.voxels, [pose, *answer.path.waypoints]) >= clearance_m - 1e-9
    assert answer.clear_m >= clearance_m


def test_some_paths_are_sent_and_some_refused() -> None:
    """So that the property above says something."""
    chosen = EntropySettings(termination=0.0, high_entropy=0.9, min_samples=2)
    sent = refused = 0
    for seed in range(12):
        mapper = BayesMapper(MappingSettings(voxel_m=VOXEL_M))
        mapper.voxels = random_map(seed, 4)
        for clearance_m in (0.2, 30.0):
            pilot = Pilot(None, chosen, 5, clearance_m)
            answer = pilot.next_scan(mapper, FAN, Pose(0.0, 0.0, 9.0))
            sent += answer.path is not None
            refused += "is the least" in answer.why
    assert sent >= 3 and refused >= 3


def test_the_most_scans_are_kept_to() -> None:
    pilot = Pilot(None, EntropySettings(max_scans=1), 5, 0.4, sent=1)
    answer = pilot.next_scan(BayesMapper(MappingSettings()), FAN, Pose(0.0, 0.0, 0.0))
    assert answer.path is None and "entropy.max_scans" in answer.why


def test_a_scan_is_flown_when_its_begin_and_then_its_end_were_reached() -> None:
    pilot = Pilot(None, EntropySettings(), 5, 0.4)
    assert not pilot.flown(Pose(0.0, 0.0, 0.0))
    pilot._ahead = ScanPath((Pose(5.0, 0.0, 0.0), Pose(10.0, 0.0, 0.0)))
    places = [0.0, 10.0, 8.0, 5.2, 7.0, 9.4]  # it passes the end on its way to the begin
    assert not any(pilot.flown(Pose(x, 0.0, 0.0)) for x in places)
    assert pilot.flown(Pose(9.6, 0.0, 0.0))
    assert not pilot.flown(Pose(10.0, 0.0, 0.0))


@pytest.mark.parametrize("words", ["live --out L", "play bag.npz", "scan tetrapod --live-bus"])
@pytest.mark.slow
def test_without_the_bus_it_says_what_to_install(words: str, tmp_path: object) -> None:
    import subprocess
    import sys
    from pathlib import Path

    from insonify.io.recordings.arrays import save_arrays
    from insonify.types import Ping, PosedPing

    folder = Path(str(tmp_path))
    ping = Ping(np.zeros((40, 16), np.float32), FAN)
    save_arrays(folder / "bag.npz", [PosedPing(ping, Pose(0.0, 0.0, -3.0))])
    code = (
        "import sys\nsys.modules['cyclonedds'] = None\n"
        f"sys.argv = ['insonify', *{words.split()!r}]\n"
        "from insonify.cli import main\nmain()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "pip install 'insonify[live]'" in done.stderr and "Traceback" not in done.stderr
