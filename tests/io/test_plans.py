"""Paths for real vehicles: geodesy in closed form, and files that other programs read."""

from __future__ import annotations

import copy
import csv
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader

from insonify.errors import GeometryError
from insonify.io.datum import Datum
from insonify.io.plans import heading_deg, qgroundcontrol, save_plan
from insonify.types import Pose, ScanPath

PATH = ScanPath((Pose(0.0, 0.0, -15.0), Pose(100.0, 200.0, -15.0, yaw_rad=math.pi / 2)))
DATUM = Datum(41.5, -71.3, 2.0)


def test_metres_north_and_east_are_degrees_by_the_ellipsoids_radii() -> None:
    a, f = 6378137.0, 1 / 298.257223563
    e2 = f * (2 - f)
    phi = math.radians(DATUM.latitude_deg)
    w = 1 - e2 * math.sin(phi) ** 2
    meridian, normal = a * (1 - e2) / w**1.5, a / math.sqrt(w)
    latitude, longitude, height = DATUM.geodetic(PATH.waypoints[1])
    assert latitude - 41.5 == pytest.approx(math.degrees(200.0 / meridian), rel=1e-4)
    assert longitude + 71.3 == pytest.approx(
        math.degrees(100.0 / (normal * math.cos(phi))), rel=1e-4
    )
    # the earth falls away beneath the tangent plane by d^2 / 2R
    assert height == pytest.approx(2.0 - 15.0 + (100**2 + 200**2) / (2 * 6.37e6), abs=1e-4)


@pytest.mark.parametrize(("yaw", "heading"), [(0, 90), (90, 0), (180, 270), (-90, 180)])
def test_headings_are_clockwise_from_north(yaw: float, heading: float) -> None:
    assert heading_deg(Pose(0, 0, 0, yaw_rad=math.radians(yaw))) == pytest.approx(heading)


def test_every_file_says_the_same(tmp_path: Path) -> None:
    names = save_plan(PATH, tmp_path, DATUM, speed_mps=0.7)
    assert {p.name for p in tmp_path.iterdir()} == set(names)
    assert set(names) == {"path.csv", "path.geojson", "path.mcap", "path.plan", "path.yaml"}
    rows = list(csv.DictReader((tmp_path / "path.csv").read_text().splitlines()))
    geo = json.loads((tmp_path / "path.geojson").read_text())
    line = geo["features"][0]["geometry"]
    assert line["type"] == "LineString" and len(line["coordinates"]) == 2
    plan = json.loads((tmp_path / "path.plan").read_text())
    PLAN.validate(plan)
    speed, *items = plan["mission"]["items"]
    assert (speed["command"], speed["params"][:2]) == (178, [1, 0.7])  # of the ground
    assert [item["doJumpId"] for item in (speed, *items)] == [1, 2, 3]
    assert {item["command"] for item in items} == {16}
    assert plan["mission"]["plannedHomePosition"] == [41.5, -71.3, 2.0]
    for row, place, item in zip(rows, line["coordinates"], items, strict=True):
        latitude, longitude = float(row["latitude_deg"]), float(row["longitude_deg"])
        assert place[:2] == [pytest.approx(longitude), pytest.approx(latitude)]
        assert item["params"][3] == pytest.approx(float(row["heading_deg"]))
        assert item["params"][4:6] == [pytest.approx(latitude), pytest.approx(longitude)]
        # QGroundControl counts height from home
        assert item["params"][6] == item["Altitude"] == pytest.approx(place[2] - 2.0)
    with AnyReader([tmp_path / "path.mcap"]) as reader:
        ((connection, _, raw),) = list(reader.messages())
        message: Any = reader.deserialize(raw, connection.msgtype)
    spoken = json.loads((tmp_path / "path.yaml").read_text())
    assert connection.msgtype == "nav_msgs/msg/Path"
    for pose, told in zip(message.poses, spoken["poses"], strict=True):
        assert pose.pose.position.x == told["pose"]["position"]["x"]
        assert pose.pose.orientation.z == told["pose"]["orientation"]["z"]
    assert message.poses[1].pose.orientation.z == pytest.approx(math.sqrt(0.5))


SCHEMA = json.loads((Path(__file__).parent / "qgroundcontrol_plan.schema.json").read_text())
PLAN = jsonschema.Draft202012Validator(SCHEMA)
METRES, DEPTHS = st.floats(-5000.0, 5000.0), st.floats(-300.0, 0.0)


@given(
    places=st.lists(st.tuples(METRES, METRES, DEPTHS, st.floats(-7.0, 7.0)), min_size=1),
    datum=st.tuples(st.floats(-85.0, 85.0), st.floats(-180.0, 180.0), st.floats(-100.0, 4000.0)),
    speed_mps=st.floats(0.01, 10.0),
)
def test_any_plan_is_one_by_qgroundcontrols_format(
    places: list[tuple[float, float, float, float]],
    datum: tuple[float, float, float],
    speed_mps: float,
) -> None:
    path = ScanPath(tuple(Pose(x, y, z, yaw_rad=yaw) for x, y, z, yaw in places))
    told = json.loads(json.dumps(qgroundcontrol(path, Datum(*datum), speed_mps), allow_nan=False))
    PLAN.validate(told)
    numbers = [item["doJumpId"] for item in told["mission"]["items"]]
    assert numbers == list(range(1, len(places) + 2))


SPOILT: dict[str, Callable[[Any], Any]] = {
    "no items": lambda plan: plan["mission"]["items"].clear(),
    "no home": lambda plan: plan["mission"].pop("plannedHomePosition"),
    "home without a height": lambda plan: plan["mission"]["plannedHomePosition"].pop(),
    "of version 1": lambda plan: plan["mission"].update(version=1),
    "not a plan": lambda plan: plan.update(fileType="Mission"),
    "six parameters": lambda plan: plan["mission"]["items"][1]["params"].pop(),
    "longitude first": lambda plan: plan["mission"]["items"][1]["params"].__setitem__(4, -171.3),
    "altitude without its mode": lambda plan: plan["mission"]["items"][1].pop("AltitudeMode"),
    "a word misspelt": lambda plan: plan["mission"]["items"][1].update(autocontinue=True),
}


@pytest.mark.parametrize("how", SPOILT)
def test_the_format_refuses_what_is_no_plan(how: str) -> None:
    plan = json.loads(json.dumps(qgroundcontrol(PATH, DATUM, 0.5)))
    assert PLAN.is_valid(plan)
    spoilt = copy.deepcopy(plan)
    SPOILT[how](spoilt)
    assert not PLAN.is_valid(spoilt)


def test_without_a_datum_nothing_geodetic_is_made_up(tmp_path: Path) -> None:
    assert save_plan(PATH, tmp_path, None) == ["path.csv", "path.mcap", "path.yaml"]
    assert "latitude" not in (tmp_path / "path.csv").read_text()


@pytest.mark.parametrize("numbers", [(91.0, 0.0), (0.0, 181.0), (math.nan, 0.0)])
def test_a_datum_lies_on_the_earth(numbers: tuple[float, float]) -> None:
    with pytest.raises(GeometryError, match="datum"):
        Datum(*numbers)
