"""Mirrored echoes come at the ranges of mirrored paths, and as strong as the mirror says."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

from insonify.errors import RendererError
from insonify.scene import Body, Material, Scene
from insonify.sonar import Sonar
from insonify.sonar.devices import SonarDevice
from insonify.sonar.embree import EmbreeRenderer
from insonify.sonar.histogram import EchoHistogram, Law, Response
from insonify.sonar.opengl import OpenGLRenderer
from insonify.sonar.physical import PhysicalSettings
from insonify.sonar.sampling import SamplingSettings
from insonify.types import Pose

DEVICE = SonarDevice(
    azimuth_fov_deg=20, elevation_fov_deg=90, beams=21, bins=600, range_max_m=30, tilt_deg=0
)
EYE = Pose(0.0, 0.0, -4.0)


def _ball(x: float, z: float, radius: float = 0.25) -> trimesh.Trimesh:
    ball: trimesh.Trimesh = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    ball.apply_translation((x, 0.0, z))
    return ball


def _peaks(echoes: EchoHistogram) -> list[float]:
    """Ranges at which echoes begin, in the middle beam."""
    heard = echoes.echo[:, 8:13].sum(axis=1)
    heard = heard > 0.01 * heard.max()
    starts = np.flatnonzero(heard[1:] & ~heard[:-1]) + 1
    return [float(k) * 0.05 for k in starts]


def _render(scene: Scene, **flags: bool) -> EchoHistogram:
    response = Response(Law.LAMBERT, **flags)
    return EmbreeRenderer().render(scene, DEVICE.geometry, EYE, response)


def test_the_water_surface_shows_a_target_three_times() -> None:
    scene = Scene((Body("ball", _ball(12.0, -4.0), Material("steel", 1.4)),))
    direct = 12.0 - 0.25
    mirrored = math.hypot(12.0, 8.0) - 0.25
    assert _peaks(_render(scene)) == pytest.approx([direct], abs=0.06)
    found = _peaks(_render(scene, surface_mirror=True))
    mixed = (direct + mirrored) / 2
    assert found == pytest.approx([direct, mixed, mirrored], abs=0.12)


def test_what_the_surface_shows_twice_is_weaker_and_all_else_stays() -> None:
    scene = Scene((Body("ball", _ball(12.0, -4.0), Material("steel", 1.4)),))
    plain, with_mirror = _render(scene), _render(scene, surface_mirror=True)
    direct = slice(0, 238)
    leak = 0.01 * plain.echo.max()  # limbs of the mirrored ball spread far in range
    np.testing.assert_allclose(plain.echo[direct], with_mirror.echo[direct], atol=leak)
    twice = with_mirror.echo[275:300].sum()
    seen_from = plain.echo.sum() * (12.0 / math.hypot(12.0, 8.0)) ** 2 * 0.9**2
    # Lambert: the mirror image is a ball as far as its path; elevation foreshortens its opening
    assert twice == pytest.approx(seen_from, rel=0.25)


def test_a_wall_mirrors_by_its_own_material() -> None:
    """A ball before a wall: out and back by the wall, along the axis, at wall + gap."""
    wall = trimesh.creation.box((0.2, 40.0, 40.0))
    wall.apply_translation((15.1, 0.0, -4.0))

    def scene(lambert_db: float) -> Scene:
        return Scene(
            (
                Body("wall", wall, Material("wall", 1.0, lambert_db)),
                Body("ball", _ball(8.0, -2.0), Material("steel", 1.4, -10.0)),
            )
        )

    image_m = math.hypot(22.0, 2.0)  # the ball's mirror image, 15 + 7 m ahead
    late = slice(int((image_m - 0.4) / 0.05), int((image_m + 0.4) / 0.05))
    for lambert_db in (-10.0, -16.0):
        echo = _render(scene(lambert_db), second_bounce=True).echo[late].sum()
        assert echo > 0.0
        kept = math.pi * 10 ** (lambert_db / 10)
        ratio = echo / kept**2
        if lambert_db == -10.0:
            first = ratio
    assert ratio == pytest.approx(first, rel=0.02)
    assert _render(scene(-10.0)).echo[late].sum() == 0.0


def test_the_surface_itself_echoes_by_lambert() -> None:
    """From a depth h, a level beam hears ``mu (sin^2 e1 - sin^2 e2) / (2 fov)``: sin e = h / r."""
    scene = Scene((Body("ball", _ball(29.0, -8.0, 0.1), Material("steel", 1.4)),))
    mu, depth_m = 10.0**-2.5, 4.0
    response = Response(Law.LAMBERT, surface=mu)
    echoes = EmbreeRenderer().render(scene, DEVICE.geometry, EYE, response).echo[:, 10]
    assert not _render(scene).echo[:500, 10].any()
    for near_m, far_m in ((6.0, 8.0), (8.0, 12.0), (12.0, 24.0)):
        heard = echoes[round(near_m / 0.05) : round(far_m / 0.05)].sum()
        sines = (depth_m / near_m) ** 2 - (depth_m / far_m) ** 2
        assert heard == pytest.approx(mu / (2 * math.pi / 2) * sines, rel=0.02)
    assert not echoes[: round(depth_m / math.sin(math.pi / 4) / 0.05) - 1].any()


@pytest.mark.parametrize("elevation_deg", [2.0, 5.0, 8.0, 16.0, 27.0])
def test_side_lobes_over_the_elevation_are_those_of_a_line(elevation_deg: float) -> None:
    """A ball on the axis and one above it: 3 dB down each way at the edge, -13 dB in the first."""
    edge = math.radians(5.0)
    response = Response(Law.LAMBERT, edge_db=3.0, lobes_edge_rad=edge)

    def heard(angle: float, chosen: Response) -> float:
        ball = _ball(12.0 * math.cos(angle), -4.0 + 12.0 * math.sin(angle), 0.1)
        fine = EmbreeRenderer(SamplingSettings(over_elevation=2048, across_beam=8))
        scene = Scene((Body("ball", ball, Material("steel", 1.4)),))
        return float(fine.render(scene, DEVICE.geometry, EYE, chosen).echo.sum())

    angle = math.radians(elevation_deg)
    even = heard(angle, Response(Law.LAMBERT)) / heard(0.0, Response(Law.LAMBERT))
    loss = heard(angle, response) / heard(0.0, response) / even
    lost = np.sinc(0.4429 * math.sin(angle) / math.sin(edge)) ** 4
    assert loss == pytest.approx(lost, rel=0.1)
    if elevation_deg == 5.0:
        assert 10 * math.log10(loss) == pytest.approx(-6.0, abs=0.4)


def test_with_side_lobes_the_ping_hears_the_bottom_below_its_beam() -> None:
    floor = trimesh.creation.box((200.0, 200.0, 0.2))
    floor.apply_translation((0.0, 0.0, -9.1))
    scene = Scene((Body("floor", floor, Material("sand", 1.0)),))
    device = DEVICE.model_copy(update={"elevation_fov_deg": 20.0})
    near = slice(round(10.2 / 0.05), round(26.0 / 0.05))  # 5 m over it, between 30 and 10 degrees
    plain = PhysicalSettings(noise=False, volume_db=-200.0, pulse=False)
    for lobes in (False, True):
        settings = plain.model_copy(update={"elevation_lobes": lobes})
        ping = Sonar(device, physical=settings).ping(scene, EYE)
        assert ping.geometry == device.geometry
        assert bool(ping.image[near].any()) is lobes


def test_opengl_says_that_mirrors_need_rays() -> None:
    try:
        renderer = OpenGLRenderer()
    except RendererError as err:
        pytest.skip(str(err))
    scene = Scene((Body("ball", _ball(12.0, -4.0)),))
    with pytest.raises(RendererError, match="embree"):
        renderer.render(scene, DEVICE.geometry, EYE, Response(surface_mirror=True))
