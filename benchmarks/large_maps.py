"""Maps larger than memory: ``python -m benchmarks.large_maps [--quick] [--out DIR]``.

A simulated lawnmower over 1 km x 200 m of relief with wrecks, 20,000 pings of a head of 130 x 20
degrees and 20 m, mapped at 0.1 m with 500 MB for the map's blocks.  Before it a part of the survey
that fits into memory is mapped both ways, on disk with a twentieth of what its map takes: the ratio
of their speeds, and whether both maps are the same, byte for byte.  ``--quick`` is that part alone.

Each map is made by a process of its own; pings/s are those of mapping, without the simulation and
with the tiles that are written at the end.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.measure import machine
from insonify.frames import rotation_from_rpy
from insonify.io.maps import save_map
from insonify.io.maps.ondisk import BYTES_PER_BLOCK, TileStore
from insonify.mapping.bayes import BayesMapper
from insonify.mapping.mapper import MappingSettings
from insonify.mapping.voxels import VoxelMap
from insonify.scene import Body, Scene
from insonify.scene.meshes import place_mesh
from insonify.scene.objects import shipwreck
from insonify.scene.seabed import Seabed
from insonify.sonar import Sonar
from insonify.sonar.devices import SonarDevice
from insonify.types import Float64, Ping, Pose

WIDTH_M, LANE_M, STEP_M = 200.0, 25.0, 0.4
ABOVE_M, CELL_M = 6.0, 1.0
LENGTH_M, PART_M = 1000.0, 100.0
LIMIT_MB, SHARE = 500, 20
HEAD = SonarDevice(
    name="head of 130 degrees", azimuth_fov_deg=130.0, elevation_fov_deg=20.0, beams=256, bins=500,
    range_max_m=20.0, tilt_deg=20.0,
)  # fmt: skip


def _height_m(x_m: Float64, y_m: Float64) -> Float64:
    return np.asarray(
        -20.0 + 0.8 * np.sin(x_m / 11.0) * np.cos(y_m / 7.0) + 0.3 * np.sin((x_m + y_m) / 3.1),
        np.float64,
    )


def world(length_m: float) -> Scene:
    """Relief, and a wreck every 100 m."""
    x = np.arange(-40.0, length_m + 40.0, CELL_M)
    y = np.arange(-40.0, WIDTH_M + 40.0, CELL_M)
    seabed = Seabed(_height_m(*np.meshgrid(x, y)), CELL_M, (float(x[0]), float(y[0])))
    wrecks = []
    for k in range(int(length_m // 100.0)):
        at = 50.0 + 100.0 * k, 30.0 + (37.0 * k) % (WIDTH_M - 60.0)
        base_m = float(_height_m(*np.array(at)))
        turn = rotation_from_rpy(0.0, 0.0, 0.7 * k)
        wrecks.append(Body(f"wreck {k}", place_mesh(shipwreck(), *at, base_m, turn)))
    return Scene(tuple(wrecks), seabed)


def lanes(length_m: float) -> Iterator[Pose]:
    """The poses of a lawnmower along x."""
    for lane, y in enumerate(np.arange(LANE_M / 2, WIDTH_M, LANE_M)):
        along = np.arange(0.0, length_m, STEP_M)
        for x in along if lane % 2 == 0 else along[::-1]:
            yield Pose(
                float(x), float(y), -20.0 + ABOVE_M, yaw_rad=0.0 if lane % 2 == 0 else math.pi
            )


def survey(length_m: float) -> Iterator[tuple[Ping, Pose]]:
    """Its pings."""
    sonar, scene, rng = Sonar(HEAD), world(length_m), np.random.default_rng(0)
    for pose in lanes(length_m):
        yield sonar.ping(scene, pose, rng), pose


def map_it(length_m: float, memory_mb: float, folder: Path) -> None:
    """Map a survey, on disk if there is a limit, and print what it took as JSON."""
    voxels = VoxelMap(0.1)
    if memory_mb:
        voxels = VoxelMap(0.1, TileStore.new(folder / "map.zarr", int(1e6 * memory_mb)))
    mapper = BayesMapper(MappingSettings(voxel_m=0.1), voxels)
    seconds, pings = 0.0, 0
    for ping, pose in survey(length_m):
        since = time.perf_counter()
        mapper.integrate(ping, pose)
        seconds += time.perf_counter() - since
        pings += 1
        if pings % 1000 == 0:
            print(f"{pings} pings, {pings / seconds:.0f} a second", file=sys.stderr, flush=True)
    since = time.perf_counter()
    if isinstance(voxels.store, TileStore):
        voxels.store.settle(voxels.voxel_m, voxels.origin_m)
    ended = time.perf_counter() - since
    told: dict[str, float | str] = {
        "pings": pings,
        "map_mb": voxels.block_count * BYTES_PER_BLOCK / 1e6,
        "pings_per_s": pings / (seconds + ended),
        "writing_at_the_end_s": ended,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }
    if length_m <= PART_M:
        save_map(voxels, folder / "map.npz")
        told["sha256"] = hashlib.sha256((folder / "map.npz").read_bytes()).hexdigest()
    print(json.dumps(told))


def _made(length_m: float, memory_mb: float, folder: Path) -> dict[str, float | str]:
    folder.mkdir()
    call = [sys.executable, "-m", "benchmarks.large_maps", "--map", str(length_m), str(memory_mb)]
    done = subprocess.run([*call, str(folder)], check=True, stdout=subprocess.PIPE, text=True)
    told: dict[str, float | str] = json.loads(done.stdout)
    return told


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Maps larger than memory.")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out", type=Path, help="keep the maps here")
    parser.add_argument("--map", nargs=3, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.map:
        map_it(float(given.map[0]), float(given.map[1]), Path(given.map[2]))
        return
    with tempfile.TemporaryDirectory() as scratch:
        out = given.out or Path(scratch)
        out.mkdir(exist_ok=True)
        whole = _made(PART_M, 0.0, out / "part-in-memory")
        limit_mb = max(22.0, float(whole["map_mb"]) / SHARE)
        rows = {"part, in memory": (math.nan, whole)}
        rows["part, on disk"] = (limit_mb, _made(PART_M, limit_mb, out / "part-on-disk"))
        if not given.quick:
            rows["whole, on disk"] = (LIMIT_MB, _made(LENGTH_M, LIMIT_MB, out / "whole-on-disk"))
    table = Table("survey", "pings", "map, MB", "limit, MB", "peak, MB", "pings/s", title=machine())
    for name, (limit, told) in rows.items():
        table.add_row(
            name, f"{told['pings']}", f"{told['map_mb']:.0f}", f"{limit:.0f}",
            f"{told['peak_mb']:.0f}", f"{told['pings_per_s']:.1f}",
        )  # fmt: skip
    Console(width=80).print(table)
    part = rows["part, on disk"][1]
    print(f"same bytes: {part['sha256'] == whole['sha256']}")
    ratio = float(part["pings_per_s"]) / float(whole["pings_per_s"])
    print(f"speed on disk in that of memory: {ratio:.2f}")


if __name__ == "__main__":
    main()
