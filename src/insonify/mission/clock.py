"""How long the phases of a mission take."""

from __future__ import annotations

import time
from collections.abc import Iterator

from insonify.mission.loop import Decided, Mapped, Pinged, Step


class Clock:
    """Wall time by phase."""

    def __init__(self) -> None:
        """Start."""
        self.seconds = dict.fromkeys(("setup", "sonar", "mapping", "planning"), 0.0)
        self.restart()

    def restart(self) -> None:
        """What comes counts from now."""
        self._since = time.perf_counter()

    def lap(self, phase: str) -> None:
        """What has passed since counts for a phase."""
        self.seconds[phase] += time.perf_counter() - self._since


_PHASES: dict[type[Step], str] = {Decided: "planning", Pinged: "sonar", Mapped: "mapping"}


def timed(mission: Iterator[Step], clock: Clock) -> Iterator[Step]:
    """The mission's steps; the time each took to come goes to its phase."""
    clock.restart()
    for step in mission:
        if type(step) in _PHASES:
            clock.lap(_PHASES[type(step)])
        yield step
        clock.restart()
