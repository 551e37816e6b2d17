from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import trimesh

from insonify.errors import MeshError
from insonify.frames import rotation_from_rpy
from insonify.scene.meshes import load_mesh, place_mesh, scaled


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply", "glb", "gltf", "dae"])
def test_every_format_comes_back_with_its_size(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"box.{suffix}"
    box = trimesh.creation.box((1.0, 2.0, 3.0))
    if suffix == "gltf":
        files = trimesh.exchange.gltf.export_gltf(trimesh.Scene(box))  # type: ignore[no-untyped-call]
        for name, content in files.items():
            (tmp_path / name).write_bytes(content)
        path = tmp_path / "model.gltf"
    else:
        box.export(path)
    np.testing.assert_allclose(load_mesh(path, 2.0).extents, [2.0, 4.0, 6.0], rtol=1e-6)


def test_real_collada_mesh_has_its_known_size(real_mesh: Path) -> None:
    mesh = load_mesh(real_mesh)
    np.testing.assert_allclose(mesh.extents, [17.5, 12.6, 7.2], atol=0.06)
    assert len(mesh.faces) == 4171


def _write(path: Path, vertices: str, faces: str = "f 1 2 3\n") -> Path:
    path.write_text(vertices + faces)
    return path


TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("missing.obj", None, "no such mesh"),
        ("kind.xyz", "", "ends in"),
        ("empty.obj", "", "triangles|cannot be read"),
        ("empty.stl", "", "triangles|cannot be read"),
        ("broken.glb", "not a glb", "cannot be read"),
        ("broken.dae", "<COLLADA", "cannot be read"),
        ("points.obj", TRIANGLE, "triangles|cannot be read"),
        ("nan.obj", "v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not finite|cannot be read"),
        ("huge.obj", "v 0 0 0\nv 4100 0 0\nv 0 3700 0\nf 1 2 3\n", "scale"),
        ("point.obj", "v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", "no size|triangles"),
    ],
)
def test_bad_meshes_are_named_in_one_sentence(
    tmp_path: Path, name: str, content: str | None, message: str
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_text(content)
    with pytest.raises(MeshError, match=message) as caught:
        load_mesh(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_placing_turns_then_centres_and_stands_on_the_ground() -> None:
    box = trimesh.creation.box((4.0, 2.0, 1.0))
    box.apply_translation([7.0, 8.0, 9.0])
    placed = place_mesh(box, 1.0, -1.0, -20.0, rotation_from_rpy(0, 0, math.pi / 2))
    np.testing.assert_allclose(placed.bounds, [[0.0, -3.0, -20.0], [2.0, 1.0, -19.0]], atol=1e-9)


def test_scaling_drops_vertices_that_no_face_uses() -> None:
    mesh = trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [99, 99, 99]], [[0, 1, 2]], process=False
    )
    np.testing.assert_allclose(scaled(mesh, 2.0).extents, [2.0, 2.0, 0.0])


def test_units_and_upward_axis_are_the_files_own(tmp_path: Path) -> None:
    box = trimesh.creation.box((1.0, 2.0, 3.0))
    text = trimesh.exchange.dae.export_collada(box).decode()  # type: ignore[no-untyped-call]
    inches = text.replace("<up_axis>", '<unit name="inch" meter="0.0254"/><up_axis>')
    (tmp_path / "b.dae").write_text(inches)
    np.testing.assert_allclose(load_mesh(tmp_path / "b.dae").extents, [0.0254, 0.0508, 0.0762])
    box.export(tmp_path / "b.glb")
    np.testing.assert_allclose(load_mesh(tmp_path / "b.glb", up="auto").extents, [1, 3, 2])
    np.testing.assert_allclose(load_mesh(tmp_path / "b.glb", up="z").extents, [1, 2, 3])
    box.export(tmp_path / "b.stl")
    np.testing.assert_allclose(load_mesh(tmp_path / "b.stl", up="auto").extents, [1, 2, 3])


def test_a_part_is_found_by_its_name(tmp_path: Path, real_mesh: Path) -> None:
    parts = trimesh.Scene({"hull": trimesh.creation.box((4, 1, 1)), "mast": trimesh.creation.box()})
    parts.export(tmp_path / "ship.glb")  # type: ignore[no-untyped-call]
    np.testing.assert_allclose(load_mesh(tmp_path / "ship.glb", part="hull").extents, [4, 1, 1])
    with pytest.raises(MeshError, match=r"no part named 'keel'.*hull, mast"):
        load_mesh(tmp_path / "ship.glb", part="keel")
    assert len(load_mesh(real_mesh, part="SunkenShip").faces) == 4171


def test_a_triangle_without_its_corner_is_refused(tmp_path: Path) -> None:
    header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    header += "property float z\nelement face 1\nproperty list uchar int vertex_indices\n"
    (tmp_path / "bad.ply").write_text(header + "end_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n")
    with pytest.raises(MeshError, match=r"bad\.ply"):
        load_mesh(tmp_path / "bad.ply")


def test_collada_with_x_up_stands_upright(tmp_path: Path) -> None:
    """COLLADA 1.4: where x is up, -y is to the right and z comes out of the picture."""
    corner = trimesh.Trimesh([[0, 0, 0], [3, 0, 0], [0, 2, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3]])
    text = trimesh.exchange.dae.export_collada(corner).decode()  # type: ignore[no-untyped-call]
    assert "<up_axis>" in text
    path = tmp_path / "x.dae"
    path.write_text(text.replace("Y_UP", "X_UP").replace("Z_UP", "X_UP"))
    low, high = load_mesh(path, up="auto").bounds
    np.testing.assert_allclose([low, high], [[-2, -1, 0], [0, 0, 3]], atol=1e-9)
    low, high = load_mesh(path, up="z").bounds
    np.testing.assert_allclose([low, high], [[0, 0, 0], [3, 2, 1]], atol=1e-9)
