"""The worlds of Cerqueira et al. 2017, section 4: a tank, a grid, structures on the seabed.

The paper shows pictures of them without dimensions; those here are chosen.
"""

from __future__ import annotations

import math

import numpy as np
import trimesh

from insonify.frames import transform_from_pose
from insonify.scene import Body, Scene
from insonify.scene.materials import Material, NormalMap, material_named
from insonify.scene.seabed import Seabed, procedural_seabed
from insonify.types import Float32, Float64, Pose

Triple = tuple[float, float, float]

TANK_M: Triple = (10.0, 7.0, 4.0)
GRID_M = 8.0
DEPTH_M = 20.0


def tank() -> Scene:
    """A basin of 10 x 7 x 4 m, water to its brim at z = 0, of rough tiles, with two targets."""
    x, y, z = TANK_M
    thick = 0.3
    relief = _tiles(64)
    concrete = _named("concrete")
    slabs = {
        "floor": ((x, y, thick), (0.0, 0.0, -z - thick / 2)),
        "wall east": ((thick, y, z), (x / 2 + thick / 2, 0.0, -z / 2)),
        "wall west": ((thick, y, z), (-x / 2 - thick / 2, 0.0, -z / 2)),
        "wall north": ((x, thick, z), (0.0, y / 2 + thick / 2, -z / 2)),
        "wall south": ((x, thick, z), (0.0, -y / 2 - thick / 2, -z / 2)),
    }
    bodies = []
    for name, (size, centre) in slabs.items():
        slab = _box(size, centre)
        flat = [axis for axis in range(3) if size[axis] != thick]
        uv = np.asarray(slab.vertices)[:, flat] / 0.5
        bodies.append(Body(name, slab, concrete, NormalMap(relief, uv)))
    pillar = trimesh.creation.cylinder(0.35, 2.5, sections=48)
    pillar.apply_translation((2.6, 1.2, -z + 1.25))
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.4)
    ball.apply_translation((2.0, -1.3, -z + 0.4))
    bodies += [Body("pillar", pillar, _named("steel")), Body("ball", ball, _named("rubber"))]
    return Scene(tuple(bodies))


def grid() -> Scene:
    """A square fence of steel bars, 8 m wide and 4 m high, on a level seabed at 20 m depth."""
    half = GRID_M / 2
    bars = []
    for side in range(4):
        angle = side * math.pi / 2
        turn = transform_from_pose(Pose(0.0, 0.0, 0.0, yaw_rad=angle))
        for offset in np.arange(-half, half, 0.8):
            upright = trimesh.creation.cylinder(0.05, 4.0, sections=12)
            upright.apply_translation((half, float(offset), -DEPTH_M + 2.0))
            bars.append(upright.apply_transform(turn))
        for height in (0.8, 2.0, 3.2):
            rail = trimesh.creation.cylinder(0.05, GRID_M, sections=12)
            rail.apply_transform(transform_from_pose(Pose(0.0, 0.0, 0.0, roll_rad=math.pi / 2)))
            rail.apply_translation((half, 0.0, -DEPTH_M + height))
            bars.append(rail.apply_transform(turn))
    return Scene((Body("grid", _joined(bars), _named("steel")),), _seabed(1), _named("sand"))


def structures() -> Scene:
    """What stands on the seabed of an oil field: manifold, wellheads, pipelines, boulders."""
    floor = -DEPTH_M
    base = [
        _box((5.0, 3.6, 0.5), (9.0, 0.0, floor + 0.25)),
        _box((3.4, 2.2, 1.6), (9.0, 0.0, floor + 1.3)),
    ]
    for x in (7.0, 11.0):
        for y in (-1.4, 1.4):
            post = trimesh.creation.cylinder(0.15, 3.0, sections=16)
            post.apply_translation((x, y, floor + 1.5))
            base.append(post)
    wells = []
    for x, y in ((5.0, 5.5), (13.0, 6.5), (6.0, -6.0)):
        for radius, height in ((0.7, 0.6), (0.35, 2.2)):
            part = trimesh.creation.cylinder(radius, height, sections=32)
            part.apply_translation((x, y, floor + height / 2))
            wells.append(part)
    pipes = [
        trimesh.creation.cylinder(0.2, segment=np.add([start, end], (0.0, 0.0, floor + 0.2)))
        for start, end in (
            ((9.0, 1.8, 0.0), (5.0, 5.5, 0.0)),
            ((9.0, 1.8, 0.0), (13.0, 6.5, 0.0)),
            ((9.0, -1.8, 0.0), (6.0, -6.0, 0.0)),
            ((11.5, 0.0, 0.0), (28.0, -4.0, 0.0)),
        )
    ]
    rng = np.random.default_rng(4)
    boulders = []
    for _ in range(24):
        stone = trimesh.creation.icosphere(subdivisions=2, radius=float(rng.uniform(0.15, 0.5)))
        stone.apply_translation((*rng.uniform((-2.0, -10.0), (20.0, 10.0)), floor))
        boulders.append(stone)
    parts = {
        "manifold": (base, "steel"),
        "wellheads": (wells, "steel"),
        "pipelines": (pipes, "steel"),
    }
    bodies = [
        Body(name, _joined(meshes), _named(material))
        for name, (meshes, material) in (parts | {"boulders": (boulders, "rock")}).items()
    ]
    return Scene(tuple(bodies), _seabed(2), _named("sand"))


def bumpy_sphere(bumpy: bool = True, material: Material = Material("default")) -> Scene:
    """A sphere of 1 m, with a normal map or without (Fig. 5)."""
    ball = trimesh.creation.uv_sphere(radius=1.0, count=[128, 128])
    points = np.asarray(ball.vertices)
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    elevation = np.arcsin(np.clip(points[:, 2], -1.0, 1.0))
    uv = np.column_stack([azimuth, elevation]) / (2 * math.pi) * 24
    relief = NormalMap(_tiles(64), uv) if bumpy else None
    return Scene((Body("sphere", ball, material, relief),))


EXPERIMENTS = {"tank": tank, "grid": grid, "structures": structures}


def _named(name: str) -> Material:
    material = material_named(name)
    assert material is not None
    return material


def _joined(meshes: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    joined = trimesh.util.concatenate(meshes)
    assert isinstance(joined, trimesh.Trimesh)
    return joined


def _box(size_m: Triple, centre_m: Triple) -> trimesh.Trimesh:
    box: trimesh.Trimesh = trimesh.creation.box(size_m)
    box.apply_translation(centre_m)
    return box


def _seabed(seed: int) -> Seabed:
    return procedural_seabed(
        np.random.default_rng(seed), size_m=80.0, depth_m=DEPTH_M, relief_m=0.06,
        correlation_m=1.5, cell_m=0.25,
    )  # fmt: skip


def _tiles(size: int) -> Float32:
    """A normal map of a pillow-shaped tile with a joint around it."""
    across = (np.arange(size) + 0.5) / size * 2.0 - 1.0
    slope: Float64 = 0.9 * across * np.abs(across) ** 3
    x, y = np.meshgrid(slope, slope)
    normals = np.dstack([x, y, np.ones_like(x)])
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    return np.ascontiguousarray(normals, np.float32)
