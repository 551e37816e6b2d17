"""Findings of a check, and pings as views to be compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np

from insonify.frames import transform_from_pose
from insonify.io.recordings.poses import PoseTrack
from insonify.mapping.consistency import Verdict, View
from insonify.types import PosedPing

FLIP = np.diag([1.0, 1.0, -1.0])
"""The vehicle's up and down exchanged: a rotation between two of these has the other tilt."""


class Answer(StrEnum):
    """What a check finds."""

    RIGHT = "as recorded"
    WRONG = "the other way"
    LIKELY_RIGHT = "as recorded, presumably"
    LIKELY_WRONG = "the other way, presumably"
    UNKNOWN = "cannot tell"
    ALIKE = "makes no difference"

    @property
    def otherwise(self) -> bool:
        """Whether it speaks against the recording."""
        return self in {Answer.WRONG, Answer.LIKELY_WRONG}


@dataclass(frozen=True, slots=True)
class Finding:
    """One question answered.

    Attributes:
        answer: What was found.
        why: In a sentence.
        verdict: The comparison it rests on, if on one.
    """

    answer: Answer
    why: str
    verdict: Verdict | None = None

    def to_json(self) -> dict[str, Any]:
        """As JSON."""
        told: dict[str, Any] = {"answer": self.answer.value, "why": self.why}
        if self.verdict is not None:
            told |= {
                "contradiction_spared": round(self.verdict.gains[0], 4),
                "likeness_won": round(self.verdict.gains[1], 4),
                "sigmas": [round(value, 2) for value in self.verdict.sigmas],
                "pings": self.verdict.pings,
            }
        return told


def spread(count: int, most: int) -> list[int]:
    """At most so many numbers below a count, evenly spread."""
    return sorted(set(np.linspace(0, count - 1, min(most, count)).astype(int).tolist()))


def view_of(posed: Sequence[PosedPing], *, tilted: bool = False, mirrored: bool = False) -> View:
    """Pings where they were, the sonar's mount upside down in the vehicle's plane or not."""
    places = np.full((len(posed), 4, 4), np.nan)
    for number, one in enumerate(posed):
        if one.pose is not None:
            mount = transform_from_pose(one.ping.geometry.mount)
            if tilted:
                mount[:3, :3] = FLIP @ mount[:3, :3] @ FLIP
            places[number] = transform_from_pose(one.pose) @ mount
    return View(places, mirrored)


def track_of(posed: Sequence[PosedPing]) -> PoseTrack:
    """The poses of pings over their times."""
    return PoseTrack.of((one.ping.time_s, one.pose) for one in posed if one.pose is not None)


def shifted(posed: Sequence[PosedPing], offset_s: float) -> list[PosedPing]:
    """Pings at the poses of other times, as far as there are some."""
    track = track_of(posed)
    return [replace(one, pose=track.at(one.ping.time_s + offset_s)) for one in posed]
