"""What has come over the bus and waits to be taken: emptied out of DDS as it comes, and counted.

DDS drops the oldest sample of a queue that is full, and tells nobody.  So its own queues have no
end here; a thread empties them at once, however long a ping takes to be mapped, into queues that
have one, and what is dropped there is counted.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from dataclasses import dataclass
from typing import Any

from insonify.extras import require

require("live", "Programs on the robot's bus", "cyclonedds")

from cyclonedds.core import (  # noqa: E402
    InstanceState,
    ReadCondition,
    SampleState,
    ViewState,
    WaitSet,
)
from cyclonedds.util import duration  # noqa: E402

_UNREAD = ViewState.Any | InstanceState.Any | SampleState.NotRead
_TAKEN = 32
"""Samples of a reader that are taken at once."""
_WAIT_MS = 100


@dataclass(slots=True, eq=False)
class _Queue:
    """One reader, what of it waits, and how much may."""

    reader: Any
    condition: Any
    depth: int
    waiting: deque[tuple[Any, int]]


class Inbox:
    """Readers of a participant, emptied as they fill."""

    def __init__(self, participant: Any) -> None:
        """Without readers; from now on a thread waits for them.

        Args:
            participant: Of DDS.
        """
        self.overwritten = 0
        self._lost_before = 0
        self._waitset = WaitSet(participant)
        self._queues: dict[str, _Queue] = {}
        self._lock = threading.Lock()
        self._came = threading.Condition()
        self._closed = threading.Event()
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._run, name="inbox", daemon=True)
        self._thread.start()

    @property
    def lost(self) -> int:
        """Samples that DDS knows its readers have missed."""
        with self._lock:
            return self._lost_before + sum(_lost(queue.reader) for queue in self._queues.values())

    def read(self, name: str, reader: Any, depth: int) -> None:
        """Read a reader under a name, in the place of another if there was one.

        Args:
            name: By which `take` is asked for it.
            reader: Of DDS, which should keep all.
            depth: How many samples wait at most; then the oldest go.
        """
        condition = ReadCondition(reader, _UNREAD)
        with self._lock:
            before = self._queues.get(name)
            waiting: deque[tuple[Any, int]] = deque()
            if before is not None:
                self._waitset.detach(before.condition)
                self._empty(before)
                self._lost_before += _lost(before.reader)
                waiting = before.waiting
            self._queues[name] = _Queue(reader, condition, depth, waiting)
            self._waitset.attach(condition)

    def wait(self, wait_s: float) -> None:
        """Wait until something has come, or a time has passed."""
        with self._came:
            self._came.wait_for(self._has_any, wait_s)

    def take(self, name: str, count: int) -> list[tuple[Any, int]]:
        """The oldest samples of a reader, each with when it came, in nanoseconds.

        Raises:
            Exception: Whatever went wrong while it was read.
        """
        if self._error is not None:
            raise self._error
        with self._came:
            waiting = self._queues[name].waiting
            return [waiting.popleft() for _ in range(min(count, len(waiting)))]

    def close(self) -> None:
        """Read no more."""
        self._closed.set()
        self._thread.join()
        with self._lock:
            self._queues.clear()

    def _has_any(self) -> bool:
        return self._error is not None or any(queue.waiting for queue in self._queues.values())

    def _run(self) -> None:
        try:
            while not self._closed.is_set():
                self._waitset.wait(duration(milliseconds=_WAIT_MS))
                with self._lock:
                    for queue in self._queues.values():
                        self._empty(queue)
        except Exception as err:  # noqa: BLE001  told to who takes: nobody looks at a thread
            with self._came:
                self._error = err
                self._came.notify_all()

    def _empty(self, queue: _Queue) -> None:
        """Move all that a reader has into its queue."""
        taken = _TAKEN
        while taken == _TAKEN:
            samples = queue.reader.take(_TAKEN)
            taken, now_ns = len(samples), time.time_ns()
            with self._came:
                for sample in samples:
                    if not sample.sample_info.valid_data:  # a writer has gone
                        continue
                    if len(queue.waiting) >= queue.depth:
                        queue.waiting.popleft()
                        self.overwritten += 1
                    queue.waiting.append((sample, now_ns))
                if samples:
                    self._came.notify_all()


def _lost(reader: Any) -> int:
    return int(reader.get_sample_lost_status().total_count)
