"""What is in a recording, as data."""

from __future__ import annotations

import math
from typing import Any

from insonify.io.recordings.poses import path_length_m
from insonify.io.recordings.recording import Recording
from insonify.types import FanGeometry, Ping, Pose


def summarise(recording: Recording) -> tuple[dict[str, Any], Ping | None]:
    """Everything `info` prints, JSON-ready, and the middle ping; reads the recording once."""
    poses: list[Pose] = []
    middle: Ping | None = None
    geometries: dict[FanGeometry, int] = {}
    first_s = last_s = 0.0
    count, brightest, total = 0, 0.0, 0.0
    for number, recorded in enumerate(recording):
        ping = recorded.ping
        geometries[ping.geometry] = geometries.get(ping.geometry, 0) + 1
        if middle is None or number == recording.count // 2:
            middle = ping
        first_s, last_s = (ping.time_s if number == 0 else first_s), ping.time_s
        if recorded.pose is not None:
            poses.append(recorded.pose)
        count += 1
        brightest = max(brightest, float(ping.image.max()))
        total += float(ping.image.mean())
    summary: dict[str, Any] = {
        "file": str(recording.path),
        "format": recording.format,
        "pings": count,
        "clock": recording.timed,
        "first_s": first_s if recording.timed else None,
        "duration_s": round(last_s - first_s, 6) if recording.timed else None,
        "fans": [{"pings": n, **describe_fan(fan)} for fan, n in geometries.items()],
        "pixel_max": round(brightest, 4),
        "pixel_mean": round(total / count, 4) if count else None,
        "poses": len(poses),
        "path_m": round(path_length_m(poses), 3) if poses else None,
        "says": recording.facts,
    }
    return summary, middle


def describe_fan(fan: FanGeometry) -> dict[str, Any]:
    """A fan geometry with units that people read."""
    half = math.degrees(fan.azimuth_fov_rad) / 2
    mount = fan.mount
    return {
        "beams": fan.beams,
        "bins": fan.bins,
        "range_min_m": round(fan.range_min_m, 6),
        "range_max_m": round(fan.range_max_m, 6),
        "bin_m": round(fan.bin_m, 9),
        "azimuth_deg": round(2 * half, 4),
        "bearings_deg": [round(-half, 4), round(half, 4)],
        "elevation_deg": round(math.degrees(fan.elevation_fov_rad), 4),
        "mount_m": [round(c, 4) for c in mount.position_m],
        "mount_rpy_deg": [
            round(math.degrees(angle), 4)
            for angle in (mount.roll_rad, mount.pitch_rad, mount.yaw_rad)
        ],
    }
