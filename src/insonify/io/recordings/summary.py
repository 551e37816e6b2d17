"""What is in a recording, as data."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from insonify.io.recordings.poses import PoseTrack, path_length_m
from insonify.io.recordings.recording import Recording
from insonify.types import FanGeometry, Ping, Pose

_NOWHERE = Pose(0.0, 0.0, 0.0)
_TURN_PINGS, _MOST_BEAMS = 400, 3600


def summarise(recording: Recording) -> tuple[dict[str, Any], Ping | None]:
    """Everything `info` prints, JSON-ready, and the middle ping; reads the recording once.

    Of a scanning sonar that is a turn around its middle, as one image.
    """
    poses: list[Pose] = []
    middle: Ping | None = None
    turn: list[Ping] = []
    geometries: dict[FanGeometry, list[Pose]] = {}
    first_s = last_s = 0.0
    count, brightest, total = 0, 0.0, 0.0
    for number, recorded in enumerate(recording):
        ping = recorded.ping
        mounts = geometries.setdefault(replace(ping.geometry, mount=_NOWHERE), [])
        mounts.append(ping.geometry.mount)
        if ping.geometry.beams == 1 and abs(number - recording.count // 2) <= _TURN_PINGS:
            turn.append(ping)
        if middle is None or number == recording.count // 2:
            middle = ping
        first_s, last_s = (ping.time_s if number == 0 else first_s), ping.time_s
        if recorded.pose is not None:
            poses.append(recorded.pose)
        count += 1
        known = np.nan_to_num(ping.image)
        brightest = max(brightest, float(known.max()))
        total += float(known.mean())
    summary: dict[str, Any] = {
        "file": str(recording.path),
        "format": recording.format,
        "pings": count,
        "clock": recording.timed,
        "first_s": first_s if recording.timed else None,
        "duration_s": round(last_s - first_s, 6) if recording.timed else None,
        "fans": [_fan_of(fan, mounts) for fan, mounts in geometries.items()],
        "pixel_max": round(brightest, 4),
        "pixel_mean": round(total / count, 4) if count else None,
        "poses": len(poses),
        "path_m": round(path_length_m(poses), 3) if poses else None,
        "says": recording.facts,
    }
    return summary, swept(turn) if turn else middle


def summarise_poses(path: Path, track: PoseTrack) -> dict[str, Any]:
    """What `info` prints of poses alone, JSON-ready."""
    poses = [track.sample(number) for number in range(len(track))]
    first_s, last_s = track.span_s
    places = np.array([pose.position_m for pose in poses])
    return {
        "file": str(path),
        "format": "telemetry: poses and no pings, for --poses",
        "poses": len(poses),
        "first_s": first_s,
        "duration_s": round(last_s - first_s, 6),
        "path_m": round(path_length_m(poses), 3),
        "low_m": [round(float(c), 3) for c in places.min(axis=0)],
        "high_m": [round(float(c), 3) for c in places.max(axis=0)],
    }


def swept(pings: Sequence[Ping]) -> Ping:
    """Pings of one beam side by side by where they looked, from port to starboard.

    Of pings at one bearing the last is shown; those that differ from the first in ranges are not.
    """
    first = pings[0].geometry
    alike = [one for one in pings if one.image.shape == pings[0].image.shape]
    turns = any(one.head_rad for one in alike)
    bearings = np.array([one.head_rad if turns else one.geometry.mount.yaw_rad for one in alike])
    apart = np.diff(np.unique(np.round(bearings, 6)))
    step = float(np.median(apart)) if len(apart) else first.azimuth_fov_rad
    left = float(bearings.max()) + step / 2
    beams = min(_MOST_BEAMS, round((left - float(bearings.min())) / step + 0.5))
    image = np.zeros((first.bins, beams), np.float32)
    places = np.clip(((left - bearings) / step).astype(int), 0, beams - 1)
    for place, one in zip(places, alike, strict=True):
        image[:, place] = one.image[:, 0]
    middle = left - beams * step / 2
    fan = replace(
        first,
        azimuth_fov_rad=min(beams * step, math.tau),
        beams=beams,
        mount=Pose(*first.mount.position_m, yaw_rad=middle),
    )
    return Ping(image, fan, alike[0].time_s)


def _fan_of(fan: FanGeometry, mounts: Sequence[Pose]) -> dict[str, Any]:
    """A fan, how many pings have it, and how its mount turns, if it does."""
    told: dict[str, Any] = {"pings": len(mounts), **describe_fan(replace(fan, mount=mounts[0]))}
    if len(set(mounts)) > 1:
        turns = np.degrees([[one.roll_rad, one.pitch_rad, one.yaw_rad] for one in mounts])
        told["mount_turns_deg"] = [
            [round(float(low), 3), round(float(high), 3)]
            for low, high in zip(turns.min(axis=0), turns.max(axis=0), strict=True)
        ]
    return told


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
