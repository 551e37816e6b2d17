"""Learns the table of `insonify.mapping.odds`, and says how well it holds on other objects.

``python -m benchmarks.calibration`` scans the objects of `LEARNT` along the paths of several
planners, with seeds that no other figure of the project uses, carves the pings, counts in each case
how many voxels are the object's, and writes ``src/insonify/mapping/odds.json``.
``python -m benchmarks.calibration --check`` leaves the table as it is.  Either way the reliability
of its probabilities is then printed for the objects of `HELD_BACK`, which it was not learnt from.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path
from unittest import mock

import numpy as np

import insonify.mapping
from insonify.config.settings import Table
from insonify.evaluation import GroundTruth, in_open_water
from insonify.mapping import carving
from insonify.mapping.bayes import BayesMapper
from insonify.mapping.carving import CarvingMapper
from insonify.mapping.odds import CASES
from insonify.mapping.voxels import OBSERVED
from insonify.mission.loop import Pinged, Step
from insonify.mission.run import Run, execute
from insonify.mission.setup import scenario_config
from insonify.types import Array, Float64

LEARNT = ("tetrapod", "pipe", "boxes", "tower")
HELD_BACK = ("wreck", "arch", "amphorae", "trap")
SEEDS = (100, 101, 102)
PATHS: dict[str, Table] = {
    "entropy": {"planner": "entropy"},
    "uniform": {"planner": "uniform", "survey": {"baseline_scans": 4}},
    "lawnmower": {"planner": "lawnmower-near", "survey": {"baseline_scans": 4}},
    "rosette": {"planner": "rosette", "rosette": {"altitude_m": 5.2}},
    "low rosette": {"planner": "rosette"},
}
"""Scans from few sides and from many, near and far."""
NOISE: dict[str, Table] = {
    "exact poses": {},
    "poses in doubt": {"vehicle": {"pose_noise": {"position_m": 0.05, "attitude_deg": 0.5}}},
}
_PRIOR, _PRIOR_SOLID, _PRIOR_SURFACE = 5e-4, 0.3, 0.2
"""Of an object's voxels: what a case counts before anything is seen of it."""
_TABLE = Path(insonify.mapping.__file__).parent / "odds.json"

_WATER = 0.1
"""How much a voxel of the water around an object counts.

A designated area has about ten times the voxels of the object's box: so both count alike.
"""

Cases = tuple[Array, GroundTruth, Array]
"""What a scan makes of the table's rows.

The row of each voxel of an object's box, -1 where nothing was told; the truth; and how many voxels
of the water in the designated area around it are of each row.
"""


def carved(scenario: str, path: str, noise: str, seed: int) -> Cases:
    """Fly a scan, carve its pings, and look at the table's rows instead of what they hold."""
    config = scenario_config(scenario, [PATHS[path], NOISE[noise], {"seed": seed}])
    rows = np.column_stack([np.arange(CASES), np.zeros(CASES)]).astype(np.float32)
    mapper = CarvingMapper(config.mapping)

    def follow(run: Run, step: Step) -> None:
        if isinstance(step, Pinged):
            assert step.posed.pose is not None
            mapper.integrate(step.posed.ping, step.posed.pose)

    run = execute(config, mapper=BayesMapper(config.mapping), watch=follow)
    with mock.patch.object(carving, "odds_table", lambda: rows):
        window = mapper.voxels.window(run.truth.box)
        area = mapper.voxels.window(run.world.area.region)
    told = (window.seen & OBSERVED) > 0
    cases = np.where(told, window.log_odds, -1).astype(np.int64)
    told = (area.seen & OBSERVED) > 0
    water = in_open_water(area.centres_m(told), config.mapping.voxel_m, run.truth, run.world.scene)
    found = area.log_odds[told][water].astype(np.int64)
    return cases, run.truth, np.bincount(found, minlength=CASES)


def shares(scans: Iterable[Cases]) -> tuple[Float64, Float64]:
    """Of each case the share of voxels that are an object's, and its surface's.

    Every object counts as much as any other, whatever its size.
    """
    counts = np.zeros((3, CASES))
    for cases, truth, water in scans:
        told = truth.scored & (cases >= 0)
        size = max(1, int(np.count_nonzero(truth.solid)))
        for number, part in enumerate((told, told & truth.solid, told & truth.surface)):
            counts[number] += np.bincount(cases[part], minlength=CASES) / size
        counts[0] += _WATER * water / size
    total = counts[0] + _PRIOR
    return (
        (counts[1] + _PRIOR * _PRIOR_SOLID) / total,
        (counts[2] + _PRIOR * _PRIOR_SURFACE) / total,
    )


def reliability(scans: Iterable[Cases], solid: Float64) -> Iterator[tuple[int, float, float]]:
    """Of each tenth of probability: voxels, mean probability, and the share that is the object."""
    expected, actual = [], []
    for cases, truth, _ in scans:
        told = truth.scored & (cases >= 0)
        expected.append(solid[cases[told]])
        actual.append(truth.solid[told])
    p, y = np.concatenate(expected), np.concatenate(actual)
    tenth = np.minimum((p * 10).astype(int), 9)
    for k in range(10):
        inside = tenth == k
        if inside.any():
            yield int(inside.sum()), float(p[inside].mean()), float(y[inside].mean())


def calibration_error(scans: Iterable[Cases], solid: Float64) -> float:
    """Expected calibration error: the mean distance of the two, weighted by voxels."""
    rows = list(reliability(scans, solid))
    return sum(n * abs(p - y) for n, p, y in rows) / sum(n for n, _, _ in rows)


def _all(scans: Iterable[tuple[str, str, str, int]]) -> list[Cases]:
    """Scans by their arguments, a process for each core."""
    with ProcessPoolExecutor() as pool:
        return list(pool.map(carved, *zip(*scans, strict=True)))


def main() -> None:
    """Learn, or check, and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="leave the table as it is")
    parser.add_argument("--seeds", type=int, default=len(SEEDS), help="of each, at most 3")
    options = parser.parse_args()
    seeds = SEEDS[: options.seeds]
    if not options.check:
        scans = _all(product(LEARNT, PATHS, NOISE, seeds))
        solid, surface = (share.clip(0.001, 0.999).round(4) for share in shares(scans))
        table = {"objects": LEARNT, "seeds": seeds, "paths": list(PATHS), "noise": list(NOISE)}
        lines = [f'  "{key}": {json.dumps(value)},' for key, value in table.items()]
        lines += [f'  "solid": {json.dumps(solid.tolist())},']
        lines += [f'  "surface": {json.dumps(surface.tolist())}']
        _TABLE.write_text("{\n" + "\n".join(lines) + "\n}\n", encoding="utf-8")
    solid = np.array(json.loads(_TABLE.read_text(encoding="utf-8"))["solid"])
    for noise in NOISE:
        everything: list[Cases] = []
        for name in HELD_BACK:
            scans = _all((name, path, noise, seeds[0]) for path in PATHS)
            everything += scans
            error = calibration_error(scans, solid)
            print(f"{name}, {noise}: expected calibration error {error:.3f}")
        print(f"held-back objects, {noise}: {calibration_error(everything, solid):.3f}")
        print("voxels, mean probability, share that is the object:")
        for number, probability, share in reliability(everything, solid):
            print(f"{number:9d}  {probability:.3f}  {share:.3f}")


if __name__ == "__main__":
    main()
