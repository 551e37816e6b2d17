"""A scan path for real vehicles: CSV, GeoJSON, ROS nav_msgs/Path, QGroundControl.

The map's frame is ENU.  A datum, the latitude, longitude and height of its origin on WGS 84, turns
its coordinates into geodetic ones.  Local ones are told in the world, the map's origin added.
"""

from __future__ import annotations

import csv
import io
import json
import math
from pathlib import Path
from typing import Any

from insonify.io.datum import Datum
from insonify.types import Pose, ScanPath

_WAYPOINT, _CHANGE_SPEED, _GROUND_SPEED = 16, 178, 1
_MISSION, _RELATIVE_ALTITUDE, _ARDUPILOT, _SUBMARINE = 2, 3, 3, 12
"""MAVLink's numbers: MAV_CMD_NAV_WAYPOINT, MAV_CMD_DO_CHANGE_SPEED, SPEED_TYPE_GROUNDSPEED,
MAV_FRAME_MISSION, MAV_FRAME_GLOBAL_RELATIVE_ALT, MAV_AUTOPILOT_ARDUPILOTMEGA,
MAV_TYPE_SUBMARINE."""


def heading_deg(pose: Pose) -> float:
    """Compass heading, clockwise from north, of a yaw counted from east to north."""
    return (90.0 - math.degrees(pose.yaw_rad)) % 360.0


def save_plan(
    path: ScanPath,
    folder: Path,
    datum: Datum | None,
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    speed_mps: float = 0.5,
) -> list[str]:
    """Write a path in every form; GeoJSON and QGroundControl's need a datum.

    Args:
        path: In the map's own frame.
        folder: Where to.
        datum: Where the map's own frame lies on the Earth.
        origin_m: Where it lies in the world.
        speed_mps: How fast it is to be flown, which QGroundControl's plan tells.

    Returns:
        The names of the files.

    Raises:
        MissingExtraError: The packages for ROS messages are not installed.
    """
    from insonify.io.recordings.ros import messages
    from insonify.io.recordings.ros.mcap_writing import McapWriter

    world = ScanPath(tuple(pose.moved(origin_m) for pose in path.waypoints))
    texts = {"path.csv": _csv(path, world, datum), "path.yaml": _ros_yaml(world)}
    if datum is not None:
        texts["path.geojson"] = json.dumps(_geojson(path, datum), indent=2) + "\n"
        texts["path.plan"] = json.dumps(qgroundcontrol(path, datum, speed_mps), indent=2) + "\n"
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    with McapWriter(folder / "path.mcap") as writer:
        writer.write("/plan", messages.path(world.waypoints, 0, "map"), 0)
    return sorted([*texts, "path.mcap"])


def _csv(path: ScanPath, world: ScanPath, datum: Datum | None) -> str:
    names = ["number", "x_m", "y_m", "z_m", "roll_deg", "pitch_deg", "yaw_deg", "heading_deg"]
    if datum is not None:
        names += ["latitude_deg", "longitude_deg", "height_m"]
    stream = io.StringIO()
    rows = csv.writer(stream, lineterminator="\n")
    rows.writerow(names)
    for number, (local, pose) in enumerate(zip(path.waypoints, world.waypoints, strict=True), 1):
        angles = (math.degrees(a) for a in (pose.roll_rad, pose.pitch_rad, pose.yaw_rad))
        row = [f"{c:.6f}" for c in (*pose.position_m, *angles, heading_deg(pose))]
        if datum is not None:
            latitude, longitude, height = datum.geodetic(local)
            row += [f"{latitude:.9f}", f"{longitude:.9f}", f"{height:.4f}"]
        rows.writerow([number, *row])
    return stream.getvalue()


def _ros_yaml(path: ScanPath) -> str:
    """A nav_msgs/Path as YAML's JSON subset: ``ros2 topic pub --once /plan nav_msgs/msg/Path``."""
    from insonify.io.recordings.ros import messages

    return json.dumps(_plain(messages.path(path.waypoints, 0, "map")), indent=1) + "\n"


def _plain(message: Any) -> Any:
    """A message as dictionaries, lists and numbers."""
    if isinstance(message, list):
        return [_plain(item) for item in message]
    fields = getattr(message, "__dataclass_fields__", None)
    if fields is None:
        return message
    return {name: _plain(getattr(message, name)) for name in fields if name != "__msgtype__"}


def _geojson(path: ScanPath, datum: Datum) -> dict[str, Any]:
    """RFC 7946: the line, and a point for each waypoint; longitude, latitude, height."""
    places = []
    for pose in path.waypoints:
        latitude, longitude, height = datum.geodetic(pose)
        places.append([round(longitude, 9), round(latitude, 9), round(height, 4)])
    features = [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": place},
            "properties": {"number": number, "heading_deg": round(heading_deg(pose), 4)},
        }
        for number, (place, pose) in enumerate(zip(places, path.waypoints, strict=True), 1)
    ]
    if len(places) > 1:
        line = {"type": "LineString", "coordinates": places}
        named = {"name": "next scan", "length_m": round(path.length_m, 3)}
        features.insert(0, {"type": "Feature", "geometry": line, "properties": named})
    return {"type": "FeatureCollection", "features": features}


def _change_speed(speed_mps: float) -> dict[str, Any]:
    """A plan's first item."""
    return {
        "autoContinue": True,
        "command": _CHANGE_SPEED,
        "doJumpId": 1,
        "frame": _MISSION,
        "params": [_GROUND_SPEED, speed_mps, -1, 0, 0, 0, 0],
        "type": "SimpleItem",
    }


def qgroundcontrol(path: ScanPath, datum: Datum, speed_mps: float) -> dict[str, Any]:
    """A plan file for ArduSub: heights are relative to home, which is the datum, so negative.

    Args:
        path: In the map's own frame.
        datum: Where that lies on the Earth.
        speed_mps: Its first item.
    """
    items = [_change_speed(speed_mps)]
    for number, pose in enumerate(path.waypoints, 2):
        latitude, longitude, height = datum.geodetic(pose)
        altitude = round(height - datum.height_m, 4)
        heading = round(heading_deg(pose), 4)
        where = [round(latitude, 9), round(longitude, 9), altitude]
        items.append(
            {
                "AMSLAltAboveTerrain": None,
                "Altitude": altitude,
                "AltitudeMode": 1,
                "autoContinue": True,
                "command": _WAYPOINT,
                "doJumpId": number,
                "frame": _RELATIVE_ALTITUDE,
                "params": [0, 0, 0, heading, *where],
                "type": "SimpleItem",
            }
        )
    home = [datum.latitude_deg, datum.longitude_deg, datum.height_m]
    return {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "mission": {
            "version": 2,
            "firmwareType": _ARDUPILOT,
            "vehicleType": _SUBMARINE,
            "cruiseSpeed": speed_mps,
            "hoverSpeed": speed_mps,
            "globalPlanAltitudeMode": 1,
            "plannedHomePosition": home,
            "items": items,
        },
        "geoFence": {"version": 2, "circles": [], "polygons": []},
        "rallyPoints": {"version": 2, "points": []},
    }
