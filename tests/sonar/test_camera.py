"""The camera, where OpenGL is."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from insonify.errors import RendererError
from insonify.scene import Body, Scene
from insonify.sonar.camera import Camera, CameraSettings
from insonify.types import Pose

SMALL = CameraSettings(width_px=160, height_px=120, fov_deg=90, visibility_m=50)


def _camera(settings: CameraSettings = SMALL) -> Camera:
    try:
        return Camera(settings)
    except RendererError as err:
        pytest.skip(str(err))


def _box_at(x: float, y: float, z: float) -> Scene:
    box = trimesh.creation.box((2.0, 2.0, 2.0))
    box.apply_translation((x, y, z))
    return Scene((Body("box", box),))


def _seen(scene: Scene, camera: Camera, pose: Pose = Pose(0, 0, 0)) -> np.ndarray:
    """Pixels that differ from open water, (N, 2): row, column."""
    picture = camera.take(scene, pose).astype(int)
    assert picture.shape == (120, 160, 3)
    water = np.array(camera.take(_box_at(-500.0, 0.0, 0.0), pose)[0, 0], int)
    return np.argwhere(np.abs(picture - water).sum(axis=2) > 12)


def test_left_is_left_and_up_is_up() -> None:
    camera = _camera()
    left, up = _seen(_box_at(6, 3, 0), camera), _seen(_box_at(6, 0, 3), camera)
    assert left[:, 1].max() < 80 and abs(left[:, 0].mean() - 59.5) < 2
    assert up[:, 0].max() < 60 and abs(up[:, 1].mean() - 79.5) < 2


def test_a_box_is_as_large_as_perspective_says() -> None:
    seen = _seen(_box_at(6, 0, 0), _camera())
    # its front face is 5 m away: 2 / 5 of half the width, 80 pixels, is 2 / 5 * 80 = 32 across
    assert np.ptp(seen[:, 1]) + 1 == pytest.approx(32, abs=2)


def test_farther_is_paler() -> None:
    camera = _camera()
    water = camera.take(_box_at(-500.0, 0, 0), Pose(0, 0, 0))[60, 80].astype(int)
    contrast = [
        np.abs(camera.take(_box_at(x, 0, 0), Pose(0, 0, 0))[60, 80] - water).sum()
        for x in (3.0, 10.0, 25.0)
    ]
    assert contrast[0] > contrast[1] > contrast[2]


def test_the_same_pose_gives_the_same_picture() -> None:
    camera, scene = _camera(), _box_at(5, 1, -1)
    first = camera.take(scene, Pose(0, 0, 0, yaw_rad=0.1))
    np.testing.assert_array_equal(first, camera.take(scene, Pose(0, 0, 0, yaw_rad=0.1)))
