"""Whether a recording is what it is taken for: its side, the tilt's sign, its clock.

A wrong assumption shows in the data: pings that see one thing from two places contradict each
other.  Some dozens of pings are taken as told and otherwise, and the ways compared
(`insonify.mapping.consistency`).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from insonify.errors import RecordingError
from insonify.frames import pose_from_transform, transform_from_pose
from insonify.io.recordings.recording import BEAMS, Reading, Recording
from insonify.mapping.consistency import PingStack, Verdict
from insonify.mapping.echoes import noise_threshold
from insonify.mission.check_clock import check_clock
from insonify.mission.findings import FLIP, Answer, Finding, shifted, spread, view_of
from insonify.types import Pose, PosedPing

MOST_PINGS = 150
_LEAST_PINGS = 6
_SIGMAS, _GAIN = 2.4, 0.03
"""A way is better if it gains as much, that surely."""
_SURE_SIGMAS = 5.0
"""Of tilts: small turns of the vehicle tell them apart, which a wrong clock does too."""
_FLOOR = 0.35
"""So many of the first echoes on one level are a floor, or a surface."""
_LEVEL = math.sin(math.radians(3.0))
_SURFACE_M = 0.5
_ROLLED = np.diag([1.0, -1.0, -1.0])
_NEITHER = 0.4
"""Of echoes, contradicted at most by the better of two sides."""


@dataclass(frozen=True, slots=True)
class Check:
    """What the pings of a recording say of how it is taken.

    Attributes:
        pings: How many were compared.
        lit: What counts as an echo, of 1.
        side: Whether the columns run as told.
        tilt: Whether the sonar looks down or up as told.
        clock: Whether poses belong to pings as told; None without a clock.
        clock_offset_s: What fits best, to be added to the pings' times.
        conclusion: All of it in a sentence.
        options: What to say to `map`, so that the recording is taken rightly.
    """

    pings: int
    lit: float
    side: Finding
    tilt: Finding
    clock: Finding | None
    clock_offset_s: float
    conclusion: str
    options: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "pings": self.pings,
            "echo_above": round(self.lit, 4),
            "side": self.side.to_json(),
            "tilt": self.tilt.to_json(),
            "clock": None if self.clock is None else self.clock.to_json(),
            "clock_offset_s": self.clock_offset_s,
            "conclusion": self.conclusion,
            "options": list(self.options),
        }


def check_recording(recording: Recording, reading: Reading = Reading()) -> Check:
    """Compare pings of a recording with each other, taken as told and otherwise.

    Args:
        recording: What is checked.
        reading: What the user said of it when it was opened, to which the options add.

    Raises:
        RecordingError: It has too few pings with a pose, or nothing in them is an echo.
    """
    posed = _chosen(recording)
    fan = posed[0].ping.geometry
    images = [np.nan_to_num(one.ping.image) for one in posed]
    lit = noise_threshold(images)
    stack = PingStack(fan, images, lit)
    side = _side(stack, posed)
    clock, offset_s = None, 0.0
    if recording.timed:
        clock, offset_s = check_clock(posed, lit, mirrored=side.answer.otherwise)
    if offset_s:
        posed = shifted(posed, offset_s)
        side = _side(stack, posed)
    tilt = _tilt(stack, posed, mirrored=side.answer.otherwise)
    options = _options(recording, reading, posed, side, tilt)
    if offset_s:
        options.append(f"--clock-offset {reading.clock_offset_s + offset_s:.2f}")
    conclusion = _concluded(side, tilt, offset_s)
    return Check(len(posed), lit, side, tilt, clock, offset_s, conclusion, tuple(options))


def _chosen(recording: Recording) -> list[PosedPing]:
    """Pings with poses spread over the recording, all of the fan that most of them have."""
    shapes = Counter(
        replace(one.ping.geometry, mount=Pose(0.0, 0.0, 0.0))
        for one in recording
        if one.pose is not None
    )
    shape, count = shapes.most_common(1)[0] if shapes else (None, 0)
    if count < _LEAST_PINGS:
        raise RecordingError(
            f"{recording.path}: {count} of its pings have a pose, and pings are compared with each "
            f"other, so {_LEAST_PINGS} at least are needed (--poses FILE gives poses)"
        )
    wanted = set(spread(count, MOST_PINGS))
    chosen, number = [], 0
    for one in recording:
        if one.pose is None or replace(one.ping.geometry, mount=Pose(0.0, 0.0, 0.0)) != shape:
            continue
        if number in wanted:
            chosen.append(one)
        number += 1
    return chosen


def _better(verdict: Verdict, sigmas: float = _SIGMAS) -> bool | None:
    """Whether the first of two ways is better, or worse; None if they cannot be told apart."""
    strength = 0.0
    for told in verdict.sigmas:
        strength += math.copysign(told * told, told)
    sure = math.sqrt(abs(strength)) >= sigmas
    if not sure or abs(max(verdict.gains, key=abs)) < _GAIN:
        return None
    return strength > 0.0


def _said(verdict: Verdict) -> str:
    spared, won = verdict.gains
    return (
        f"over {verdict.pings} pings it spares {100 * abs(spared):.1f} % of the echoes a "
        f"contradiction, and pings are {abs(won):.2f} more alike"
    )


def _side(stack: PingStack, posed: Sequence[PosedPing]) -> Finding:
    verdict = stack.contest(view_of(posed), view_of(posed, mirrored=True))
    better = _better(verdict)
    if better is None:  # perhaps the tilt is wrong, and hides it
        tilted, over = (view_of(posed, tilted=True, mirrored=m) for m in (False, True))
        other = stack.contest(tilted, over)
        better, verdict = (_better(other), other) if other.pings else (better, verdict)
    if better is None:
        why = (
            "no two pings lie so to each other that a mirror image would differ (a straight track)"
            if verdict.pings == 0
            else f"the pings agree as well in the mirror (over {verdict.pings} that could tell)"
        )
        return Finding(Answer.UNKNOWN, why, verdict)
    left = np.nanmean(stack.contradictions(view_of(posed, mirrored=not better)))
    if left > _NEITHER:
        why = (
            f"neither way fits: {100 * left:.0f} % of the echoes are contradicted in the better "
            "one, so poses, clock or mount may be wrong"
        )
        return Finding(Answer.UNKNOWN, why, verdict)
    return Finding(Answer.RIGHT if better else Answer.WRONG, _said(verdict), verdict)


def _tilt(stack: PingStack, posed: Sequence[PosedPing], *, mirrored: bool) -> Finding:
    """Whether the sonar looks down or up: by the pings, else by the floor they see."""
    base = view_of(posed, mirrored=mirrored)
    other = view_of(posed, tilted=True, mirrored=mirrored)
    down = -float(np.nanmean(base.world_from_sonar[:, 2, 0]))
    if abs(down) < _LEVEL:
        return Finding(Answer.ALIKE, "the sonar looks out level")
    verdict = stack.contest(base, other)
    better = _better(verdict, _SURE_SIGMAS)
    if better is not None:
        return Finding(Answer.RIGHT if better else Answer.WRONG, _said(verdict), verdict)
    share, level_m, above = stack.floor(base)
    angle = (
        f"{math.degrees(math.asin(min(1.0, abs(down)))):.0f} degrees {'down' if down > 0 else 'up'}"
    )
    if share < _FLOOR:
        answer = Answer.LIKELY_RIGHT if down > 0.0 else Answer.LIKELY_WRONG
        why = f"nothing in the pings tells; as recorded it looks {angle}, and things lie below"
        return Finding(answer, why, verdict)
    if above and abs(level_m) < _SURFACE_M:
        why = f"it looks {angle}, at what may be the water's surface at {level_m:.1f} m"
        return Finding(Answer.UNKNOWN, why, verdict)
    where = f"{share:.0%} of its beams first hear a level at {level_m:.1f} m"
    if above:
        why = f"{where}, above the vehicle: a seabed lies below it"
        return Finding(Answer.WRONG, why, verdict)
    return Finding(Answer.RIGHT, f"{where}, below the vehicle, as a seabed lies", verdict)


def _options(
    recording: Recording,
    reading: Reading,
    posed: Sequence[PosedPing],
    side: Finding,
    tilt: Finding,
) -> list[str]:
    """What sets side and tilt right; of a sonar that turns on the vehicle a mount says nothing."""
    mirrored, tilted = side.answer.otherwise, tilt.answer.otherwise
    if mirrored and not tilted:
        taken = str(recording.facts.get("columns", "")).replace(" ", "-")
        return [f"--beams {next(one for one in BEAMS if one != taken)}"]
    mounts = {one.ping.geometry.mount for one in posed}
    if not tilted or len(mounts) > 1:
        return []
    mount = transform_from_pose(posed[0].ping.geometry.mount)
    mount[:3, :3] = FLIP @ mount[:3, :3] @ FLIP
    if mirrored:  # a fan is as high above its plane as below: rolled over, it is its mirror image
        mount[:3, :3] = mount[:3, :3] @ _ROLLED
    pose = pose_from_transform(mount)
    turns = (math.degrees(angle) for angle in (pose.roll_rad, pose.pitch_rad, pose.yaw_rad))
    numbers = [*pose.position_m, *turns]
    return [f'--mount "{" ".join(f"{round(number, 4) + 0.0:g}" for number in numbers)}"']


def _concluded(side: Finding, tilt: Finding, offset_s: float) -> str:
    """The findings in a sentence."""
    mirrored, tilted = side.answer.otherwise, tilt.answer.otherwise
    told: list[str] = []
    if mirrored and tilted:
        told.append("the sonar is mounted upside down")
    elif mirrored:
        level = " (or the level sonar upside down)" if tilt.answer is Answer.ALIKE else ""
        told.append(f"its images are mirrored{level}")
    elif tilted:
        told.append("the tilt's sign is wrong")
    if offset_s:
        told.append(f"its poses fit {offset_s:+.2f} s away")
    if told:
        guess = tilt.answer is Answer.LIKELY_WRONG
        return ("presumably, " if guess else "") + " and ".join(told)
    unknown = [
        name
        for name, finding in (("side", side), ("tilt", tilt))
        if finding.answer is Answer.UNKNOWN
    ]
    if unknown:
        return f"its {' and '.join(unknown)} cannot be told from its pings"
    return "nothing speaks against it"
