"""Your own planner, beside the paper's: look next at the side that is known least.

python examples/04_own_planner.py

A planner decides from the map and its own motion, never from the truth.
"""

import math

import numpy as np

from insonify import Decision, StopReason, World, execute, scenario_config
from insonify.planning.baselines import path_over_centre
from insonify.planning.entropy import entropy_map


class LeastKnownSide:
    """Scans over the centre along that of eight headings before which most entropy lies."""

    name = "least known side"

    def __init__(self, area, scans):
        self.area, self.scans = area, scans

    def next_scan(self, voxels, nav):
        """The answer to: the map is this, where next?"""
        if len(nav.scans) == self.scans:
            return Decision(stop=StopReason.PLAN_FLOWN)
        if not nav.scans:
            return Decision(path=path_over_centre(self.area, self.area.heading_rad))
        window = voxels.window(self.area.region)
        unknown = entropy_map(window) > 0.9
        towards = window.centres_m(unknown)[:, :2] - self.area.region.centre_m[:2]
        headings = np.arange(8) * math.tau / 8
        from_there = -np.column_stack([np.cos(headings), np.sin(headings)])
        best = int(np.argmax((towards @ from_there.T > 1.0).sum(axis=0)))
        return Decision(path=path_over_centre(self.area, headings[best]))


config = scenario_config("tetrapod", [{"mapping": {"voxel_m": 0.2}}])
area = World(config).area
for run in (execute(config, LeastKnownSide(area, scans=3)), execute(config)):
    f1 = run.result()["metrics"]["solid"]["exact"]["f1"]
    print(f"{run.planner}: {len(run.paths)} scans, {run.path_m:.0f} m, solid F1 {f1:.3f}")
