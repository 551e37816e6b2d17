"""The physical model at every preset's own range: shadows are darker than sand, noise than both."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from insonify.scene import Body, Scene
from insonify.scene.materials import material_named
from insonify.scene.seabed import procedural_seabed
from insonify.sonar import Sonar
from insonify.sonar.devices import Kind, SonarDevice, named_device, sonar_presets
from insonify.sonar.physical import FAR, HIGH, PhysicalSettings
from insonify.types import Float64, Pose

FORWARD = [name for name in sonar_presets() if named_device(name).kind is Kind.FORWARD_LOOKING]


def _part(name: str) -> SonarDevice:
    """A sector of a preset, with its own beams and half of its bins."""
    device = named_device(name)
    beams = min(device.beams, 40)
    return device.model_copy(
        update={
            "beams": beams,
            "azimuth_fov_deg": device.azimuth_fov_deg * beams / device.beams,
            "bins": device.bins // 2,
            "tilt_deg": 0.0,
        }
    )


def _power(device: SonarDevice, scene: Scene, pose: Pose) -> Float64:
    """The power, after gain, that a ping's image shows, (bins, beams)."""
    ping = Sonar(device, physical=PhysicalSettings()).ping(scene, pose)
    power: Float64 = ping.image.astype(float) ** (2.0 / device.display_gamma)
    return power


@pytest.mark.parametrize("name", FORWARD)
def test_shadows_are_6_db_darker_than_level_sand(name: str) -> None:
    device = _part(name)
    far_m = device.range_max_m
    sand = material_named("sand")
    assert sand is not None
    seabed = procedural_seabed(
        np.random.default_rng(0), size_m=2.5 * far_m, depth_m=0.0, relief_m=0.0,
        correlation_m=far_m, cell_m=far_m / 20,
    )  # fmt: skip
    bodies = []
    for k, share in enumerate((0.25, 0.45, 0.62)):
        half_m = math.tan(math.radians(device.azimuth_fov_deg) / 2) * share * far_m
        wall = trimesh.creation.box((0.01 * far_m, half_m, 0.03 * far_m))
        wall.apply_translation((share * far_m, half_m / 2 * (1 if k % 2 else -1), 0.0))
        bodies.append(Body(f"wall {k}", wall, sand))
    scene = Scene(tuple(bodies), seabed, sand)
    pose = Pose(0.0, 0.0, HIGH * far_m, pitch_rad=math.atan2(HIGH, 0.42))
    truth = Sonar(device, physical=PhysicalSettings()).truth(scene, pose)
    power, range_m = _power(device, scene, pose), device.geometry.bin_ranges_m[:, None]
    lit, dark = truth.label == len(bodies), truth.shadow
    compared = 0
    for low in np.arange(0.2, FAR, 0.05):
        near = (range_m >= low * far_m) & (range_m < (low + 0.05) * far_m)
        if (lit & near).sum() < 100 or (dark & near).sum() < 100:
            continue
        contrast_db = 10.0 * math.log10(power[lit & near].mean() / power[dark & near].mean())
        assert contrast_db > 6.0, f"{low:.2f} of the range"
        compared += 1
    assert compared >= 3
    noise = _power(device, Scene((), seabed, sand), replace(pose, pitch_rad=-1.5)).mean(axis=1)
    assert noise.max() < power[lit & (range_m < FAR * far_m)].mean(), "nowhere above the seabed"
