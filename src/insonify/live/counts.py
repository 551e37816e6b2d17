"""What happened to messages: nothing that is lost is lost in silence."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

_KEPT = 20_000
"""Latencies of which quantiles are told."""


@dataclass(slots=True)
class Counts:
    """What happened to messages since the start.

    Attributes:
        messages: That came.
        pings: Of them, on the sonar's topic.
        mapped: Pings in the map.
        unposed: Pings that left without a pose: too early, too late, in a gap, or it never came.
        duplicates: Pings that came again, and are mapped once.
        out_of_order: Pings that came after a later one.
        damaged: Messages that could not be decoded, or are no pings.
        refused: Pings that the map cannot hold: no memory, or a pose too far away.
        poses: Messages of poses.
        late_poses: Of them, those that came after a later one.
        clock_resets: How often the poses' clock was set back.
        lost: Messages that did not come, of those that DDS knows of.
        overwritten: Messages that came and made room for later ones, because mapping was behind.
        paths_asked: Requests for a path.
        paths_held: Of them, those that came while one was planned, and were answered after it.
        paths_sent: Answers, those that there is none to fly too.
        longest_gap_s: Between two pings, by the times that they tell.
        last_damage: What was wrong with the last that could not be read.
        latencies_s: From a ping's sending to its place in the map, of the last thousands.
    """

    messages: int = 0
    pings: int = 0
    mapped: int = 0
    unposed: int = 0
    duplicates: int = 0
    out_of_order: int = 0
    damaged: int = 0
    refused: int = 0
    poses: int = 0
    late_poses: int = 0
    clock_resets: int = 0
    lost: int = 0
    overwritten: int = 0
    paths_asked: int = 0
    paths_held: int = 0
    paths_sent: int = 0
    longest_gap_s: float = 0.0
    last_damage: str = ""
    latencies_s: deque[float] = field(default_factory=lambda: deque(maxlen=_KEPT))

    def note_gap(self, gap_ns: int) -> None:
        """Note the time between two pings."""
        self.longest_gap_s = max(self.longest_gap_s, round(gap_ns * 1e-9, 3))

    def latency_ms(self) -> dict[str, float] | None:
        """Median and 99 % from ping to map; None if no ping tells when it was sent."""
        if not self.latencies_s:
            return None
        median, most = np.quantile(self.latencies_s, [0.5, 0.99]) * 1e3
        return {"median": round(float(median), 3), "p99": round(float(most), 3)}

    def to_json(self) -> dict[str, Any]:
        """As JSON's types."""
        told = {one.name: getattr(self, one.name) for one in fields(self)}
        del told["latencies_s"]
        latency = self.latency_ms()
        return told if latency is None else told | {"latency_ms": latency}
