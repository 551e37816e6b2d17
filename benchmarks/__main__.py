"""The benchmark table: medians over repeats, peers in the same run, written to build/bench.json."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import octomap
from rich.console import Console
from rich.table import Table
from sklearn.cluster import DBSCAN

from benchmarks import navigation
from benchmarks.measure import Row, machine, median_s, write
from insonify.frames import directions_from_angles, world_from_sonar
from insonify.mapping.bayes import BayesMapper
from insonify.mapping.carving import CarvingMapper
from insonify.mapping.mapper import Mapper, MappingSettings
from insonify.mission.setup import World, scenario_config
from insonify.planning.active import EntropyPlanner
from insonify.planning.baselines import path_over_centre
from insonify.planning.dbscan import dbscan
from insonify.planning.gain import expected_gain
from insonify.types import Float64, Nav, Ping, Pose


def _wreck() -> tuple[World, list[Pose], list[Ping]]:
    """The wreck scenario, its first scan and that scan's pings."""
    world = World(scenario_config("wreck"))
    rng = np.random.default_rng(0)
    poses = list(path_over_centre(world.area, 0.0).waypoints)
    return world, poses, [world.sonar.ping(world.scene, pose, rng) for pose in poses]


def sonar() -> Iterator[Row]:
    """Complete images of Table 1's sonar on the wreck scene."""
    world, poses, _ = _wreck()
    rng = np.random.default_rng(0)

    def scan() -> None:
        for pose in poses:
            world.sonar.ping(world.scene, pose, rng)

    yield Row("sonar, wreck scene", len(poses) / median_s(scan, 7), "images/s", at_least=30)


def mapping() -> Iterator[Row]:
    """The map update, and OctoMap inserting the same evidence."""
    world, poses, pings = _wreck()

    def scan(make: Callable[[MappingSettings], Mapper] = BayesMapper) -> None:
        mapper = make(world.config.mapping)
        for ping, pose in zip(pings, poses, strict=True):
            mapper.integrate(ping, pose)

    ours = median_s(scan, 9) / len(poses)
    yield Row("map update, 0.1 m voxels", 1.0 / ours, "pings/s", at_least=500)
    carved = median_s(lambda: scan(CarvingMapper), 5) / len(poses)
    yield Row("carving, 0.05 m inside, against it", carved / ours, "times its time", at_most=8)
    clouds = [_evidence_as_rays(pings[k], poses[k], world) for k in range(0, len(poses), 4)]
    voxel_m = world.config.mapping.voxel_m
    for name, insert in _peers(voxel_m).items():
        theirs = median_s(lambda insert=insert: insert(clouds), 3) / len(clouds)  # type: ignore[misc]
        yield Row(f"{name}, the same pings as 96 x 32 rays", 1e3 * theirs, "ms/ping")
        target = 50 if name == "OctoMap" else None
        yield Row(f"map update against {name}", theirs / ours, "times faster", at_least=target)


_Clouds = list[tuple[Float64, Float64]]


def _peers(voxel_m: float) -> dict[str, Callable[[_Clouds], None]]:
    """Other mappers, and what inserts clouds of (points, origin) into a new map of each.

    Those that no extra installs (``pip install dufomap pyoctomap``) only where they are.
    """

    def into_octomap(clouds: _Clouds, library: Any = octomap) -> None:
        tree = library.OcTree(voxel_m)
        for points, origin in clouds:
            tree.insertPointCloud(points, origin)

    def into_dufomap(clouds: _Clouds) -> None:
        grid = import_module("dufomap").dufomap(resolution=voxel_m, d_s=voxel_m, d_p=2)
        for points, origin in clouds:
            grid.run(points, [*origin, 1.0, 0.0, 0.0, 0.0], cloud_transform=False)

    peers: dict[str, Callable[[_Clouds], None]] = {"OctoMap": into_octomap}
    if find_spec("pyoctomap"):
        peers["pyoctomap"] = partial(into_octomap, library=import_module("pyoctomap"))
    if find_spec("dufomap"):
        peers["DUFOMap"] = into_dufomap
    return peers


def _evidence_as_rays(ping: Ping, pose: Pose, world: World) -> tuple[Float64, Float64]:
    """A ping as 32 rays a beam over the elevation, each ending at the beam's first echo."""
    geometry = ping.geometry
    occupied = ping.image > world.config.mapping.pixel_threshold / 255
    first = np.where(occupied.any(axis=0), occupied.argmax(axis=0), geometry.bins - 1)
    elevation = (np.arange(32) + 0.5) / 32 * geometry.elevation_fov_rad
    elevation -= geometry.elevation_fov_rad / 2
    azimuth, elevation = np.meshgrid(geometry.beam_azimuths_rad, elevation)
    transform = world_from_sonar(pose, geometry.mount)
    directions = directions_from_angles(azimuth, elevation) @ transform[:3, :3].T
    points = directions * geometry.bin_ranges_m[first][None, :, None] + transform[:3, 3]
    return np.ascontiguousarray(points.reshape(-1, 3)), np.array(pose.position_m)


def _shadow(count: int) -> np.ndarray:
    """High-entropy voxels as shadows leave them: solid blocks with a tenth missing at random."""
    side = round((count / 0.9) ** (1 / 3) + 1)
    rng = np.random.default_rng(0)
    cells = rng.choice(side**3, count, replace=False)
    return np.column_stack(np.unravel_index(np.sort(cells), (side,) * 3))


def _scattered(count: int) -> np.ndarray:
    """Voxels at random, three in ten: many small clusters, borders and noise."""
    side = round((count / 0.3) ** (1 / 3) + 1)
    cells = np.random.default_rng(1).choice(side**3, count, replace=False)
    return np.column_stack(np.unravel_index(cells, (side,) * 3))


def clusters() -> Iterator[Row]:
    """DBSCAN on voxels, and scikit-learn's on the same."""
    large = _shadow(1_000_000)
    seconds = median_s(lambda: dbscan(large, 1.75, 10), 7)
    yield Row("DBSCAN, 1,000,000 voxels", seconds, "s", at_most=0.5)
    yield Row("DBSCAN, 1,000,000 voxels, memory", _memory_mb(), "MB", at_most=300)
    for name, voxels in (("solid", _shadow(100_000)), ("scattered", _scattered(100_000))):
        peer = DBSCAN(eps=1.75, min_samples=10)
        same = np.array_equal(dbscan(voxels, 1.75, 10), peer.fit(voxels).labels_)
        if not same:
            raise AssertionError(f"labels differ from scikit-learn's on {name} voxels")
        ours = median_s(lambda v=voxels: dbscan(v, 1.75, 10), 15)  # type: ignore[misc]
        theirs = median_s(lambda v=voxels, p=peer: p.fit(v), 3)  # type: ignore[misc]
        yield Row(f"scikit-learn DBSCAN, 100,000 {name} voxels", theirs, "s")
        target = 50 if name == "solid" else None
        label = f"DBSCAN against scikit-learn, {name}, same labels"
        yield Row(label, theirs / ours, "times faster", at_least=target)


def _memory_mb() -> float:
    """Peak memory of clustering a million voxels above what stood before, in a fresh process."""
    code = (
        "import resource; from benchmarks.__main__ import _shadow, dbscan\n"
        "dbscan(_shadow(1000), 1.75, 10); voxels = _shadow(1_000_000)\n"
        "peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "import psutil; before = psutil.Process().memory_info().rss / 1024\n"
        "ballast = __import__('numpy').ones(max(0, int((peak() - before) * 128)))\n"
        "before = peak(); dbscan(voxels, 1.75, 10); print((peak() - before) / 1024)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return float(done.stdout)


def planning() -> Iterator[Row]:
    """Scoring the candidates of the wreck's first decision, and that whole decision."""
    world, poses, pings = _wreck()
    mapper = BayesMapper(world.config.mapping)
    for ping, pose in zip(pings, poses, strict=True):
        mapper.integrate(ping, pose)
    planner = world.planner()
    assert isinstance(planner, EntropyPlanner)
    nav = Nav(poses[-1], (path_over_centre(world.area, 0.0),))
    look = planner.next_scan(mapper, nav).look
    assert look is not None

    def score() -> Float64:
        cluster = look.cluster
        return expected_gain(
            mapper, look.candidates, planner.geometry, cluster.voxels_m, cluster.voxel_entropy
        )

    yield Row(
        f"{len(look.candidates)} candidates scored", 1e3 * median_s(score, 15), "ms", at_most=50
    )
    whole = median_s(lambda: planner.next_scan(mapper, nav), 7)
    yield Row("whole decision: entropy, clusters, gain", 1e3 * whole, "ms")


def vehicle() -> Iterator[Row]:
    """The whole loop of a vehicle, without rendering: 60 s under way over a rolling seabed."""
    scene, start, _ = navigation.course()
    end = Pose(start.x_m + 28.0, start.y_m, start.z_m)
    seconds: list[float] = []

    def fly() -> None:
        seconds.append(navigation.voyage(scene, start, (end,), 0).time_s)

    took_s = median_s(fly, 5)
    label = "vehicle: dynamics, sensors, filter, control"
    yield Row(label, seconds[-1] / took_s, "times real time", at_least=200)


def commands() -> Iterator[Row]:
    """The commands as processes, start to end; the first run compiles and is not counted."""
    program = [sys.executable, "-m", "insonify"]

    def run(*arguments: str) -> Callable[[], object]:
        return lambda: subprocess.run(
            [*program, *arguments], capture_output=True, check=True, cwd=folder
        )

    with tempfile.TemporaryDirectory() as folder:
        seconds = median_s(run("scan", "tetrapod"), 3)
        yield Row("insonify scan tetrapod, second run", seconds, "s", at_most=15)
        yield Row("insonify --help", median_s(run("--help"), 7), "s", at_most=0.5)


def main() -> int:
    """Print the table; the exit code says whether every target is met."""
    rows: list[Row] = []
    for group in (sonar, mapping, clusters, planning, vehicle, commands):
        rows += group()
    table = Table("what", "measured", "target", "", title=machine())
    for row in rows:
        bound = f">= {row.at_least:g}" if row.at_least is not None else ""
        bound = f"<= {row.at_most:g}" if row.at_most is not None else bound
        verdict = "" if not bound else "ok" if row.ok else "MISSED"
        table.add_row(row.name, f"{row.value:.4g} {row.unit}", bound, verdict)
    Console(width=110).print(table)
    write(rows, Path("build/bench.json"))
    print("The rows are in build/bench.json.")
    return 0 if all(row.ok for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
