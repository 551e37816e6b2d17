"""Small jobs that, between them, use every kernel: run once, nothing has to be compiled later."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

from insonify.config.settings import Table

_SMALL: Table = {
    "mapping": {"voxel_m": 0.25},
    "survey": {"waypoints": 4},
    "sampling": {"over_elevation": 64},
    "entropy": {"max_scans": 2},
}


def warm_up_step(name: str) -> None:
    """Do one of the `STEPS`."""
    STEPS[name]()


def _scanning() -> None:
    from insonify.mission.run import execute
    from insonify.mission.setup import scenario_config

    for more in ({}, {"mapper": "carving", "planner": "rosette", "rosette": {"pings": 8}}):
        execute(scenario_config("tetrapod", [_SMALL, more]))


def _flying() -> None:
    from insonify.mission.run import execute
    from insonify.mission.setup import scenario_config

    flown = {"vehicle": {"name": "bluerov2"}, "planner": "uniform"}
    once = {"survey": {"baseline_scans": 1, "approach_m": 1.0, "overrun_m": 0.0}}
    execute(scenario_config("tetrapod", [_SMALL, flown, once]))
    # Thrusters at their limits, which so short a flight does not meet.
    import numpy as np

    from insonify.vehicle.autopilot.allocation import CONTROLLED, Allocator

    Allocator(np.eye(6), np.ones(6)).share(np.full(len(CONTROLLED), 2.0))


def _simulating() -> None:
    from insonify.imaging.route import simulate, simulation_config

    for more in ({}, {"model": "physical", "physical": {"second_bounce": True}}):
        config = simulation_config("fls-tank", [{"sonar": {"beams": 32, "bins": 64}}, more])
        for _ in simulate(config, config.scene(), with_truth=True):
            pass


def _mapping() -> None:
    """Pings of recordings and of the bus, whose pixels may lie in memory that is only read."""
    import numpy as np

    from insonify.mapping.factory import MAPPERS, make_mapper
    from insonify.mapping.mapper import MappingSettings
    from insonify.types import FanGeometry, Ping, Pose

    image = np.zeros((16, 4), np.float32)
    image[8] = 1.0
    fixed = image.copy()
    fixed.setflags(write=False)
    fan = FanGeometry(0.5, 0.2, 4, 16, 0.0, 2.0)
    for name in MAPPERS:
        mapper = make_mapper(name, MappingSettings(voxel_m=0.25))
        for pixels in (image, fixed):
            mapper.integrate(Ping(pixels, fan), Pose(0.0, 0.0, 0.0))
        mapper.finish_scan()


def _exporting() -> None:
    from insonify.io.maps import load_map, save_map
    from insonify.mapping.voxels import VoxelMap

    voxels = VoxelMap(0.1)
    import numpy as np

    voxels.allocate(np.zeros((1, 3), np.int32))
    voxels.log_odds[0, :8], voxels.seen[0, :8] = 1.0, 3
    with tempfile.TemporaryDirectory() as folder:
        for suffix in (".ot", ".bt"):
            save_map(voxels, Path(folder) / f"map{suffix}")
            load_map(Path(folder) / f"map{suffix}")


STEPS: dict[str, Callable[[], None]] = {
    "scanning": _scanning,
    "flying": _flying,
    "simulating": _simulating,
    "mapping": _mapping,
    "exporting": _exporting,
}
"""Jobs by name, in the order in which they are best done."""
