"""What the best mapper could make of the pings that were flown, and of any that could be.

``python -m benchmarks.bounds`` flies the objects of the evidence with one seed.  Of each path it
prints how much of the object's surface any ray of its pings hits, and the F1 of the *oracle*: a map
that holds for free exactly what a ray truly passes.  What lies hidden from all of them no mapper
can tell.  ``feasible`` are poses all around that keep the clearance, many more than a survey has.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence

import numpy as np

from insonify.evaluation import GroundTruth, compare_voxels
from insonify.frames import directions_from_angles, world_from_sonar
from insonify.mission.run import execute
from insonify.mission.setup import World, scenario_config
from insonify.types import Bool, Float64, Pose, ScanPath

OBJECTS = ("tetrapod", "wreck", "pipe", "arch", "amphorae", "boxes", "trap", "tower")
PLANNERS = ("entropy", "uniform", "rosette")
_RAYS = 96, 96
"""Over azimuth and elevation, of each ping."""
_RINGS_M, _HEIGHTS_M, _SIDES = (2.0, 4.0, 7.0), (1.0, 2.5, 5.0, 8.0), 36


class Oracle:
    """What rays truly hit, and truly pass, in the box of an object."""

    def __init__(self, world: World, truth: GroundTruth) -> None:
        """Nothing yet."""
        self.world, self.truth = world, truth
        self.hit = np.zeros(truth.surface.shape, bool)
        self.passed = np.zeros(truth.surface.shape, bool)
        self._voxel_m = world.config.mapping.voxel_m
        self._water = np.argwhere(truth.scored & ~truth.solid)
        self._centres = truth.box.low_m + (self._water + 0.5) * self._voxel_m

    def look(self, pose: Pose) -> None:
        """Add a ping."""
        geometry = self.world.config.sonar.geometry
        transform = world_from_sonar(pose, geometry.mount)
        turn, origin = transform[:3, :3], transform[:3, 3]
        half = geometry.azimuth_fov_rad / 2, geometry.elevation_fov_rad / 2
        azimuth, elevation = np.meshgrid(
            *(np.linspace(-a, a, n) for a, n in zip(half, _RAYS, strict=True))
        )
        directions = directions_from_angles(azimuth, elevation).reshape(-1, 3) @ turn.T
        range_m = self._ranges(origin, directions)
        found = range_m <= geometry.range_max_m
        self._note_hits(origin + range_m[found, None] * directions[found])
        left = ~self.passed[tuple(self._water.T)]
        away = self._centres[left] - origin
        distance = np.linalg.norm(away, axis=1)
        x, y, z = (away @ turn).T
        seen = (
            (distance < geometry.range_max_m)
            & (abs(np.arctan2(y, x)) < half[0])
            & (abs(z) < distance * math.sin(half[1]))
        )
        free = self._ranges(origin, away[seen] / distance[seen, None]) > distance[seen]
        self.passed[tuple(self._water[left][seen][free].T)] = True

    def _ranges(self, origin_m: Float64, directions: Float64) -> Float64:
        return np.asarray(self.world.scene.cast(origin_m, directions.astype(np.float32)).range_m)

    def _note_hits(self, points_m: Float64) -> None:
        at = np.floor((points_m - self.truth.box.low_m) / self._voxel_m).astype(int)
        inside = ((at >= 0) & (at < self.hit.shape)).all(axis=1)
        self.hit[tuple(at[inside].T)] = True

    def figures(self) -> tuple[float, float]:
        """Share of the surface's voxels that are hit, and F1 of what is left when all is carved."""
        truth = self.truth
        surface: Bool = truth.surface & truth.scored
        left: Bool = truth.scored & ~self.passed
        share = int(np.count_nonzero(self.hit & surface)) / max(1, int(np.count_nonzero(surface)))
        return share, compare_voxels(left, truth.solid & truth.scored).f1


def feasible(world: World) -> Iterator[Pose]:
    """Poses all around and above an object that keep clear of everything."""
    region, level_m = world.area.region, float(world.stage.seabed.heights_m.mean())
    x, y, _ = region.centre_m
    reach_m = math.hypot(*region.size_m[:2]) / 2 - world.config.survey.margin_m
    clearance_m = world.config.survey.clearance_m
    for height_m in _HEIGHTS_M:
        for ring_m in (-1.0, *_RINGS_M):
            for side in range(_SIDES):
                way = 2.0 * math.pi * side / _SIDES
                away_m = reach_m + ring_m
                pose = Pose(
                    x - away_m * math.cos(way),
                    y - away_m * math.sin(way),
                    level_m + height_m,
                    yaw_rad=way,
                )
                if world.scene.first_collision(ScanPath((pose,)), clearance_m) is None:
                    yield pose


def bounds(world: World, truth: GroundTruth, poses: Sequence[Pose]) -> tuple[float, float]:
    """The oracle's figures for pings from some poses."""
    oracle = Oracle(world, truth)
    for pose in poses:
        oracle.look(pose)
    return oracle.figures()


def main() -> None:
    """Fly, look, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenarios", nargs="*", default=OBJECTS)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    print("| | path | pings | surface hit | oracle's F1 | `carving` |\n|---|---|---|---|---|---|")
    for scenario in options.scenarios:
        for planner in PLANNERS:
            layer = {"planner": planner, "mapper": "carving", "seed": options.seed}
            run = execute(scenario_config(scenario, [layer]))
            poses = [pose for path in run.paths for pose in path.waypoints]
            share, f1 = bounds(run.world, run.truth, poses)
            mapped = run.history[-1].metrics["solid"]["exact"]["f1"]
            print(
                f"| {scenario} | {planner} | {run.pings} | {share:.3f} | {f1:.3f} | {mapped:.3f} |"
            )
        anywhere = list(feasible(run.world))
        share, f1 = bounds(run.world, run.truth, anywhere)
        print(f"| {scenario} | feasible | {len(anywhere)} | {share:.3f} | {f1:.3f} | |", flush=True)


if __name__ == "__main__":
    main()
