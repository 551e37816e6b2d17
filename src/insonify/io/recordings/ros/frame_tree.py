"""TF: transforms between named frames over time, looked up along the tree (REP 105)."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from typing import Any

import numpy as np

from insonify.frames import rotation_from_quaternion, transform_from_pose
from insonify.io.recordings.poses import PoseTrack, is_pose
from insonify.types import Float64

_DEEPEST = 64
_ONCE_S = 5.0


class FrameTree:
    """Frames, each with its parent and where it is in it: fixed, or over time."""

    def __init__(self, max_gap_s: float | None = None) -> None:
        """An empty tree; its moving links bear gaps as `PoseTrack` does.

        Where ``bounds`` tells a link's ``max_gap_s`` and ``fastest_mps``, those hold.  A link that
        is told of a time more than ``window_s`` before the last has had its clock set back, and
        begins anew.
        """
        self._max_gap_s = max_gap_s
        self._fixed: dict[str, tuple[str, Float64]] = {}
        self._rows: dict[str, list[list[float]]] = defaultdict(list)
        self._parents: dict[str, str] = {}
        self._tracks: dict[str, PoseTrack] = {}
        self._told: Counter[str] = Counter()
        self.bounds: dict[str, tuple[float, float]] = {}
        self.window_s = math.inf

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
                if self._rows[child] and row[0] < self._rows[child][-1][0] - self.window_s:
                    self._rows[child].clear()
                self._rows[child].append(row)
                self._told[child] += 1
                self._parents[child] = parent
                self._tracks.pop(child, None)

    def fixed_above(self, frame: str) -> tuple[str, Float64]:
        """The frame that a frame is fixed to, as high up as it goes, and where it is in it."""
        frame, transform = self._known(frame) or _plain(frame), np.eye(4)
        for _ in range(_DEEPEST):
            if frame not in self._fixed or frame in self._rows:
                break
            parent, above = self._fixed[frame]
            transform = above @ transform
            frame = parent
        return frame, transform

    def knows(self, frame: str) -> bool:
        """Whether a frame is in the tree, by its name or that within its vehicle's."""
        return self._known(frame) is not None

    def carries(self, base: str, frame: str) -> bool:
        """Whether a frame hangs from another, or is fixed to it."""
        known = self._known(base)
        return known in self.way_up(frame) or self.in_frame(frame, base) is not None

    def joins(self, frame: str, base: str) -> bool:
        """Whether there is a way from a frame to another."""
        return bool(set(self.way_up(frame)) & set(self.way_up(base)))

    def root_of(self, frame: str) -> tuple[str, bool]:
        """The root that a frame hangs from, nothing if from none, and whether it moves in it."""
        way = self.way_up(frame)
        return (way[-1] if len(way) > 1 else ""), any(one in self._rows for one in way)

    def between(self, base: str, frame: str, time_s: float) -> Float64 | None:
        """``base_from_frame`` (4, 4) at a time; None if a link on the way says nothing of it."""
        ways = self.way_up(base), self.way_up(frame)
        common = next((one for one in ways[1] if one in ways[0]), None)
        if common is None:
            return None
        up = [self._up(way[: way.index(common)], time_s, once_holds=True) for way in ways]
        if up[0] is None or up[1] is None:
            return None
        return np.asarray(np.linalg.inv(up[0]) @ up[1], np.float64)

    def _up(self, way: list[str], time_s: float, *, once_holds: bool = False) -> Float64 | None:
        """Along links, from the first frame of a way to above its last.

        With ``once_holds`` a link that is told a single time is taken as fixed.
        """
        transform = np.eye(4)
        for frame in way:
            if frame not in self._rows:
                link = self._fixed[frame][1]
            else:
                track = self._track(frame)
                once = once_holds and self._told[frame] == 1
                pose = track.sample(0) if once else track.at(time_s)
                if pose is None:
                    return None
                link = transform_from_pose(pose)
            transform = link @ transform
        return transform

    def way_up(self, frame: str) -> list[str]:
        """A frame, what it hangs from, and so on; nothing if it is not in the tree."""
        known = self._known(frame)
        way = [] if known is None else [known]
        while way and len(way) < _DEEPEST:
            above = self._parents.get(way[-1]) or self._fixed.get(way[-1], ("",))[0]
            if not above:
                break
            way.append(above)
        return way

    def _known(self, frame: str) -> str | None:
        """A frame as the tree calls it: one of the two names may lack the vehicle's before it."""
        frame = _plain(frame)
        names = {*self._parents, *self._fixed, *self._parents.values()}
        names |= {parent for parent, _ in self._fixed.values()}
        if not frame or frame in names:
            return frame or None
        alike = [one for one in names if one.endswith(f"/{frame}") or frame.endswith(f"/{one}")]
        return alike[0] if len(alike) == 1 else None

    def in_frame(self, frame: str, base: str) -> Float64 | None:
        """``base_from_frame`` (4, 4) along fixed links alone; None if there is no such way."""
        if _plain(frame) == _plain(base):
            return np.eye(4)
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
        way = self.way_up(frame)
        return self._up(way[:-1], time_s) if 0 < len(way) < _DEEPEST else None

    def told_until_s(self, *frames: str) -> float:
        """Up to when all moving links above some frames are told.

        A link that was told once, and long ago by what others tell, does not move.
        """
        moving = {link for frame in frames for link in self.way_up(frame) if link in self._rows}
        newest_s = {link: max(row[0] for row in self._rows[link]) for link in moving}
        latest_s = max(newest_s.values(), default=math.inf)
        still = {k for k, s in newest_s.items() if self._told[k] == 1 and latest_s - s > _ONCE_S}
        return min((s for k, s in newest_s.items() if k not in still), default=math.inf)

    def forget(self) -> None:
        """Drop what moving links told longer ago than ``window_s``, each by its newest."""
        for child, rows in self._rows.items():
            before_s = max(row[0] for row in rows) - self.window_s
            kept = [row for row in rows if row[0] >= before_s]
            if len(kept) < len(rows):
                self._rows[child] = kept
                self._tracks.pop(child, None)

    def moving_bounds(self) -> dict[str, tuple[float, float]]:
        """What gaps and speeds each moving link bears, by all that it told."""
        tracks = {child: self._track(child) for child in self._rows}
        return {child: (one.max_gap_s, one.fastest_mps) for child, one in tracks.items()}

    def _track(self, child: str) -> PoseTrack:
        if child not in self._tracks:
            rows = np.array(self._rows[child])
            rows = rows[np.argsort(rows[:, 0], kind="stable")]
            max_gap_s, fastest_mps = self.bounds.get(child, (self._max_gap_s, None))
            self._tracks[child] = PoseTrack(rows, max_gap_s, fastest_mps=fastest_mps)
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
