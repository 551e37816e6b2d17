"""What was simulated as a recording in MCAP, for the tools that users replay recordings in."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np

from insonify.frames import transform_from_pose
from insonify.io.recordings.recording import Recording
from insonify.io.recordings.ros import messages
from insonify.io.recordings.ros.mcap_writing import McapWriter
from insonify.types import Array, PosedPing

PINGS = "pings.mcap"
_STEP_NS = 100_000_000
"""From ping to ping where they have no times."""
_NO_GENERATOR = np.zeros(0, np.uint64)


def save_replay(
    recordings: Mapping[str, Recording],
    path: Path,
    frequency_hz: Mapping[str, float],
    sound_speed_mps: float,
) -> None:
    """Write what sonars heard as one MCAP file, in the order of time.

    Topics ``/NAME/image`` (ProjectedSonarImage), ``/NAME/state`` (PingState) and ``/NAME/polar`` of
    each sonar, ``/odometry``, ``/ground_truth/odometry`` and ``/tf``: map, odom, base_link, NAME.

    Args:
        recordings: By the sonars' names, which are those of their topics and frames.
        path: The file.
        frequency_hz: Of each sonar.
        sound_speed_mps: Told in each ping.
    """
    with McapWriter(path) as writer:
        last_ns = -1
        for time_ns, name, posed in heapq.merge(*map(_timed, recordings.items()), key=_when):
            now = max(time_ns, last_ns + 1)  # a state is found by its stamp
            last_ns = now
            told = posed_messages(name, posed, now, frequency_hz[name], sound_speed_mps)
            for topic, message in told.items():
                writer.write(topic, message, now)


def posed_messages(
    name: str,
    posed: PosedPing,
    now: int,
    frequency_hz: float,
    speed_mps: float,
    *,
    picture: bool = True,
) -> dict[str, object]:
    """All that a ping tells by topic: where it was, if that is known; itself; its picture."""
    ping, pose = posed.ping, posed.pose
    told: dict[str, object] = {}
    if pose is not None:
        sonar = transform_from_pose(ping.geometry.mount) @ messages.IMAGE_FROM_SONAR
        links = [
            ("map", "odom", np.eye(4)),
            ("odom", "base_link", transform_from_pose(pose)),
            ("base_link", name, sonar),
        ]
        told["/tf"] = messages.transforms(links, now)
        told["/odometry"] = messages.odometry(pose, now, "odom")
        truth = posed.true_pose or pose
        told["/ground_truth/odometry"] = messages.odometry(truth, now, "map")
    told |= ping_messages(name, posed, _NO_GENERATOR, now, frequency_hz, speed_mps)
    return told | ({f"/{name}/polar": messages.polar_picture(ping, now, name)} if picture else {})


def timed(recording: Iterable[PosedPing]) -> Iterator[tuple[int, PosedPing]]:
    """Pings with stamps that rise, ns."""
    last_ns = -_STEP_NS
    for posed in recording:
        time_ns = round(posed.ping.time_s * 1e9)
        last_ns = time_ns if time_ns > last_ns else last_ns + _STEP_NS
        yield last_ns, posed


def ping_messages(
    name: str, posed: PosedPing, words: Array, now: int, frequency_hz: float, speed_mps: float
) -> dict[str, object]:
    """A ping's own messages by topic: state and image of the sonar of a name.

    Args:
        name: Of the sonar, its topics and its frame.
        posed: The ping.
        words: Of the noise's generator, see `messages.ping_state`.
        now: Its stamp, ns.
        frequency_hz: Told in it.
        speed_mps: Of sound, told in it.
    """
    ping, pose = posed.ping, posed.pose
    truth = posed.true_pose or pose
    return {
        f"/{name}/state": messages.ping_state(ping, pose, truth, words, now, name),
        f"/{name}/image": messages.sonar_image(ping, now, name, frequency_hz, speed_mps),
    }


def _when(one: tuple[int, str, PosedPing]) -> tuple[int, str]:
    return one[0], one[1]


def _timed(named: tuple[str, Recording]) -> Iterator[tuple[int, str, PosedPing]]:
    name, recording = named
    return ((now, name, posed) for now, posed in timed(recording))
