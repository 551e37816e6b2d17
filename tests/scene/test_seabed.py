from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from insonify.errors import MeshError
from insonify.scene.placing import ObjectSettings
from insonify.scene.seabed import Seabed, procedural_seabed, raster_seabed
from insonify.scene.staged import SeabedSettings, Stage


def _make(seed: int, relief_m: float = 0.3) -> Seabed:
    return procedural_seabed(
        np.random.default_rng(seed),
        size_m=40.0,
        depth_m=20.0,
        relief_m=relief_m,
        correlation_m=2.0,
        cell_m=0.5,
    )


def test_relief_has_the_asked_mean_and_spread_and_is_smooth() -> None:
    heights = _make(0).heights_m
    assert heights.mean() == pytest.approx(-20.0)
    assert heights.std() == pytest.approx(0.3)
    assert np.abs(np.diff(heights)).max() < 0.3


def test_same_seed_same_seabed() -> None:
    assert _make(3).heights_m.tobytes() == _make(3).heights_m.tobytes()
    assert _make(3).heights_m.tobytes() != _make(4).heights_m.tobytes()


def test_no_relief_is_level() -> None:
    assert np.ptp(_make(0, relief_m=0.0).heights_m) == 0.0


def test_height_is_bilinear_between_nodes() -> None:
    seabed = Seabed(np.array([[0.0, 1.0], [2.0, 3.0]]), 2.0, (10.0, 20.0))
    x, y = np.array([10.0, 12.0, 11.0, 0.0]), np.array([20.0, 22.0, 21.0, 0.0])
    np.testing.assert_allclose(seabed.height_at(x, y), [0.0, 3.0, 1.5, 0.0])


def test_triangles_pass_through_the_nodes_and_face_up() -> None:
    vertices, faces = _make(1).triangles()
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] > 0).all()
    np.testing.assert_allclose(
        _make(1).height_at(vertices[:, 0], vertices[:, 1]), vertices[:, 2], atol=1e-9
    )


def test_rasters_of_every_kind_agree(tmp_path: Path) -> None:
    heights = np.arange(12, dtype=np.float32).reshape(3, 4)
    np.save(tmp_path / "a.npy", heights)
    Image.fromarray(heights).save(tmp_path / "a.tif")
    Image.fromarray(heights.astype(np.uint8)).save(tmp_path / "a.png")
    rows = "\n".join(" ".join(map(str, row)) for row in heights)
    head = "ncols 4\nnrows 3\nxllcorner 0\nyllcorner 0\ncellsize 2\nNODATA_value -9999\n"
    (tmp_path / "a.asc").write_text(head + rows + "\n")
    for suffix in ("npy", "tif", "png", "asc"):
        seabed = raster_seabed(tmp_path / f"a.{suffix}", cell_m=2.0, depth_m=10.0)
        assert seabed.origin_m == (-3.0, -2.0)
        # the file's first row is the northern edge
        north_west = seabed.height_at(np.array([-3.0]), np.array([2.0]))[0]
        assert north_west == pytest.approx(heights[0, 0] - 10.0)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("none.npy", None, "no such"),
        ("a.txt", b"", "ends in"),
        ("a.npy", b"junk", "cannot be read"),
        ("a.png", b"junk", "cannot be read"),
        ("a.asc", b"ncols x\n", "cannot be read"),
    ],
)
def test_bad_rasters_are_named(
    tmp_path: Path, name: str, content: bytes | None, message: str
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(MeshError, match=message) as caught:
        raster_seabed(path, cell_m=1.0, depth_m=0.0)
    assert str(path) in str(caught.value)


def test_raster_with_gaps_or_too_small_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "gap.npy", np.array([[0.0, np.nan], [1.0, 2.0]]))
    np.save(tmp_path / "row.npy", np.zeros((1, 5)))
    with pytest.raises(MeshError, match="1 heights"):
        raster_seabed(tmp_path / "gap.npy", cell_m=1.0, depth_m=0.0)
    with pytest.raises(MeshError, match="2 x 2"):
        raster_seabed(tmp_path / "row.npy", cell_m=1.0, depth_m=0.0)


def test_a_slope_rises_where_it_is_told_to() -> None:
    level = procedural_seabed(
        np.random.default_rng(0), size_m=20, depth_m=7, relief_m=0, correlation_m=2, cell_m=0.5
    )
    slope = level.tilted(math.radians(10.0), math.radians(90.0))
    x, y = np.array([-3.0, 0.0, 5.0]), np.array([0.0, 4.0, -6.0])
    np.testing.assert_allclose(slope.height_at(x, y), -7 + math.tan(math.radians(10.0)) * y)
    assert level.tilted(0.0, 1.0) is level


def test_the_seed_turns_and_buries_an_object() -> None:
    settings = ObjectSettings(mesh="pipe", yaw_spread_deg=180.0, burial_spread_m=0.3)
    level = SeabedSettings(relief_m=0.0)
    stages = [Stage(settings, level, seed) for seed in (0, 1, 0)]
    boxes = [stage.box for stage in stages]
    assert boxes[0] == boxes[2] != boxes[1]
    depths = [-20.0 - box.low_m[2] for box in boxes]
    assert all(0.0 <= depth <= 0.3 for depth in depths)
    assert depths[0] != pytest.approx(depths[1])
    plain = Stage(ObjectSettings(mesh="pipe"), level, 5).box
    np.testing.assert_allclose(plain.low_m, [-2.5, -0.45, -20.0], atol=1e-6)
