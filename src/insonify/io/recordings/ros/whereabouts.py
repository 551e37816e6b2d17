"""Where a bag's sonar was: which of its poses are the vehicle's, and where the sonar sits on it.

Of topics of odometry it is the one whose frame carries the sonar's; else TF, if the sonar's frame
moves in a world; else the only odometry, pose with covariance or pose.  Where several remain, the
user says which.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from insonify.errors import RecordingError
from insonify.frames import (
    ENU_FROM_NED,
    FLU_FROM_FRD,
    pose_from_transform,
    transform_from_pose,
)
from insonify.io.recordings.poses import PoseTrack
from insonify.io.recordings.recording import Reading
from insonify.io.recordings.ros.bags import Bag
from insonify.io.recordings.ros.index import KINDS, Index, namespace
from insonify.types import Float64, Pose, estimated

_WANTED = ("goal", "target", "setpoint", "desired", "reference", "cmd")
"""In topics that tell where a vehicle should be, not where it is."""
_SECOND_CHOICE = ("truth", "global_position")
"""In topics that are taken if there is no other."""
_WORLDS = ("map", "odom", "world", "earth", "utm", "ned", "enu", "origin", "global")


@dataclass(frozen=True, slots=True, eq=False)
class Whereabouts:
    """Where the vehicle was: a track of it, or TF; or as PingState tells it.

    Attributes:
        source: Which poses are taken, and why.
        mount_source: What tells where the sonar sits.
        mount: ``vehicle_from_frame`` (4, 4) of the sonar's frame, if it never changes.
        track: The vehicle's poses.
        topic: Of what topic they are.
        frame: The frame whose pose TF tells, if there is no track.
        base: The track's frame, in which the sonar's moves.
        exact: Whether PingState tells all of it.
        framed: Whether TF tells how the sonar's frame sits, even if the user overrules where.
        world: Turns the poses' world into ours (4, 4), if it is another.
        turn: Turns the posed body's axes into ours (4, 4), if they are others.
        doubts: What had to be assumed.
    """

    source: str
    mount_source: str
    mount: Float64 | None = None
    track: PoseTrack | None = None
    frame: str = ""
    base: str = ""
    exact: bool = False
    framed: bool = False
    world: Float64 | None = None
    turn: Float64 | None = None
    doubts: tuple[str, ...] = ()
    topic: str = ""

    def in_our_axes(self, transform: Float64) -> Pose:
        """A pose (4, 4) of the recording as one of the vehicle in our world."""
        if self.world is not None:
            transform = self.world @ transform
        if self.turn is not None:
            transform = transform @ self.turn
        return pose_from_transform(transform)

    def pose(self, index: Index, time_s: float) -> Pose | None:
        """Where the vehicle was at a time; None if nothing tells."""
        if self.track is None:
            transform = index.tree.in_root(self.frame, time_s) if self.frame else None
            return None if transform is None else self.in_our_axes(transform)
        pose = self.track.at(time_s)
        if pose is None or (self.world is None and self.turn is None):
            return pose
        return estimated(self.in_our_axes(transform_from_pose(pose)), pose.std)


def whereabouts(bag: Bag, index: Index, sonar: str, reading: Reading) -> Whereabouts:
    """Where the sonar of a topic was.

    Raises:
        RecordingError: Several topics could tell, or one that is asked for cannot.
    """
    frame = index.frames.get(sonar, "")
    told = reading.pose_topic or reading.convention
    if told is None and reading.clock_offset_s == 0.0 and index.states:
        source = f"{len(index.states)} states of pings, unrounded"
        return Whereabouts(source, "states of pings", exact=True)
    if reading.poses is not None:
        return _beside(bag, index, frame, reading)
    topic, why = _pose_topic(bag, index, sonar, reading)
    if topic is not None:
        return _tracked(bag, index, frame, topic, why, reading)
    if why:
        return _by_tf(index, frame, why, reading)
    return Whereabouts("none", _untold(reading))


def _beside(bag: Bag, index: Index, frame: str, reading: Reading) -> Whereabouts:
    """Poses from a file: the bag tells the mount alone, on what TF hangs the sonar from."""
    known = Whereabouts("none", "TF")
    way = index.tree.way_up(frame)
    bodies = [one for one in way if not any(word in one.lower() for word in _WORLDS)]
    base = bodies[-1] if len(bodies) > 1 else ""
    return _seated(bag, index, frame, base, None, known, reading)


def _seated(
    bag: Bag, index: Index, frame: str, base: str, turn: Float64 | None, known: Whereabouts,
    reading: Reading,
) -> Whereabouts:  # fmt: skip
    """Where the sonar sits on the vehicle's frame, if TF or the user says."""
    mount = index.tree.in_frame(frame, base) if frame and base else None
    moving = mount is None and bool(base) and index.tree.joins(frame, base)
    if reading.mount is not None and moving:
        raise RecordingError(
            f"{bag.path}: by TF the sonar turns on the vehicle, which one --mount cannot tell; "
            "leave it out"
        )
    if reading.mount is not None:
        return replace(known, mount_source="--mount", framed=mount is not None)
    if mount is not None:
        return replace(known, mount=mount if turn is None else turn @ mount, framed=True)
    if moving:
        return replace(known, mount_source="TF, moving", base=base, framed=True)
    doubts = known.doubts
    if reading.device is None:
        doubts += (_no_mount(index, frame, base or "base_link"),)
    return replace(known, mount_source=_untold(reading), doubts=doubts)


def _by_tf(index: Index, frame: str, why: str, reading: Reading) -> Whereabouts:
    """Poses of the frame that the sonar is fixed to, in TF's root."""
    body, mount = index.tree.fixed_above(frame)
    root, _ = index.tree.root_of(frame)
    world, turn = _axes(root, body, reading)
    axes = _said(world is not None, turn is not None)
    if turn is not None:
        mount = turn @ mount
    source = f"TF of {body}{why}{axes}"
    known = Whereabouts(source, "TF", mount, frame=body, world=world, turn=turn, framed=True)
    return known if reading.mount is None else replace(known, mount_source="--mount", mount=None)


def _tracked(
    bag: Bag, index: Index, frame: str, topic: str, why: str, reading: Reading
) -> Whereabouts:
    try:
        track = track_of(index, topic, reading.max_gap_s)
    except ValueError as err:
        raise RecordingError(f"{bag.path}: {topic}: {err}") from err
    base = index.posed[topic] or "base_link"
    world, turn = _axes(index.worlds[topic], base, reading)
    source = f"{len(track)} on {topic}{why}{_said(world is not None, turn is not None)}"
    doubts: tuple[str, ...] = ()
    if topic in index.no_poses:
        doubts = (
            f"{index.no_poses[topic]} messages of {topic} hold no pose (a number is not finite, "
            "or a quaternion has no length) and are left out",
        )
    known = Whereabouts(
        source, "TF", None, track, world=world, turn=turn, doubts=doubts, topic=topic
    )
    return _seated(bag, index, frame, base, turn, known, reading)


def track_of(
    index: Index, topic: str, max_gap_s: float | None, fastest_mps: float | None = None
) -> PoseTrack:
    """The poses of a topic in the order of time.

    Raises:
        ValueError: They are none.
    """
    rows, std = np.array(index.tracks[topic]), np.array(index.spreads[topic])
    order = np.argsort(rows[:, 0], kind="stable")
    return PoseTrack(rows[order], max_gap_s, std[order], fastest_mps)


def _axes(world: str, body: str, reading: Reading) -> tuple[Float64 | None, Float64 | None]:
    """What turns a pose's world and its body into ours, by their names or as the user says."""
    if reading.convention is not None:
        ned = frd = reading.convention == "ned"
    else:
        ned = world.lower() == "ned" or world.lower().endswith(("_ned", "/ned"))
        frd = body.lower() == "frd" or body.lower().endswith(("_frd", "/frd"))
    return ENU_FROM_NED if ned else None, FLU_FROM_FRD if frd else None


def _said(ned: bool, frd: bool) -> str:
    """How poses are converted, in words."""
    worlds, bodies = "north, east, down", "forward, starboard, down"
    named = " of a body ".join([worlds] * ned + [bodies] * frd)
    return f"; taken as {named}" if named else ""


def _untold(reading: Reading) -> str:
    if reading.mount is not None:
        return "--mount"
    return "--sonar" if reading.device is not None else "none: taken as the vehicle's own frame"


def _no_mount(index: Index, frame: str, base: str) -> str:
    if not frame:
        why = "its pings name no frame"
    elif index.tree.knows(frame):
        why = f"TF does not join its frame {frame!r} to the vehicle's {base!r}"
    else:
        why = f"its frame {frame!r} is not in TF"
    return (
        f"where the sonar sits on the vehicle is not known, as {why}; it is taken to sit in the "
        "vehicle's frame, unturned (--mount, or --sonar FILE.toml, says better)"
    )


def _pose_topic(bag: Bag, index: Index, sonar: str, reading: Reading) -> tuple[str | None, str]:
    """The topic of the vehicle's poses, None for TF, and why; no reason where nothing tells."""
    wanted = reading.pose_topic
    if wanted is not None:
        if wanted not in index.tracks:
            told = ", ".join(sorted(index.tracks)) or "none"
            raise RecordingError(f"{bag.path}: no poses on {wanted}; topics of poses: {told}")
        return wanted, ", as --pose-topic says"
    frame = index.frames.get(sonar, "")
    kinds = {name: kind.rsplit("/", 1)[-1] for name, kind in index.counts}
    known = [
        topic
        for topic in sorted(index.tracks)
        if not any(word in topic.lower() for word in _WANTED)
        and not _of_another(index.posed[topic], frame)
    ]
    odometry = [topic for topic in known if kinds[topic] == KINDS[0]]
    carrying = [topic for topic in odometry if index.tree.carries(index.posed[topic], frame)]
    if carrying:
        topic = _only(bag, carrying, sonar)
        return topic, f", whose frame {index.posed[topic]} carries the sonar"
    root, moves = index.tree.root_of(frame)
    world = any(word in root for word in _WORLDS)
    if root and index.tree.moves and (world or (moves and "base" not in root and not odometry)):
        return None, f", up to {root}"
    for kind in KINDS:
        of_kind = [topic for topic in known if kinds[topic] == kind]
        if of_kind:
            return _only(bag, of_kind, sonar), f", the only {kind} that may be the vehicle's"
    return None, ""


def _only(bag: Bag, topics: list[str], sonar: str) -> str:
    """The one of some topics that is left when what is likelier is preferred."""
    for word in _SECOND_CHOICE:
        topics = [topic for topic in topics if word not in topic] or topics
    topics = [topic for topic in topics if namespace(topic) == namespace(sonar)] or topics
    if len(topics) > 1:
        raise RecordingError(
            f"{bag.path}: several topics tell poses; say which are the vehicle's (--pose-topic): "
            f"{', '.join(topics)}"
        )
    return topics[0]


def _of_another(base: str, frame: str) -> bool:
    """Whether a frame is plainly that of another vehicle than a sonar's."""
    one, other = namespace(base), namespace(frame)
    return bool(one and other) and one != other
