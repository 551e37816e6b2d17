"""TF: transforms between named frames over time, looked up along the tree (REP 105)."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

import numpy as np

from insonify.frames import rotation_from_quaternion, transform_from_pose
from insonify.io.recordings.poses import PoseTrack, is_pose
from insonify.types import Float64

_DEEPEST = 64


class FrameTree:
    """Frames, each with its parent and where it is in it: fixed, or over time."""

    def __init__(self, max_gap_s: float | None = None) -> None:
        """An empty tree; its moving links bear gaps as `PoseTrack` does."""
        self._max_gap_s = max_gap_s
        self._fixed: dict[str, tuple[str, Float64]] = {}
        self._rows: dict[str, list[list[float]]] = defaultdict(list)
        self._parents: dict[str, str] = {}
        self._tracks: dict[str, PoseTrack] = {}

    def add(self, message: Any, fixed: bool) -> None:
        """Take the transforms of a TFMessage; those of /tf_static are ``fixed``.

        Raises:
            ValueError: A transform is no rigid motion.
        """
        for link in message.transforms:
            child, parent = _plain(link.child_frame_id), _plain(link.header.frame_id)
            row = [stamp_s(link.header), *_numbers(link.transform)]
            if not is_pose(row):
                raise ValueError(f"the transform from {parent} to {child} is no rigid motion")
            if fixed:
                turn = np.eye(4)
                turn[:3, :3] = rotation_from_quaternion(np.array(row[4:]))
                turn[:3, 3] = row[1:4]
                self._fixed[child] = (parent, turn)
            else:
                self._rows[child].append(row)
                self._parents[child] = parent
                self._tracks.pop(child, None)

    def fixed_above(self, frame: str) -> tuple[str, Float64]:
        """The frame that a frame is fixed to, as high up as it goes, and where it is in it."""
        frame, transform = _plain(frame), np.eye(4)
        for _ in range(_DEEPEST):
            if frame not in self._fixed or frame in self._rows:
                break
            parent, above = self._fixed[frame]
            transform = above @ transform
            frame = parent
        return frame, transform

    def in_frame(self, frame: str, base: str) -> Float64 | None:
        """``base_from_frame`` (4, 4) along fixed links alone; None if there is no such way."""
        top, top_from_frame = self.fixed_above(frame)
        other, top_from_base = self.fixed_above(base)
        if top != other:
            return None
        return np.asarray(np.linalg.inv(top_from_base) @ top_from_frame, np.float64)

    @property
    def moves(self) -> bool:
        """Whether any frame moves."""
        return bool(self._rows)

    def in_root(self, frame: str, time_s: float) -> Float64 | None:
        """``root_from_frame`` (4, 4) at a time; None where a link above says nothing of it."""
        frame, transform = _plain(frame), np.eye(4)
        for _ in range(_DEEPEST):
            if frame in self._rows:
                pose = self._track(frame).at(time_s)
                if pose is None:
                    return None
                transform = transform_from_pose(pose) @ transform
                frame = self._parents[frame]
            elif frame in self._fixed:
                frame, above = self._fixed[frame]
                transform = above @ transform
            else:
                return transform
        return None

    def _track(self, child: str) -> PoseTrack:
        if child not in self._tracks:
            rows = np.array(self._rows[child])
            rows = rows[np.argsort(rows[:, 0], kind="stable")]
            self._tracks[child] = PoseTrack(rows, self._max_gap_s)
        return self._tracks[child]


def stamp_s(header: Any) -> float:
    """A header's stamp in seconds."""
    return stamp_ns(header) * 1e-9


def stamp_ns(header: Any) -> int:
    """A header's stamp in nanoseconds, ROS 1 or 2."""
    stamp = header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def pose_row(pose: Any) -> list[float]:
    """Position and quaternion of a geometry_msgs/Pose."""
    p, q = pose.position, pose.orientation
    return [p.x, p.y, p.z, q.x, q.y, q.z, q.w]


def _numbers(transform: Any) -> list[float]:
    t, q = transform.translation, transform.rotation
    return [t.x, t.y, t.z, q.x, q.y, q.z, q.w]


def _plain(frame: str) -> str:
    """ROS 1 writes some frames with a slash before."""
    return frame.removeprefix("/")
