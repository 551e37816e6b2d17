from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from insonify.errors import ConfigError, MeshError
from insonify.frames import rotation_from_rpy
from insonify.scene import Body, Material, Scene
from insonify.scene.materials import (
    NormalMap,
    material_named,
    material_table,
    read_materials,
    read_normal_map,
)


def _tile(normal: tuple[float, float, float], turn: np.ndarray) -> Scene:
    """A square in the y-z plane, turned, under a normal map of one normal."""
    corners = np.array([[5.0, -2, -2], [5.0, 2, -2], [5.0, 2, 2], [5.0, -2, 2]])
    mesh = trimesh.Trimesh(corners @ turn.T, [[0, 1, 2], [0, 2, 3]], process=False)
    uv = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])  # u along +y, v along +z
    normals = np.broadcast_to(np.asarray(normal, np.float32), (2, 2, 3)).copy()
    return Scene((Body("tile", mesh, normal_map=NormalMap(normals, uv)),))


def test_a_normal_map_bends_normals_by_its_tbn_matrix() -> None:
    turn = rotation_from_rpy(0.3, -0.2, 0.9)
    ray = (turn @ [1.0, 0.05, 0.1]).astype(np.float32)[None]
    ray /= np.linalg.norm(ray)
    for normal in ((0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (0.0, 0.6, 0.8), (0.48, 0.36, 0.8)):
        scene = _tile(normal, turn)
        hits = scene.cast(np.zeros(3), ray)
        expected = turn @ [-normal[2], normal[0], normal[1]]  # N faces the sonar, T = y, B = z
        np.testing.assert_allclose(scene.shading_normals(hits, ray)[0], expected, atol=1e-5)


def test_a_normal_map_is_read_bottom_up(tmp_path: Path) -> None:
    pixels = np.full((2, 1, 3), 128, np.uint8)
    pixels[1, 0] = [255, 128, 128]
    Image.fromarray(pixels).save(tmp_path / "n.png")
    assert read_normal_map(tmp_path / "n.png")[0, 0, 0] == pytest.approx(1.0)
    (tmp_path / "bad.png").write_text("no picture")
    with pytest.raises(MeshError, match=r"bad\.png"):
        read_normal_map(tmp_path / "bad.png")


def test_named_materials_keep_to_one_scale_and_name_their_source() -> None:
    steel = material_named("steel")
    assert steel is not None
    for name, row in material_table().items():
        assert row["source"]
        level = steel.lambert_db + 20 * math.log10(row["reflectance"] / steel.reflectance)
        assert row["lambert_db"] == pytest.approx(level, abs=1.0), name
        assert row["lambert_db"] <= -5.0, "more comes back than went in"


def test_materials_by_name_and_of_ones_own(tmp_path: Path) -> None:
    sand = material_named("UUVSimulator/SandAndStones")
    assert sand is not None and sand.name == "sand"
    assert material_named("unobtainium") is None
    (tmp_path / "m.toml").write_text("[Sand]\nreflectance = 2.12\n")
    own = read_materials(tmp_path / "m.toml")
    found = material_named("sand", own)
    assert found is not None and found.reflectance == 2.12
    for text, word in (("[x]\nshine = 1", "shine|may hold"), ("[x]\nreflectance = -1", "positive")):
        (tmp_path / "m.toml").write_text(text)
        with pytest.raises(ConfigError, match=word):
            read_materials(tmp_path / "m.toml")


def test_a_material_says_what_cannot_be() -> None:
    with pytest.raises(
        ConfigError, match="reflectance must be a positive number up to 1000, not -1"
    ):
        Material("mirror", -1.0)
