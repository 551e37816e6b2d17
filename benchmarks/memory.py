"""Memory over many pings: ``python -m benchmarks.memory [--pings N]``.

Flies a scan of about so many pings with a vehicle, then maps its recording (`map`), and
prints the memory in use, and the map's own share, as they go on.  What grows beside the map should
be nothing.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

import psutil

from insonify.io.recordings import open_recording
from insonify.mapping.mapper import MappingSettings
from insonify.mission.loop import Mapped
from insonify.mission.remap import map_recordings
from insonify.mission.setup import scenario_config
from insonify.results.scan import run_scan

WAYPOINTS, PINGS_A_SCAN = 10, 48
"""The vehicle pings on its ways too."""
SMALL: dict[str, Any] = {
    "planner": "uniform",
    "sonar": {"beams": 24, "bins": 60},
    "mapping": {"voxel_m": 0.25},
    "vehicle": {"name": "bluerov2"},
}


class Meter:
    """Prints a row each so many pings."""

    def __init__(self, name: str, every: int) -> None:
        self._name, self._every, self._done = name, every, 0

    def ping(self, voxels: Any) -> None:
        self._done += 1
        if self._done % self._every == 0:
            used = psutil.Process().memory_info().rss / 1e6
            held = (voxels.log_odds.nbytes + voxels.seen.nbytes) / 1e6
            print(f"{self._name} {self._done:6} pings: {used:7.1f} MB, map {held:6.1f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pings", type=int, default=5000)
    given = parser.parse_args()
    every, scans = given.pings // 10, 1 + given.pings // PINGS_A_SCAN
    survey = {"waypoints": WAYPOINTS, "baseline_scans": scans, "approach_m": 2.0}
    config = scenario_config("tetrapod", [SMALL, {"survey": survey}])
    with tempfile.TemporaryDirectory() as folder:
        flying, mapping = Meter("scan --vehicle", every), Meter("map", every)

        def watch(run: Any, step: Any) -> None:
            if isinstance(step, Mapped):
                flying.ping(run.mapper.voxels)

        _, target = run_scan(config, Path(folder) / "run", watch=watch)
        map_recordings(
            [open_recording(target / "recording.mcap")],
            MappingSettings(voxel_m=0.25),
            watch=lambda remap, *more: mapping.ping(remap.mapper.voxels),
        )


if __name__ == "__main__":
    main()
