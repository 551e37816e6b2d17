"""The heartbeat of a session: a small file beside what it writes, by which others see how it fares.

Times are those of the machine's monotonic clock, which all its processes and containers share and
nobody sets; after a restart of the machine it is lower, and a heartbeat of before is none.
"""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path

_NAME, _PART = "heartbeat.json", "heartbeat.json.part"
BEAT_S, FRESH_S = 1.0, 10.0
"""Between two; one that is older tells that the session has stopped, or hangs."""
_VERSION = 1


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """How a session fares.

    Attributes:
        at_s: When this was so, by the monotonic clock.
        well: Whether pings come and are mapped.
        words: What it does, or what is wrong.
        pings: How many have come.
        mapped: How many of them are in the map.
    """

    at_s: float
    well: bool
    words: str
    pings: int
    mapped: int

    @property
    def fresh(self) -> bool:
        """Whether the session still lived just now."""
        return 0.0 <= time.monotonic() - self.at_s <= FRESH_S


def write_heartbeat(folder: Path, beat: Heartbeat) -> None:
    """Write it in the place of the last one, in one step.

    Raises:
        OSError: It cannot be written.
    """
    part = folder / _PART
    part.write_text(json.dumps({"version": _VERSION, **asdict(beat)}) + "\n", encoding="utf-8")
    part.replace(folder / _NAME)


def remove_heartbeat(folder: Path) -> None:
    """Remove it: the session ends."""
    for name in (_NAME, _PART):
        (folder / name).unlink(missing_ok=True)


def heartbeats(folder: Path) -> list[tuple[Path, Heartbeat]]:
    """The heartbeats of sessions that write to a folder, or into it or a folder of it.

    Returns:
        Where each is, and what it says, the latest first; those of another version are left out.
    """
    name = folder.absolute().name
    beside = folder.absolute().parent.glob(f".{name}-*/new/{_NAME}") if name else iter(())
    within = (*folder.glob(f".*/new/{_NAME}"), *folder.glob(f"*/.*/new/{_NAME}"))
    paths = sorted({path.resolve() for path in (*beside, *within)})  # links show one twice
    read = ((path, _read(path)) for path in paths)
    found = [(path, beat) for path, beat in read if beat is not None]
    return sorted(found, key=lambda one: -one[1].at_s)


def _read(path: Path) -> Heartbeat | None:
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
        if told.pop("version") != _VERSION:
            return None
        return Heartbeat(**told)
    except (OSError, ValueError, TypeError, KeyError, AttributeError):  # gone, or not of ours
        return None
