"""The mission protocol, against an autopilot of pymavlink's own in a thread."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest

from insonify.errors import UploadError
from insonify.io.datum import Datum
from insonify.io.mavlink import upload_mission
from insonify.io.plans import qgroundcontrol
from insonify.types import Pose, ScanPath

mavutil = pytest.importorskip("pymavlink.mavutil")

PATH = ScanPath((Pose(0.0, 0.0, -15.0), Pose(10.0, 20.0, -15.0, yaw_rad=0.3)))
PLAN = qgroundcontrol(PATH, Datum(41.5, -71.3, 2.0), 0.7)


@dataclass
class Autopilot:
    """Sends heartbeats, asks for a mission's items, and answers as it is told to."""

    port: int
    answer: int = 0
    whole: bool = True
    deaf_to: int = 0
    items: list[Any] = field(default_factory=list)
    over: threading.Event = field(default_factory=threading.Event)

    def run(self) -> None:
        link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{self.port}", source_system=7)

        def ask(number: int) -> None:
            send = (
                link.mav.mission_request_int_send if self.whole else link.mav.mission_request_send
            )
            send(255, 0, number)

        beaten_s = 0.0
        count = 0
        while not self.over.is_set():
            if time.monotonic() - beaten_s > 0.1:
                link.mav.heartbeat_send(12, 3, 0, 0, 4)  # a submarine by ArduPilot
                beaten_s = time.monotonic()
            message = link.recv_match(blocking=True, timeout=0.02)
            kind = "" if message is None else message.get_type()
            if kind == "MISSION_COUNT" and self.deaf_to > 0:
                self.deaf_to -= 1
            elif kind == "MISSION_COUNT":
                count = message.count
                ask(0)
            elif kind in ("MISSION_ITEM_INT", "MISSION_ITEM") and message.seq == len(self.items):
                self.items.append(message)
                if len(self.items) < count:
                    ask(len(self.items))
                else:
                    link.mav.mission_ack_send(255, 0, self.answer)
        link.close()


@pytest.fixture
def autopilot() -> Iterator[Autopilot]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        made = Autopilot(free.getsockname()[1])
    thread = threading.Thread(target=made.run)
    thread.start()
    yield made
    made.over.set()
    thread.join()


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
