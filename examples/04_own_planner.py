"""Your own planner, beside the paper's: look next at the side that is known least.

python examples/04_own_planner.py, or from the command line:

insonify scan tetrapod --planner examples/04_own_planner.py:LeastKnownSide

A planner decides from what the mapper believes and its own motion, never from the truth.
"""

import math

import numpy as np

from insonify import Decision, StopReason, World, execute, scenario_config
from insonify.planning.baselines import path_over_centre
from insonify.planning.entropy import entropy_map


class LeastKnownSide:
    """Scans over the centre along that of eight headings before which most entropy lies."""

    name = "least known side"

    def __init__(self, area, geometry, scans=3):
        """For the order and the sonar; `scans` can be set: --set planner_options.scans=4."""
        self.area, self.scans = area, scans

    def next_scan(self, belief, nav):
        """The answer to: the map is this, where next?"""
        if len(nav.scans) == self.scans:
            return Decision(stop=StopReason.PLAN_FLOWN)
        if not nav.scans:
            return Decision(path=path_over_centre(self.area, self.area.heading_rad))
        window = belief.voxels.window(self.area.region)
        unknown = entropy_map(window) > 0.9
        towards = window.centres_m(unknown)[:, :2] - self.area.region.centre_m[:2]
        headings = np.arange(8) * math.tau / 8
        from_there = -np.column_stack([np.cos(headings), np.sin(headings)])
        best = int(np.argmax((towards @ from_there.T > 1.0).sum(axis=0)))
        return Decision(path=path_over_centre(self.area, headings[best]))


if __name__ == "__main__":
    config = scenario_config("tetrapod", [{"mapping": {"voxel_m": 0.2}}])
    mine = LeastKnownSide(World(config).area, config.sonar.geometry)
    for run in (execute(config, planner=mine), execute(config)):
        result = run.result()
        f1 = result.metrics["solid"]["exact"]["f1"]
        print(f"{result.planner}: {result.scans} scans, {result.path_m:.0f} m, solid F1 {f1:.3f}")
