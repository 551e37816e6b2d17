"""One progress bar for every command, which also tells of kernels that are being compiled."""

from __future__ import annotations

import atexit
import logging
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

from insonify.cli.printing import before_output, console, tell
from insonify.names import plain

if TYPE_CHECKING:
    from rich.progress import Progress

ANNOUNCEMENT = "compiling kernels, once: the next start is quick"


class Bar:
    """A bar on stderr; nothing is drawn where that is no terminal."""

    def __init__(self, name: str, total: int | None = None) -> None:
        """Not yet drawn.

        Args:
            name: What is going on.
            total: How much there is to do, if that is known.
        """
        self._name, self._total = plain(name), total
        self._progress: Progress | None = None
        self._task: Any = None
        self._started = time.perf_counter()

    def show(
        self,
        done: int | None = None,
        total: int | None = None,
        name: str | None = None,
        note: str = "",
    ) -> None:
        """Move on."""
        self._name = self._name if name is None else plain(name)
        self._total = self._total if total is None else total
        if self._progress is not None:
            self._progress.update(
                self._task,
                completed=done,
                total=self._total,
                description=self._name,
                note=note,
            )

    def restart(self, name: str, total: int | None) -> None:
        """Begin anew with another job."""
        self._started = time.perf_counter()
        self._name, self._total = plain(name), total
        if self._progress is not None:
            self._progress.remove_task(self._task)  # a reset one would keep its total
            self._task = self._progress.add_task(self._name, total=total, note="")

    def rate(self, done: int) -> float:
        """Things done each second since the last `restart`."""
        return done / max(time.perf_counter() - self._started, 1e-9)

    def tell(self, note: str) -> None:
        """Say something beside the bar."""
        if self._progress is not None:
            self._progress.update(self._task, note=note)

    @contextmanager
    def drawn(self, *, alone: bool = True) -> Iterator[Bar]:
        """Draw it while the block lasts, ``alone`` in the place of the one of `begin`."""
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        if alone:
            _first.close()

        shown = console(stderr=True)
        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TextColumn("{task.fields[note]}", markup=False),
        )
        with Progress(
            *columns, TimeElapsedColumn(), console=shown, transient=True,
            disable=not shown.is_terminal, redirect_stdout=alone,
        ) as self._progress:  # fmt: skip
            self._task = self._progress.add_task(self._name, total=self._total, note="")
            _drawn.append(self)
            try:
                yield self
            finally:
                _drawn.remove(self)
                self._progress = None


_drawn: list[Bar] = []
"""The bars on the screen."""
_first = ExitStack()
"""Closes the bar that a command begins with."""


def begin(name: str) -> None:
    """Draw a bar at once, before anything is imported, until there is another or something to say.

    Args:
        name: What is going on.
    """
    if sys.stderr.isatty():
        _first.enter_context(Bar(name).drawn(alone=False))
        before_output(_first.close)
        atexit.register(_first.close)


@contextmanager
def progress(name: str, total: int | None = None) -> Iterator[Bar]:
    """A bar for a job.

    Args:
        name: What is going on.
        total: How much there is to do, if that is known.
    """
    with Bar(name, total).drawn() as bar:
        yield bar


class _Log(logging.Handler):
    """Shows what the library says; of kernels being compiled, once in words and then how many."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.compiled = 0
        self.uncached = False  # as was said, so that no quick start is promised

    def emit(self, record: logging.LogRecord) -> None:
        """Show one message."""
        compiling = record.name == "insonify.jit" and record.levelno == logging.INFO
        self.uncached |= record.name == "insonify.jit" and not compiling
        if not compiling or (self.compiled == 0 and not self.uncached):
            text = ANNOUNCEMENT if compiling else record.getMessage()
            tell(f"insonify: {text}")
        if compiling:
            self.compiled += 1
            for bar in _drawn:
                bar.tell(f"compiling kernel {self.compiled}")


_shown = _Log()


def show_log() -> None:
    """From now on, show what the library logs."""
    log = logging.getLogger("insonify")
    log.setLevel(logging.INFO)
    log.propagate = False
    log.handlers[:] = [_shown]
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # that its cache is nowhere is no news


def compiled_kernels() -> int:
    """How many kernels were compiled since the log is shown."""
    return _shown.compiled
