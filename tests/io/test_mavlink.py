"""The mission protocol, against an autopilot of pymavlink's own in a thread."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
from benchmarks.autopilot import Autopilot
from benchmarks.autopilot import autopilot as flying

from insonify.errors import UploadError
from insonify.io.datum import Datum
from insonify.io.mavlink import upload_mission
from insonify.io.plans import qgroundcontrol
from insonify.types import Pose, ScanPath

pytest.importorskip("pymavlink.mavutil")

PATH = ScanPath((Pose(0.0, 0.0, -15.0), Pose(10.0, 20.0, -15.0, yaw_rad=0.3)))
PLAN = qgroundcontrol(PATH, Datum(41.5, -71.3, 2.0), 0.7)


@pytest.fixture
def autopilot() -> Iterator[Autopilot]:
    with flying() as made:
        yield made


@pytest.mark.parametrize("whole", [True, False])
def test_an_autopilot_has_the_plan_and_home_before_it(autopilot: Autopilot, whole: bool) -> None:
    autopilot.whole = whole
    assert upload_mission(PLAN, f"udp:127.0.0.1:{autopilot.port}") == "system 7"
    home, speed, *waypoints = autopilot.items
    scale = 1e7 if whole else 1.0
    assert [home.x / scale, home.y / scale, home.z] == pytest.approx([41.5, -71.3, 2.0], abs=1e-5)
    assert (speed.command, speed.param1, speed.param2) == (178, 1.0, pytest.approx(0.7))
    for item, told in zip(waypoints, PLAN["mission"]["items"][1:], strict=True):
        *_, heading, latitude, longitude, height = told["params"]
        place = [item.x / scale, item.y / scale, item.z, item.param4]
        exact = 1e-7 if whole else 1e-5
        assert place[:2] == pytest.approx([latitude, longitude], abs=exact)
        assert place[2:] == pytest.approx([height, heading], abs=1e-4)
        assert item.frame == (6 if whole else 3)


def test_a_count_that_was_lost_is_told_again(autopilot: Autopilot) -> None:
    autopilot.deaf_to = 1
    assert upload_mission(PLAN, f"udp:127.0.0.1:{autopilot.port}") == "system 7"


def test_a_plan_that_is_not_taken_is_one_sentence(autopilot: Autopilot) -> None:
    autopilot.answer = 13  # MAV_MISSION_INVALID_SEQUENCE
    with pytest.raises(UploadError, match=r"does not take the plan .* 13"):
        upload_mission(PLAN, f"udp:127.0.0.1:{autopilot.port}")


def test_nobody_there_is_one_sentence(autopilot: Autopilot) -> None:
    autopilot.over.set()
    time.sleep(0.1)
    with pytest.raises(UploadError, match=r"no autopilot was heard for 0\.3 s"):
        upload_mission(PLAN, "udp:127.0.0.1:0", patience_s=0.3)
    with pytest.raises(UploadError, match="no such MAVLink link"):
        upload_mission(PLAN, "/dev/no-such-port", patience_s=0.3)
