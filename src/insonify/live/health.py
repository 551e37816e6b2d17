"""How a session fares, judged by the pings of the last seconds; and its heartbeat on the disk."""

from __future__ import annotations

import logging
import time
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path

from insonify.errors import reason
from insonify.io.heartbeat import BEAT_S, Heartbeat, remove_heartbeat, write_heartbeat
from insonify.live.session import Event, Finished, Heard, Session

_log = logging.getLogger(__name__)

OK, WARN, STALE = 0, 1, 3
"""Levels of diagnostic_msgs/DiagnosticStatus."""
RECENT_S = 5.0
_MOST = 1000


@dataclass(slots=True, eq=False)
class Health:
    """Follows the pings of a session (a watcher of it).

    What is so is judged as of the last event: a session that plans for a while hears nothing then.
    """

    _began_s: float | None = None
    _now_s: float = 0.0
    _recent: deque[tuple[float, bool]] = field(default_factory=lambda: deque(maxlen=_MOST))
    ended: bool = False

    def watch(self, session: Session, event: Event) -> None:
        """Note a ping, and whether it is in the map."""
        self._now_s = time.monotonic()
        if self._began_s is None:
            self._began_s = self._now_s
        if isinstance(event, Heard):
            self._recent.append((self._now_s, event.posed.pose is not None))
        self.ended |= isinstance(event, Finished)  # a plan that ends later does not undo it

    def state(self, session: Session) -> tuple[int, str]:
        """The level, and what is wrong; no words if nothing is."""
        if self.ended:
            return STALE, "ended"
        now_s = self._now_s
        began_s = now_s if self._began_s is None else self._began_s
        last_s = self._recent[-1][0] if self._recent else began_s
        if now_s - last_s > RECENT_S:
            return WARN, f"no ping for {now_s - last_s:.0f} s"
        mapped = [posed for at_s, posed in self._recent if now_s - at_s <= RECENT_S]
        if 2 * sum(mapped) < len(mapped):
            counts = session.counts
            return WARN, (counts.refused and counts.last_damage) or "most pings have no pose"
        return OK, ""


class Pulse:
    """Writes a session's heartbeat into a folder, while it lasts (a watcher of it)."""

    def __init__(self, folder: Path) -> None:
        """Not begun."""
        self._folder, self._health = folder, Health()
        self._due_s = 0.0

    def watch(self, session: Session, event: Event) -> None:
        """Write it when it is due; remove it at the end."""
        self._health.watch(session, event)
        if isinstance(event, Finished):
            remove_heartbeat(self._folder)
        elif not self._health.ended and time.monotonic() >= self._due_s:
            self._due_s = time.monotonic() + BEAT_S
            level, words = self._health.state(session)
            counts = session.counts
            beat = Heartbeat(
                time.monotonic(), level == OK, words or "mapping", counts.pings, counts.mapped
            )
            try:
                write_heartbeat(self._folder, beat)
            except OSError as err:  # a full disk: what is recorded says so, if it must
                _log.warning("no heartbeat could be written (%s)", reason(err))
