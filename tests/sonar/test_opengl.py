"""The two renderers hold against each other; OpenGL runs for real where EGL is."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

from insonify.errors import RendererError
from insonify.frames import rotation_from_rpy
from insonify.scene import Body, Material, Scene
from insonify.scene.materials import NormalMap
from insonify.scene.objects import shipwreck
from insonify.scene.seabed import Seabed, procedural_seabed
from insonify.sonar import Sonar
from insonify.sonar.devices import SonarDevice
from insonify.sonar.draws import drawn_key
from insonify.sonar.embree import EmbreeRenderer
from insonify.sonar.formation import ImageSettings, form_image, normalise_energy
from insonify.sonar.gpu import open_context
from insonify.sonar.histogram import Law, Response, gather
from insonify.sonar.opengl import OpenGLRenderer
from insonify.types import Pose

AGREEMENT, OF_ONE_BEAM = 0.02, 0.045
"""RMS between the two images, of full scale; outlines make nearly all of it, and one beam has few
cells without."""


@pytest.fixture(scope="module")
def opengl() -> OpenGLRenderer:
    try:
        return OpenGLRenderer()
    except RendererError as err:
        pytest.skip(str(err))


def _relief() -> Seabed:
    return procedural_seabed(
        np.random.default_rng(3), size_m=60, depth_m=0, relief_m=0.1, correlation_m=2, cell_m=0.25
    )


def _wreck() -> Scene:
    return Scene((Body("wreck", shipwreck(), Material("steel", 1.4)),), _relief())


def _bumpy_sphere() -> Scene:
    mesh = trimesh.creation.uv_sphere(radius=2.0, count=[64, 64])
    turned = mesh.vertices @ rotation_from_rpy(0.2, 0.4, 0.1).T
    uv = np.column_stack(
        [np.arctan2(mesh.vertices[:, 1], mesh.vertices[:, 0]), mesh.vertices[:, 2] / 2.0]
    )
    waves = np.sin(np.linspace(0, 2 * np.pi, 33)[:-1])
    normals = np.dstack([0.5 * np.tile(waves, (32, 1)), np.zeros((32, 32)), np.ones((32, 32))])
    normals = (normals / np.linalg.norm(normals, axis=2, keepdims=True)).astype(np.float32)
    ball = trimesh.Trimesh(turned + np.array([8.0, 0.5, 1.0]), mesh.faces, process=False)
    return Scene((Body("ball", ball, normal_map=NormalMap(normals, uv)),), _relief())


def _seabed() -> Scene:
    return Scene((), _relief())


SCENES = {"wreck": _wreck, "bumpy sphere": _bumpy_sphere, "seabed": _seabed}
DEVICES = {
    "table 1": SonarDevice(),
    "120 x 20": SonarDevice(
        azimuth_fov_deg=120, elevation_fov_deg=20, beams=128, bins=500, range_max_m=20, tilt_deg=25
    ),
    "one beam": SonarDevice(
        azimuth_fov_deg=3, elevation_fov_deg=35, beams=1, bins=500, range_max_m=20, tilt_deg=25
    ),
    "all around": SonarDevice(
        azimuth_fov_deg=180, elevation_fov_deg=20, beams=180, bins=400, range_max_m=20, tilt_deg=10
    ),
}


@pytest.mark.parametrize("scene", sorted(SCENES))
@pytest.mark.parametrize("device", sorted(DEVICES))
def test_both_renderers_make_one_image(opengl: OpenGLRenderer, scene: str, device: str) -> None:
    geometry = DEVICES[device].geometry
    made, pose = SCENES[scene](), Pose(-1.0, 0.4, 6.0, 0.05, 0.02, 0.1)
    lobes = Response(Law.LAMBERT, edge_db=3.0, lobes_edge_rad=0.05)
    for response in (Response(), Response(Law.LAMBERT, edge_db=3.0), lobes):
        ours = EmbreeRenderer().render(made, geometry, pose, response)
        theirs = opengl.render(made, geometry, pose, response)
        assert theirs.coverage.sum() == pytest.approx(ours.coverage.sum(), rel=0.01)
        assert theirs.echo.sum() == pytest.approx(ours.echo.sum(), rel=0.01)
        error = normalise_energy(theirs) - normalise_energy(ours)
        most = OF_ONE_BEAM if geometry.beams == 1 else AGREEMENT
        assert math.sqrt((error**2).mean()) < most


@pytest.mark.parametrize("bins", [500, 333])
def test_the_device_forms_the_image_that_the_cpu_does(opengl: OpenGLRenderer, bins: int) -> None:
    """The same counters and tables: the same speckle and noise in every pixel, to rounding."""
    scene, pose = _wreck(), Pose(-9.0, 0.0, 8.0)
    device = SonarDevice(bins=bins)
    for settings in (
        ImageSettings(),
        ImageSettings(speckle=0.5, noise=0.2),
        ImageSettings(noise=0),
    ):
        echoes = opengl.render(scene, device.geometry, pose, Response())
        for key in (0, 7, 2**64 - 1, 0x123456789ABCDEF0):
            ours = form_image(echoes, settings, key)
            theirs = opengl.image(scene, device.geometry, pose, Response(), settings, key)
            np.testing.assert_allclose(theirs, ours, atol=2e-6, rtol=0)
    sonar = Sonar(device, renderer=opengl)
    key = drawn_key(np.random.default_rng(3))
    ping = sonar.ping(scene, pose, np.random.default_rng(3))
    np.testing.assert_allclose(ping.image, form_image(
        opengl.render(scene, device.geometry, pose, sonar.response), ImageSettings(), key
    ), atol=2e-6, rtol=0)  # fmt: skip


def test_the_same_bytes_twice_and_samples_gather_to_the_same(opengl: OpenGLRenderer) -> None:
    scene, geometry, pose = _wreck(), SonarDevice().geometry, Pose(-9.0, 0.0, 8.0)
    first = opengl.render(scene, geometry, pose, Response())
    opengl.render(_bumpy_sphere(), geometry, pose, Response())
    again = opengl.render(scene, geometry, pose, Response())
    assert first.echo.tobytes() == again.echo.tobytes()
    (samples,) = opengl.sample(scene, geometry, pose, Response())
    assert samples.offsets[-1] == len(samples.range_m)
    gathered = gather([samples], geometry)
    np.testing.assert_allclose(gathered.coverage, first.coverage, rtol=1e-3, atol=1e-5)
    np.testing.assert_allclose(gathered.echo, first.echo, rtol=1e-3, atol=1e-5)
    assert set(samples.body.tolist()) <= {0, 1}


def test_chunks_out_of_reach_are_not_drawn(opengl: OpenGLRenderer) -> None:
    """Culling changes nothing: a scene with much behind and beyond, against rays."""
    floor = procedural_seabed(
        np.random.default_rng(1), size_m=200, depth_m=0, relief_m=0.2, correlation_m=3, cell_m=0.5
    )
    geometry = SonarDevice().geometry
    for yaw in np.arange(0, 6) * 1.1:
        pose = Pose(20.0 * math.cos(yaw), 20.0 * math.sin(yaw), 5.0, yaw_rad=float(yaw))
        ours = EmbreeRenderer().render(Scene((), floor), geometry, pose, Response())
        theirs = opengl.render(Scene((), floor), geometry, pose, Response())
        assert theirs.coverage.sum() == pytest.approx(ours.coverage.sum(), rel=0.01)


def test_what_is_missing_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    open_context.cache_clear()
    try:
        monkeypatch.setitem(sys.modules, "moderngl", None)
        with pytest.raises(RendererError, match=r"insonify\[opengl\].*--renderer embree"):
            open_context()
    finally:
        open_context.cache_clear()
