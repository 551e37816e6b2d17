"""A ROS bag as a recording: its pings, and the poses of the vehicle at their times."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from insonify.errors import RecordingError, reason
from insonify.frames import pose_from_transform
from insonify.io.recordings.beams import PixelError, unit_pixels
from insonify.io.recordings.poses import PoseTrack, is_pose
from insonify.io.recordings.recording import Reading, Recording, RecordingWarning
from insonify.io.recordings.ros.bags import DAMAGE, Bag, BagMessage
from insonify.io.recordings.ros.frame_tree import FrameTree, pose_row, stamp_ns
from insonify.io.recordings.ros.messages import geometry_from_state
from insonify.io.recordings.ros.pings import PingDecoder, sonar_shape
from insonify.types import Float64, Ping, Pose, PosedPing

_STATE = "insonify_msgs/msg/PingState"
_TF = "tfmessage"
"""In lower case; ROS 1 had two spellings."""
_POSES = ("Odometry", "PoseWithCovarianceStamped", "PoseStamped")
"""Kinds of messages that tell where the vehicle is, the first found is used."""


@dataclass(slots=True, eq=False)
class _Index:
    """All of a bag but its pictures.

    Attributes:
        counts: Messages of each topic and its type.
        sonars: Topics of pings and what they are.
        tracks: Rows of time and pose of each topic of poses, and the frame that is posed.
        states: PingStates by stamp.
        tree: TF.
        frames: The frame of each topic of pings.
        undecoded: How many messages could not be decoded.
        no_poses: How many messages of a topic of poses hold none.
    """

    counts: dict[tuple[str, str], int] = field(default_factory=dict)
    sonars: dict[str, str] = field(default_factory=dict)
    tracks: dict[str, list[list[float]]] = field(default_factory=dict)
    posed: dict[str, str] = field(default_factory=dict)
    states: dict[int, Any] = field(default_factory=dict)
    tree: FrameTree = field(default_factory=FrameTree)
    frames: dict[str, str] = field(default_factory=dict)
    undecoded: int = 0
    no_poses: dict[str, int] = field(default_factory=dict)


def read_bag(bag: Bag, reading: Reading) -> Recording:
    """Open a bag as a recording.

    Raises:
        RecordingError: There are no pings in it that can be read, or not on the topic asked for.
    """
    index = _index(bag, reading.max_gap_s)
    if bag.cut and index.sonars:
        warnings.warn(
            f"{bag.path}: damaged or cut off ({bag.cut}); what lies before is read",
            RecordingWarning,
            stacklevel=2,
        )
    topic = _sonar_topic(bag, index, reading)
    poses = _poses(bag, index, topic, reading)
    count = sum(n for (name, _), n in index.counts.items() if name == topic)
    decoder = PingDecoder(index.sonars[topic], poses.mount, reading.device, reading.full_scale)

    def read() -> Iterator[PosedPing]:
        broken, why = 0, ""
        for message in bag.read({topic}):
            try:
                yield _recorded(message, decoder, index, poses, reading)
            except PixelError:
                raise  # it is the user's to say what they mean
            except DAMAGE as err:
                broken, why = broken + 1, reason(err)
        if broken:
            warnings.warn(
                f"{bag.path}: {broken} messages of {topic} are no pings and left out ({why})",
                RecordingWarning,
                stacklevel=2,
            )

    facts = {
        "topics": {f"{name} ({kind})": n for (name, kind), n in sorted(index.counts.items())},
        "sonar_topic": topic,
        "sonar_frame": index.frames.get(topic, ""),
        "mount": poses.mount_source,
        "poses": poses.source,
        "elevation_assumed": _assumes(bag, topic, decoder),
    }
    if poses.track is not None:
        facts["max_gap_s"] = poses.track.max_gap_s
    return Recording(bag.path, bag.format, count, True, facts, read)


def _assumes(bag: Bag, topic: str, decoder: PingDecoder) -> bool:
    """Whether the height of the beams is a guess, found out from the first ping."""
    for message in bag.read({topic}):
        try:
            decoder.ping(message.decode(), 0.0)
        except DAMAGE:
            continue
        return decoder.elevation_assumed
    return False


@dataclass(frozen=True, slots=True, eq=False)
class _Poses:
    """Where the vehicle was: a track of it, or TF; or as PingState tells it."""

    source: str
    mount: Float64 | None
    mount_source: str
    track: PoseTrack | None = None
    frame: str = ""
    exact: bool = False


def _recorded(
    message: BagMessage, decoder: PingDecoder, index: _Index, poses: _Poses, reading: Reading
) -> PosedPing:
    decoded = message.decode()
    time_ns = stamp_ns(decoded.header) or message.time_ns
    time_s = time_ns * 1e-9
    state = index.states.get(time_ns) if poses.exact else None
    if state is not None:
        geometry = geometry_from_state(state)
        pixels = decoder.pixels(decoded)
        if pixels.shape != (geometry.bins, geometry.beams):
            raise ValueError(f"a state of {geometry.bins} x {geometry.beams} pixels is not its own")
        image = unit_pixels(pixels, reading.full_scale)
        pose, truth = (Pose(*map(float, six)) for six in (state.pose, state.truth))
        return PosedPing(Ping(image, geometry, time_s), pose, truth)
    ping = decoder.ping(decoded, time_s)
    at_s = time_s + reading.clock_offset_s
    if poses.track is not None:
        return PosedPing(ping, poses.track.at(at_s))
    if poses.frame:
        transform = index.tree.in_root(poses.frame, at_s)
        return PosedPing(ping, None if transform is None else pose_from_transform(transform))
    return PosedPing(ping)


def _index(bag: Bag, max_gap_s: float | None) -> _Index:
    index = _Index(tree=FrameTree(max_gap_s))
    plain: set[str] = set()
    for message in bag.read(None):
        key = (message.topic, message.kind)
        index.counts[key] = index.counts.get(key, 0) + 1
        if message.topic in plain or message.topic in index.sonars:
            continue
        name = message.kind.rsplit("/", 1)[-1]
        try:
            if name.lower() == _TF:
                index.tree.add(message.decode(), "static" in message.topic)
            elif name in _POSES:
                _note_pose(index, message, message.decode())
            elif message.kind == _STATE:
                state = message.decode()
                index.states[stamp_ns(state.header)] = state
            else:
                decoded = message.decode()
                shape = sonar_shape(message.kind, set(getattr(decoded, "__slots__", ()))
                                    or set(vars(decoded)))  # fmt: skip
                if shape is None:
                    plain.add(message.topic)
                else:
                    index.sonars[message.topic] = shape
                    index.frames[message.topic] = str(decoded.header.frame_id)
        except DAMAGE:
            index.undecoded += 1
    return index


def _note_pose(index: _Index, message: BagMessage, decoded: Any) -> None:
    pose = decoded.pose
    while hasattr(pose, "pose"):
        pose = pose.pose
    time_s = (stamp_ns(decoded.header) or message.time_ns) * 1e-9
    row = [float(number) for number in (time_s, *pose_row(pose))]
    if not is_pose(row):
        index.no_poses[message.topic] = index.no_poses.get(message.topic, 0) + 1
        return
    index.tracks.setdefault(message.topic, []).append(row)
    index.posed[message.topic] = str(getattr(decoded, "child_frame_id", ""))


def _sonar_topic(bag: Bag, index: _Index, reading: Reading) -> str:
    wanted = reading.sonar_topic
    if wanted is not None and wanted in index.sonars:
        return wanted
    if wanted is None and len(index.sonars) == 1:
        return next(iter(index.sonars))
    if wanted is None and index.sonars:
        named = ", ".join(sorted(index.sonars))
        raise RecordingError(f"{bag.path}: more than one sonar; say which (--sonar-topic): {named}")
    if bag.cut and not index.sonars:
        raise RecordingError(f"{bag.path}: damaged or cut off before its first ping ({bag.cut})")
    topics = ", ".join(f"{name} ({kind})" for name, kind in sorted(index.counts)) or "none"
    what = "no pings" if wanted is None else f"no pings on {wanted}"
    raise RecordingError(
        f"{bag.path}: {what} (ProjectedSonarImage, OculusPing or SonarEcho); its topics: {topics}"
    )


def _poses(bag: Bag, index: _Index, sonar: str, reading: Reading) -> _Poses:
    frame = index.frames.get(sonar, "")
    if reading.pose_topic is None and reading.clock_offset_s == 0.0 and index.states:
        source = f"{len(index.states)} states of pings, unrounded"
        return _Poses(source, None, "states of pings", exact=True)
    topic = _pose_topic(bag, index, reading)
    if topic is not None:
        rows = np.array(index.tracks[topic])
        try:
            track = PoseTrack(rows[np.argsort(rows[:, 0], kind="stable")], reading.max_gap_s)
        except ValueError as err:
            raise RecordingError(f"{bag.path}: {topic}: {err}") from err
        if topic in index.no_poses:
            warnings.warn(
                f"{bag.path}: {index.no_poses[topic]} messages of {topic} hold no pose (a number "
                "is not finite, or a quaternion has no length) and are left out",
                RecordingWarning,
                stacklevel=3,
            )
        base = index.posed[topic] or "base_link"
        mount = index.tree.in_frame(frame, base) if frame else None
        return _Poses(f"{len(track)} on {topic}", mount, _mount_source(mount, reading), track)
    if index.tree.moves and frame:
        body, mount = index.tree.fixed_above(frame)
        return _Poses(f"TF of {body}", mount, "TF", frame=body)
    return _Poses("none", None, _mount_source(None, reading))


def _mount_source(mount: Float64 | None, reading: Reading) -> str:
    if mount is not None:
        return "TF"
    return "--sonar" if reading.device is not None else "none: taken as the vehicle's own frame"


def _pose_topic(bag: Bag, index: _Index, reading: Reading) -> str | None:
    wanted = reading.pose_topic
    if wanted is not None:
        if wanted not in index.tracks:
            known = ", ".join(sorted(index.tracks)) or "none"
            raise RecordingError(f"{bag.path}: no poses on {wanted}; topics of poses: {known}")
        return wanted
    kinds = {name: kind.rsplit("/", 1)[-1] for name, kind in index.counts}
    ranked = sorted(
        index.tracks, key=lambda name: ("truth" in name, _POSES.index(kinds[name]), name)
    )
    return ranked[0] if ranked else None
