"""Drift of the vehicle's own navigation over 500 m, over many seeds, and whether it knows it.

python -m benchmarks.navigation [SEEDS]
"""

from __future__ import annotations

import math
import sys
import time

import numpy as np
from scipy.stats import chi2

from benchmarks.measure import machine
from insonify.frames import rotation_from_attitude
from insonify.scene import Scene
from insonify.scene.probes import ray_query
from insonify.scene.seabed import procedural_seabed
from insonify.types import Float64, Pose
from insonify.vehicle.craft import Craft
from insonify.vehicle.description import vehicle_named
from insonify.vehicle.settings import VehicleSettings

DISTANCE_M = 500.0


def course() -> tuple[Scene, Pose, tuple[Pose, ...]]:
    """A rolling seabed 15 m deep, and an L of two legs of 250 m, 5 m above it."""
    rng = np.random.default_rng(0)
    seabed = procedural_seabed(
        rng, size_m=640.0, depth_m=15.0, relief_m=0.3, correlation_m=10.0, cell_m=2.0
    )
    z = -10.0
    start, leg = Pose(-125.0, -125.0, z), DISTANCE_M / 2
    corner = Pose(start.x_m + leg, start.y_m, z)
    turned = Pose(corner.x_m, corner.y_m, z, yaw_rad=math.pi / 2)
    end = Pose(corner.x_m, corner.y_m + leg, z, yaw_rad=math.pi / 2)
    return Scene((), seabed), start, (corner, turned, end)


def voyage(scene: Scene, start: Pose, route: tuple[Pose, ...], seed: int) -> Craft:
    """Fly a route by the default sensors in a current."""
    current = {"velocity_m_s": (0.1, 0.05, 0.0), "varying_m_s": 0.03}
    settings = VehicleSettings.model_validate(
        {"name": "bluerov2", "navigation": "dvl", "current": current, "lost_m": 100.0}
    )
    rng = np.random.default_rng(seed)
    craft = Craft(vehicle_named("bluerov2"), settings, start, ray_query(scene), rng)
    craft.follower.follow(route)
    while not craft.follower.finished:
        craft.tick()
    return craft


def error_in_sigmas(craft: Craft) -> float:
    """Normalised squared error of position, velocity and attitude: chi-square, 9 degrees."""
    estimator = craft.estimator
    assert estimator is not None
    state, moment = estimator.state, craft.motion()
    true = craft.true_state
    turn = rotation_from_attitude(true[3:7])
    between = moment.turn.T @ turn
    angles = 0.5 * np.array(
        [
            between[2, 1] - between[1, 2],
            between[0, 2] - between[2, 0],
            between[1, 0] - between[0, 1],
        ]
    )
    velocity: Float64 = turn @ true[7:10]
    error = np.concatenate([true[:3] - state[:3], velocity - state[3:6], angles])
    return float(error @ np.linalg.solve(estimator.covariance[:9, :9], error))


def main() -> int:
    """Print the drifts; the exit code says whether both targets are met."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    scene, start, route = course()
    drifts, errors, simulated_s = [], [], 0.0
    voyage(scene, start, route[:1], 0)
    began = time.perf_counter()
    for seed in range(seeds):
        craft = voyage(scene, start, route, seed)
        away = math.dist(craft.true_pose.position_m[:2], craft.believed_pose.position_m[:2])
        drifts.append(away / craft.track.length_m)
        errors.append(error_in_sigmas(craft))
        simulated_s += craft.time_s
    speed = simulated_s / (time.perf_counter() - began)
    small = sum(drift < 0.01 for drift in drifts)
    low, high = chi2.ppf([0.025, 0.975], 9 * seeds) / seeds
    nees = float(np.mean(errors))
    print(machine())
    print(f"{seeds} seeds, {DISTANCE_M:g} m each, {speed:.0f} times real time, DVL rays included")
    quantiles = np.percentile(drifts, [50, 95, 100]) * 100
    print("drift, % of the way: median {:.2f}, 95 % {:.2f}, largest {:.2f}".format(*quantiles))
    print(f"under 1 %: {small} of {seeds} (at least {math.ceil(0.95 * seeds)})")
    print(f"mean NEES of 9 states: {nees:.2f}, 95 % bounds {low:.2f} to {high:.2f}")
    return 0 if small >= 0.95 * seeds and low < nees < high else 1


if __name__ == "__main__":
    sys.exit(main())
