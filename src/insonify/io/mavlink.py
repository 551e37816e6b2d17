"""A scan path to an autopilot that speaks MAVLink, by its mission protocol.

https://mavlink.io/en/services/mission.html: the number of items is told, the autopilot asks for
each, and says at the end whether it takes them.
"""

from __future__ import annotations

import time
from typing import Any

from insonify.errors import UploadError, reason
from insonify.extras import optional

_TYPES = ["MISSION_REQUEST_INT", "MISSION_REQUEST", "MISSION_ACK"]
_PATIENCE_S = 10.0
"""For the autopilot's heartbeat, and between two of its answers."""
_AGAIN_S = 1.5
"""Then the number of items is told once more: a datagram may be lost."""
_GLOBAL_RELATIVE_INT = 6
"""MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, in which degrees go as whole numbers of 1e-7."""
_HOME = 0
"""ArduPilot takes a mission's first item for home."""


def upload_mission(plan: dict[str, Any], address: str, patience_s: float = _PATIENCE_S) -> str:
    """Give an autopilot a mission in the place of the one it has; it does not start it.

    Args:
        plan: QGroundControl's, of `insonify.io.plans`.
        address: As pymavlink takes it: ``udp:HOST:PORT`` to listen at, ``udpout:HOST:PORT``,
            ``tcp:HOST:PORT``, or a serial port.
        patience_s: How long an answer is waited for.

    Returns:
        Who took it.

    Raises:
        MissingExtraError: pymavlink is not installed.
        UploadError: Nobody answers there, or it does not take the mission.
    """
    mavutil = optional("pymavlink.mavutil", "mavlink", "sending a plan by MAVLink")
    try:
        link = mavutil.mavlink_connection(address, source_system=255)
    except (OSError, ValueError, IndexError) as err:
        raise UploadError(
            f"{address}: there is no such MAVLink link ({reason(err)}); give one as "
            "udp:127.0.0.1:14550"
        ) from err
    try:
        if link.wait_heartbeat(timeout=patience_s) is None or not link.target_system:
            raise UploadError(
                f"{address}: no autopilot was heard for {patience_s:g} s; check the address, and "
                "that it sends there"
            )
        _exchange(link, _items(plan), address, patience_s)
        return f"system {link.target_system}"
    finally:
        link.close()


def _exchange(link: Any, items: list[dict[str, Any]], address: str, patience_s: float) -> None:
    """Answer what is asked until the autopilot has said what it makes of it."""
    system, component = link.target_system, link.target_component
    link.mav.mission_count_send(system, component, len(items))
    heard_s = told_s = time.monotonic()
    asked = False
    while True:
        message = link.recv_match(type=_TYPES, blocking=True, timeout=0.2)
        now_s = time.monotonic()
        if message is None:
            if now_s - heard_s > patience_s:
                raise UploadError(
                    f"{address}: the autopilot has not answered for {patience_s:g} s; it may have "
                    "a part of the plan, so look before it flies"
                )
            if not asked and now_s - told_s > _AGAIN_S:
                link.mav.mission_count_send(system, component, len(items))
                told_s = now_s
            continue
        heard_s = now_s
        if message.get_type() == "MISSION_ACK":
            if message.type == 0:  # MAV_MISSION_ACCEPTED
                return
            raise UploadError(
                f"{address}: the autopilot does not take the plan (MAV_MISSION_RESULT "
                f"{message.type}); see its own messages"
            )
        asked = True
        if message.seq < len(items):
            whole = message.get_type() == "MISSION_REQUEST_INT"
            _send(link, message.seq, items[message.seq], whole=whole)


def _items(plan: dict[str, Any]) -> list[dict[str, Any]]:
    """What is sent: home, then the plan's items."""
    mission = plan["mission"]
    latitude, longitude, height = mission["plannedHomePosition"]
    home = {"command": 16, "frame": _HOME, "params": [0, 0, 0, 0, latitude, longitude, height]}
    return [home, *mission["items"]]


def _send(link: Any, number: int, item: dict[str, Any], *, whole: bool) -> None:
    """Send an item, places as whole numbers if they were asked for so."""
    first, second, third, fourth, x, y, z = item["params"]
    frame = item["frame"]
    send = link.mav.mission_item_send
    if whole:
        send = link.mav.mission_item_int_send
        x, y = round(x * 1e7), round(y * 1e7)
        frame = {0: 5, 3: _GLOBAL_RELATIVE_INT}.get(frame, frame)
    send(
        link.target_system, link.target_component, number, frame, item["command"], 0, 1,
        first, second, third, fourth, x, y, z,
    )  # fmt: skip
