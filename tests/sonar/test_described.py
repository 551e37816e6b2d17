"""Sonars as worlds describe them: real SDF models, rays, and Stonefish scenarios."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from insonify.cli import app
from insonify.errors import WorldError
from insonify.frames import transform_from_pose
from insonify.sonar.described import described_sonars
from insonify.sonar.devices import Kind, named_device

MODELS = Path(__file__).resolve().parents[3] / "shared" / "data" / "models"
SCENARIO = """<?xml version="1.0"?>
<scenario><robot name="auv">
<sensor name="fls" type="fls" rate="5">
  <specs beams="512" bins="500" horizontal_fov="120.0" vertical_fov="30.0"/>
  <settings range_min="0.5" range_max="10.0" gain="1.1"/>
  <origin xyz="0.4 0.1 0.2" rpy="1.5707963267948966 0.0 1.5707963267948966"/>
  <link name="Vehicle"/>
</sensor>
<sensor name="scan" type="msis">
  <specs step="0.25" bins="400" horizontal_beam_width="2.0" vertical_beam_width="30.0"/>
  <settings range_min="0.5" range_max="20.0" rotation_min="-50.0" rotation_max="50.0"/>
</sensor>
<sensor name="imu" type="imu"/>
</robot></scenario>
"""
RAYS = """<sdf version="1.6"><model name="m"><pose>9 9 9 0 0 0</pose><link name="l">
<pose>0.1 0 -0.2 0 0.3 0</pose><sensor type="ray" name="fls"><pose>0.4 0 0 0 0 0</pose>
<update_rate>7</update_rate><ray><scan>
<horizontal><samples>128</samples><min_angle>-0.5</min_angle><max_angle>0.5</max_angle></horizontal>
<vertical><samples>9</samples><min_angle>-0.1</min_angle><max_angle>0.1</max_angle></vertical></scan>
<range><min>0.5</min><max>20</max><resolution>0.05</resolution></range></ray>
<plugin filename="libimaging_sonar_plugin.so" name="p"/></sensor>
<sensor type="ray" name="laser"><ray/></sensor></link></model></sdf>
"""


@pytest.mark.parametrize(
    ("model", "told"),
    [
        ("sonar_blueview_p900_nps_multibeam",
         {"azimuth_fov_deg": 90.0, "elevation_fov_deg": 20.0, "beams": 512, "range_min_m": 0.2,
          "range_max_m": 10.0, "frequency_khz": 900.0, "rate_hz": 10.0, "bins": 391}),
        ("sonar_oculus_m1200d_nps_multibeam",
         {"azimuth_fov_deg": 60.0, "elevation_fov_deg": 12.0, "beams": 256, "range_min_m": 0.1,
          "range_max_m": 1.2, "frequency_khz": 2100.0, "rate_hz": 10.0, "bins": 389}),
    ],
)  # fmt: skip
def test_sonars_of_real_models(model: str, told: dict[str, Any]) -> None:
    if not (MODELS / model).is_dir():
        pytest.skip(f"{MODELS / model} is not there")
    (table,) = described_sonars(MODELS / model)
    assert {key: table[key] for key in told} == pytest.approx(told, abs=1e-5)
    device = named_device(f"{MODELS / model}/model.sdf#image_sonar")
    assert device.kind is Kind.FORWARD_LOOKING and device.geometry.beams == told["beams"]


def test_a_sonar_of_rays_and_where_it_sits(tmp_path: Path) -> None:
    """The link's pose and the sensor's, not the model's; a laser is no sonar."""
    path = tmp_path / "m.sdf"
    path.write_text(RAYS)
    (table,) = described_sonars(path)
    assert table["beams"] == 128 and table["bins"] == 390 and table["name"] == "fls"
    device = named_device(str(path))
    assert device.tilt_deg == pytest.approx(17.188734, abs=1e-5)
    place = device.geometry.mount.position_m
    assert place == pytest.approx((0.1 + 0.4 * 0.955336, 0.0, -0.2 - 0.4 * 0.295520), abs=1e-5)


def test_sonars_of_a_stonefish_scenario(tmp_path: Path) -> None:
    """Its sensors look along z with x to starboard, on a link with z down."""
    path = tmp_path / "a.scn"
    path.write_text(SCENARIO)
    fls, scan = (named_device(f"{path}#{name}") for name in ("fls", "scan"))
    assert (fls.beams, fls.bins, fls.azimuth_fov_deg, fls.elevation_fov_deg) == (512, 500, 120, 30)
    # roll 90, then yaw 90 degrees: z is ahead, x to starboard, y down, as a sonar that looks ahead
    mount = transform_from_pose(fls.geometry.mount)
    assert mount[:3, 0] == pytest.approx([1, 0, 0], abs=1e-6)
    assert mount[:3, 2] == pytest.approx([0, 0, 1], abs=1e-6)
    assert fls.geometry.mount.position_m == pytest.approx((0.4, -0.1, -0.2))
    assert scan.kind is Kind.SCANNING and scan.sector_deg == 100 and scan.step_deg == 0.25
    down = transform_from_pose(scan.geometry.mount)[:3, 0]
    assert down == pytest.approx([0, 0, -1], abs=1e-6)
    with pytest.raises(WorldError, match=r"several sonars; say which.*#NAME: fls, scan"):
        named_device(str(path))
    with pytest.raises(WorldError, match="no sonar named 'nor'"):
        named_device(f"{path}#nor")
    path.write_text(SCENARIO.replace('"512"', '"$(arg beams)"'))
    with pytest.raises(
        WorldError, match=r"a\.scn.*'fls'.*beams is '\$\(arg beams\)', not a number"
    ):
        described_sonars(path)
    path.write_text("<scenario/>")
    with pytest.raises(WorldError, match="no sensor in it"):
        described_sonars(path)


def test_a_world_that_includes_a_sonar_runs_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "sonar").mkdir()
    (tmp_path / "sonar/model.sdf").write_text(RAYS)
    (tmp_path / "sonar/model.config").write_text(
        "<model><name>sonar</name><sdf version='1.6'>model.sdf</sdf></model>"
    )
    world = tmp_path / "w.world"
    world.write_text(
        "<sdf version='1.6'><world name='w'><include><uri>model://sonar</uri></include>"
        "<model name='b'><pose>6 0 0 0 0 0</pose><link name='l'><visual name='v'><geometry><box>"
        "<size>1 1 1</size></box></geometry></visual></link></model></world></sdf>"
    )
    listed = CliRunner().invoke(app, ["sonars", str(world), "--json"])
    (device,) = json.loads(listed.stdout)
    assert device["name"] == "fls" and device["beams"] == 128
    text = CliRunner().invoke(app, ["sonars", str(world)]).stdout
    (tmp_path / "s.toml").write_text(text)
    assert named_device(str(tmp_path / "s.toml")).model_dump(mode="json") == device
    done = CliRunner().invoke(
        app,
        ["simulate", str(world), "--sonar", str(world), "--pose", "0 0 1 0 0 0",
         "--out", str(tmp_path / "o"), "--json"],
    )  # fmt: skip
    assert json.loads(done.stdout)["sonar"] == "fls"
