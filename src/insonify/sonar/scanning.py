"""Sonars that build their image from many pings: scanning heads and side-scan.

Each ping has its own time and its own pose, so an image of a moving vehicle is distorted
(Cerqueira et al. 2017, section 4.1, second MSIS experiment) until it is de-skewed.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np

from insonify.frames import transform_from_pose
from insonify.sonar.devices import Kind, SonarDevice
from insonify.types import Array, FanGeometry, Float32, Float64, Ping, Pose, PosedPing

_PARTS_ACROSS, _PARTS_ALONG = 8, 2
"""A cell is de-skewed as so many points."""


def head_angles(device: SonarDevice) -> Float64:
    """The head's angles in a sweep, (steps,), from the sector's port end to its starboard end."""
    steps = max(1, math.floor(device.sector_deg / device.step_deg + 1e-9))
    ahead = (steps - 1) / 2 - np.arange(steps)
    return np.asarray(np.radians(ahead * device.step_deg))


def head_at(device: SonarDevice, number: int) -> float:
    """Where the head of a device looks at its ping of a number; one that is fixed, ahead."""
    if device.kind is not Kind.SCANNING:
        return 0.0
    angles = head_angles(device)
    turn, step = divmod(number, len(angles))
    backwards = device.back_and_forth and turn % 2 == 1
    return float(angles[-1 - step] if backwards else angles[step])


def sweep(
    device: SonarDevice,
    pose_at: Callable[[float], Pose],
    *,
    start_s: float = 0.0,
    number: int = 0,
    sound_speed_mps: float = 1500.0,
) -> list[tuple[Pose, float, float]]:
    """One turn of a scanning head: for each ping the pose, the head's angle in rad and the time.

    Args:
        device: The sonar.
        pose_at: Where the vehicle is at a time.
        start_s: When the turn begins.
        number: Of the turn; a head that goes back and forth sweeps odd ones from starboard.
        sound_speed_mps: Sets the time from ping to ping.
    """
    steps = len(head_angles(device))
    interval_s = device.interval_s(sound_speed_mps)
    times_s = [start_s + step * interval_s for step in range(steps)]
    return [
        (pose_at(time_s), head_at(device, number * steps + step), time_s)
        for step, time_s in enumerate(times_s)
    ]


def polar_image(turn: Sequence[PosedPing], device: SonarDevice) -> Ping:
    """The pings of a turn side by side, from port to starboard, as if the vehicle had rested.

    The image is that of a fan as wide as the turn, with a beam a step.
    """
    order = np.argsort([-one.ping.head_rad for one in turn], kind="stable")
    image = np.concatenate([turn[k].ping.image for k in order], axis=1)
    return Ping(image, _fan(turn, device), turn[0].ping.time_s)


def deskewed_image(turn: Sequence[PosedPing], device: SonarDevice, reference: Pose) -> Ping:
    """The same with each ping where it was taken, seen from a reference pose.

    Echoes are taken to lie in the plane in which the head turns; what leaves that plane is put
    down on it.  Each cell is the mean of all that fell into it, 0 where nothing did.
    """
    fan = _fan(turn, device)
    plane_from_world = np.linalg.inv(
        transform_from_pose(reference) @ transform_from_pose(fan.mount)
    )
    width_rad = max(math.radians(device.azimuth_fov_deg), math.radians(device.step_deg))
    across = (np.arange(_PARTS_ACROSS) + 0.5) / _PARTS_ACROSS - 0.5
    along = (np.arange(_PARTS_ALONG) + 0.5) / _PARTS_ALONG - 0.5
    range_m = (fan.bin_ranges_m[:, None] + along * fan.bin_m).reshape(-1)
    total, count = np.zeros(fan.bins * fan.beams), np.zeros(fan.bins * fan.beams)
    for one in turn:
        assert one.pose is not None
        angle = one.ping.head_rad + across * width_rad
        ray = np.stack([np.cos(angle), np.sin(angle), 0 * angle, 0 * angle])
        plane_from_sonar = (
            plane_from_world @ transform_from_pose(one.pose) @ transform_from_pose(fan.mount)
        )
        points = (plane_from_sonar @ ray)[:2, None, :] * range_m[:, None]
        points += plane_from_sonar[:2, 3, None, None]
        bins = np.floor((np.hypot(*points) - fan.range_min_m) / fan.bin_m).astype(np.int64)
        azimuth = np.arctan2(points[1], points[0])
        beams = np.floor((fan.azimuth_fov_rad / 2 - azimuth) / fan.beam_rad).astype(np.int64)
        inside = (bins >= 0) & (bins < fan.bins) & (beams >= 0) & (beams < fan.beams)
        cell = (bins * fan.beams + beams)[inside]
        values = np.repeat(one.ping.image[:, 0], _PARTS_ALONG)[:, None]
        values = np.broadcast_to(values, inside.shape)[inside]
        total += np.bincount(cell, values, minlength=len(total))
        count += np.bincount(cell, minlength=len(count))
    image: Float32 = (total / np.maximum(count, 1.0)).astype(np.float32)
    return Ping(image.reshape(fan.bins, fan.beams), fan, turn[0].ping.time_s)


def _fan(turn: Sequence[PosedPing], device: SonarDevice) -> FanGeometry:
    """The fan that a whole turn amounts to."""
    return dataclasses.replace(
        device.geometry,
        azimuth_fov_rad=math.radians(device.step_deg) * len(turn),
        beams=len(turn),
    )


SIDES_RAD = (math.pi / 2, -math.pi / 2)
"""Port and starboard head of a side-scan."""


def sidescan_line(port: Array, starboard: Array) -> Array:
    """One line of a side-scan image, (2 x bins,), of the (bins, 1) of its two pings.

    Port from far to near, then starboard.
    """
    line: Array = np.concatenate([port[::-1, 0], starboard[:, 0]])
    return line


def waterfall(lines: Sequence[Array]) -> Array:
    """The lines of a side-scan image, (lines, 2 x bins), port on the left, the first line below."""
    return np.stack(lines[::-1])


def soundings(posed: PosedPing, threshold: float) -> Float64:
    """What a profiling sonar measures: the point of the strongest echo of each beam, world frame.

    Args:
        posed: Its image and the vehicle's pose.
        threshold: Beams in which nothing is stronger give no sounding.

    Returns:
        (N, 3) metres, N at most the number of beams.
    """
    ping, geometry = posed.ping, posed.ping.geometry
    assert posed.pose is not None
    strongest = ping.image.argmax(axis=0)
    heard = ping.image.max(axis=0) > threshold
    azimuth = geometry.beam_azimuths_rad[heard]
    range_m = geometry.bin_ranges_m[strongest[heard]]
    local = np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=1) * range_m[:, None]
    world_from_beam = transform_from_pose(posed.pose) @ transform_from_pose(geometry.mount)
    points: Float64 = local @ world_from_beam[:3, :3].T + world_from_beam[:3, 3]
    return points
