"""What is in a bag besides its pictures: topics, poses, TF."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from insonify.frames import std_from_covariance
from insonify.io.recordings.poses import is_pose
from insonify.io.recordings.ros.bags import DAMAGE, Bag, BagMessage
from insonify.io.recordings.ros.frame_tree import FrameTree, pose_row, stamp_ns
from insonify.io.recordings.ros.pings import sonar_shape

STATE = "insonify_msgs/msg/PingState"
TF = "tfmessage"
"""In lower case; ROS 1 had two spellings."""
KINDS = ("Odometry", "PoseWithCovarianceStamped", "PoseStamped")
"""Kinds of messages that tell where the vehicle is, the first found is used."""


@dataclass(slots=True, eq=False)
class Index:
    """All of a bag but its pictures.

    Attributes:
        counts: Messages of each topic and its type.
        sonars: Topics of pings and what they are.
        tracks: Rows of time and pose of each topic of poses, and ``spreads`` how far each may be
            off, see `Pose.std`.
        posed: The frame that each of them poses, and ``worlds`` the one it is posed in.
        states: PingStates by stamp.
        links: Messages of TF with their topics.
        tree: TF, once it is settled of which vehicle.
        frames: The frame of each topic of pings.
        undecoded: How many messages could not be decoded.
        no_poses: How many messages of a topic of poses hold none.
    """

    counts: dict[tuple[str, str], int] = field(default_factory=dict)
    sonars: dict[str, str] = field(default_factory=dict)
    tracks: dict[str, list[list[float]]] = field(default_factory=dict)
    spreads: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    posed: dict[str, str] = field(default_factory=dict)
    worlds: dict[str, str] = field(default_factory=dict)
    states: dict[int, Any] = field(default_factory=dict)
    links: list[tuple[str, Any]] = field(default_factory=list)
    tree: FrameTree = field(default_factory=FrameTree)
    frames: dict[str, str] = field(default_factory=dict)
    undecoded: int = 0
    no_poses: dict[str, int] = field(default_factory=dict)
    _plain: set[str] = field(default_factory=set)

    def settle(self, vehicle: str) -> None:
        """Make the tree: of plain topics, and of the vehicle's own if it has some; else of all."""
        spaces = {namespace(topic) for topic, _ in self.links}
        wanted = {"", vehicle} if vehicle in spaces else spaces
        for topic, message in self.links:
            if namespace(topic) in wanted:
                self.hang(topic, message)

    def hang(self, topic: str, message: Any) -> None:
        """Add a message of TF to the tree."""
        try:
            self.tree.add(message, "static" in topic)
        except DAMAGE:
            self.undecoded += 1

    def note(self, message: BagMessage) -> None:
        """Take what a message tells; of a ping its frame alone."""
        key = (message.topic, message.kind)
        self.counts[key] = self.counts.get(key, 0) + 1
        if message.topic in self._plain or message.topic in self.sonars:
            return
        name = message.kind.rsplit("/", 1)[-1]
        try:
            if name.lower() == TF:
                self.links.append((message.topic, message.decode()))
            elif name in KINDS:
                _note_pose(self, message, message.decode())
            elif message.kind == STATE:
                state = message.decode()
                self.states[stamp_ns(state.header)] = state
            else:
                decoded = message.decode()
                shape = sonar_shape(message.kind, set(getattr(decoded, "__slots__", ()))
                                    or set(vars(decoded)))  # fmt: skip
                if shape is None:
                    self._plain.add(message.topic)
                else:
                    self.sonars[message.topic] = shape
                    self.frames[message.topic] = str(decoded.header.frame_id)
        except DAMAGE:
            self.undecoded += 1

    def forget(self, window_s: float) -> None:
        """Drop what lies longer ago than a time, by the newest that each topic tells."""
        for topic, rows in self.tracks.items():
            before_s = max(row[0] for row in rows) - window_s
            kept = [number for number, row in enumerate(rows) if row[0] >= before_s]
            if len(kept) < len(rows):
                self.tracks[topic] = [rows[number] for number in kept]
                self.spreads[topic] = [self.spreads[topic][number] for number in kept]
        last_ns = next(reversed(self.states), 0)
        for stamp in [ns for ns in self.states if abs(ns - last_ns) > window_s * 1e9]:
            del self.states[stamp]
        self.tree.forget()


def namespace(name: str) -> str:
    """The first part of a topic's or frame's name, if there are several."""
    return name.removeprefix("/").rpartition("/")[0].partition("/")[0]


def index_of(bag: Bag, max_gap_s: float | None) -> Index:
    """Read all of a bag but its pictures."""
    index = Index(tree=FrameTree(max_gap_s))
    for message in bag.read(None):
        index.note(message)
    return index


def _note_pose(index: Index, message: BagMessage, decoded: Any) -> None:
    pose = decoded.pose
    spread = (0.0, 0.0)
    while hasattr(pose, "pose"):
        spread = std_from_covariance(np.reshape(pose.covariance, (6, 6)))
        pose = pose.pose
    time_s = (stamp_ns(decoded.header) or message.time_ns) * 1e-9
    row = [float(number) for number in (time_s, *pose_row(pose))]
    if not is_pose(row):
        index.no_poses[message.topic] = index.no_poses.get(message.topic, 0) + 1
        return
    index.tracks.setdefault(message.topic, []).append(row)
    index.spreads.setdefault(message.topic, []).append(spread)
    index.worlds[message.topic] = str(decoded.header.frame_id)
    index.posed[message.topic] = str(getattr(decoded, "child_frame_id", ""))
