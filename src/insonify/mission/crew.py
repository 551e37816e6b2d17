"""Who flies the runs of a campaign: this process, some processes of this machine, a cluster.

A crew takes configs and gives results; it writes nothing.  A run that fails is a result too.
"""

from __future__ import annotations

import os
import signal
import traceback
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from multiprocessing import connection, get_context
from types import TracebackType
from typing import Any, Protocol, Self

import numba
from numba.core import config as numba_config

from insonify.errors import InsonifyError
from insonify.mission.campaign import Chain, with_scans
from insonify.mission.loop import Step
from insonify.mission.result import ScanResult
from insonify.mission.run import Run, execute
from insonify.mission.setup import Config

_NUMBA: Any = numba_config
_GRACE_S = 10.0
_MOMENT_S = 0.2
"""How long is waited for results before somebody is asked whether to stop."""


@dataclass(frozen=True, slots=True)
class Failure:
    """Why a run has no result.

    Attributes:
        message: One sentence.
        traceback: Where it happened, if it was no bad input but a fault.
    """

    message: str
    traceback: str = ""

    def error(self) -> Exception:
        """As an exception, for those who cannot go on without the run."""
        return RuntimeError(self.traceback) if self.traceback else InsonifyError(self.message)


Outcome = ScanResult | Failure
Place = tuple[int, int]
"""Of a run in a campaign: the number of its chain, and its own in there."""


@dataclass(frozen=True, slots=True)
class Landed:
    """A run that is over.

    Attributes:
        place: Which it was.
        config: Its config, whole.
        outcome: What came of it.
        known: Whether it was flown before.
    """

    place: Place
    config: Config
    outcome: Outcome
    known: bool


class Crew(AbstractContextManager["Crew"], Protocol):
    """Whoever flies runs; leaving the block ends what is still flown."""

    def room(self) -> int:
        """How many more runs it can be given now."""

    def take(self, place: Place, config: Config) -> None:
        """Begin with a run."""

    def landed(self) -> list[tuple[Place, Outcome]]:
        """What is over since the last call; waits a moment at most, or for one run.

        Raises:
            ClusterError: The crew is lost.
        """


def fly_all(
    plan: Sequence[Chain],
    crew: Crew,
    known: Callable[[Config], ScanResult | None] = lambda config: None,
    should_stop: Callable[[], bool] = lambda: False,
) -> Iterator[Landed]:
    """Fly the runs of a campaign, those that are known left out.

    The planners with a fixed plan wait for the first of their chain, which says how many scans.

    Args:
        plan: The runs.
        crew: Who flies them.
        known: The result of a run that was flown before, if it was.
        should_stop: Asked again and again; if true, nothing more is yielded.

    Yields:
        Each run as soon as it is over.
    """
    ready = deque(
        (number, k) for number, one in enumerate(plan) for k in range(len(one.runs))
        if k not in one.following
    )  # fmt: skip
    flying: dict[Place, Config] = {}
    scans: dict[int, int] = {}

    def over(landed: Landed) -> Landed:
        number, k = landed.place
        one = plan[number]
        if k == one.first:
            if isinstance(landed.outcome, ScanResult):
                scans[number] = landed.outcome.scans
            ready.extendleft((number, after) for after in reversed(one.following))
        return landed

    while (ready or flying) and not should_stop():
        while ready and crew.room() > 0 and not should_stop():
            place = ready.popleft()
            config, lacking = _ready(plan[place[0]], place, scans)
            before: Outcome | None = lacking or known(config)
            if before is not None:
                yield over(Landed(place, config, before, known=lacking is None))
            else:
                flying[place] = config
                crew.take(place, config)
        for place, outcome in crew.landed() if flying else ():
            yield over(Landed(place, flying.pop(place), outcome, known=False))


def known_runs(
    plan: Sequence[Chain], known: Callable[[Config], ScanResult | None]
) -> Iterator[Landed]:
    """The runs of a campaign that were flown before, by their place; nothing is flown."""
    for number, one in enumerate(plan):
        scans: dict[int, int] = {}
        found = []
        for k in sorted(range(len(one.runs)), key=lambda k: k in one.following):
            config, lacking = _ready(one, (number, k), scans)
            result = None if lacking else known(config)
            if result is not None:
                if k == one.first:
                    scans[number] = result.scans
                found.append(Landed((number, k), config, result, known=True))
        yield from sorted(found, key=lambda landed: landed.place)


def _ready(chain: Chain, place: Place, scans: dict[int, int]) -> tuple[Config, Failure | None]:
    """The whole config of a run, and why it cannot be flown if it cannot."""
    number, k = place
    config = chain.runs[k]
    if k not in chain.following:
        return config, None
    if number not in scans:
        assert chain.first is not None
        first = chain.runs[chain.first].planner
        return config, Failure(f"{first}, whose number of scans {config.planner} takes, failed")
    return with_scans(config, scans[number]), None


def fly_run(
    config: Config,
    watch: Callable[[Run, Step], None] = lambda run, step: None,
    should_stop: Callable[[], bool] = lambda: False,
) -> Outcome:
    """One run: a pure function of its config, timings aside."""
    try:
        result = execute(config, watch=watch, should_stop=should_stop).result()
    except InsonifyError as err:
        return Failure(str(err))
    except Exception as err:  # noqa: BLE001  a fault in a user's own part must not end the others
        return Failure(f"{type(err).__name__}: {err}", traceback.format_exc())
    # a planner of a user's own may call itself anything; the row has its full name
    return result.model_copy(update={"planner": config.planner})


class Here(Crew):
    """This process, one run after another."""

    def __init__(
        self,
        watch: Callable[[Run, Step], None] = lambda run, step: None,
        should_stop: Callable[[], bool] = lambda: False,
    ) -> None:
        """Not yet flying.

        Args:
            watch: Called after every step of every run.
            should_stop: Asked after every ping; if true the run is broken off and forgotten.
        """
        self._watch, self._should_stop = watch, should_stop
        self._next: tuple[Place, Config] | None = None

    def room(self) -> int:
        """One, if none waits."""
        return 0 if self._next else 1

    def take(self, place: Place, config: Config) -> None:
        """Put a run in line."""
        self._next = (place, config)

    def landed(self) -> list[tuple[Place, Outcome]]:
        """Fly the run in line."""
        assert self._next is not None
        (place, config), self._next = self._next, None
        outcome = fly_run(config, self._watch, self._should_stop)
        return [] if self._should_stop() else [(place, outcome)]

    def __exit__(self, *raised: object) -> None:
        """Nothing is left."""


@dataclass(slots=True, eq=False)
class _Worker:
    """A process, the pipe to it, and the run that it flies."""

    process: Any
    pipe: Any
    place: Place | None = field(default=None)


class Processes(Crew):
    """Processes of this machine, each with its share of the cores.

    The caller's script wants the guard ``__name__ == "__main__"``.
    """

    def __init__(self, workers: int) -> None:
        """Start them.

        Args:
            workers: How many.
        """
        self._threads = max(1, all_cores() // workers)
        self._workers = [self._start() for _ in range(workers)]

    def _start(self) -> _Worker:
        spawn = get_context("spawn")
        ours, theirs = spawn.Pipe()
        process = spawn.Process(target=_work, args=(theirs, self._threads), daemon=True)
        process.start()
        theirs.close()  # so that the end of the process is the end of the pipe
        return _Worker(process, ours)

    def room(self) -> int:
        """As many as are idle."""
        return sum(worker.place is None for worker in self._workers)

    def take(self, place: Place, config: Config) -> None:
        """Hand a run to an idle process."""
        number = next(k for k, worker in enumerate(self._workers) if worker.place is None)
        if not self._workers[number].process.is_alive():
            self._replace(number)
        self._workers[number].place = place
        self._workers[number].pipe.send(config)

    def landed(self) -> list[tuple[Place, Outcome]]:
        """What came through the pipes; a process that was killed has failed its run."""
        busy = [worker.pipe for worker in self._workers if worker.place is not None]
        found: list[tuple[Place, Outcome]] = []
        for pipe in connection.wait(busy, _MOMENT_S):
            number = next(k for k, one in enumerate(self._workers) if one.pipe is pipe)
            worker = self._workers[number]
            assert worker.place is not None
            try:
                outcome: Outcome = worker.pipe.recv()
            except (EOFError, OSError):
                outcome = _ended(worker.process)
                self._replace(number)
            found.append((worker.place, outcome))
            worker.place = None
        return found

    def _replace(self, number: int) -> None:
        self._workers[number].pipe.close()
        self._workers[number] = self._start()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        raised: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Let the idle go, and end the others."""
        for worker in self._workers:
            if worker.place is not None:
                worker.process.kill()
            worker.pipe.close()
        for worker in self._workers:
            worker.process.join(_GRACE_S)
            worker.process.kill()
            worker.process.join()

    def __enter__(self) -> Self:
        """Itself."""
        return self


def all_cores() -> int:
    """How many processes this machine runs side by side."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def pin_kernels(threads: int) -> None:
    """Let kernels called from this thread use so many threads, if numba has so many."""
    most: int = _NUMBA.NUMBA_NUM_THREADS
    numba.set_num_threads(max(1, min(threads, most)))


def _work(pipe: Any, threads: int) -> None:
    """A worker process: it flies what comes through the pipe until that ends.

    It has no ears for Ctrl-C; the first process has, and ends this one.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    warnings.simplefilter("ignore")
    pin_kernels(threads)
    while True:
        try:
            config = pipe.recv()
            pipe.send(fly_run(config))
        except (EOFError, OSError):
            return


def _ended(process: Any) -> Failure:
    """What to say of a process that ended in the middle of a run."""
    process.join(_GRACE_S)
    code = process.exitcode
    how = f"was killed (signal {-code})" if code is not None and code < 0 else f"ended ({code})"
    return Failure(
        f"the process that flew it {how}, most likely for want of memory; fewer "
        "--workers leave more for each"
    )
