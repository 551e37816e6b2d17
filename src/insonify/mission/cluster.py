"""The workers of a Dask cluster as a crew: they fly runs, or do other work of ours."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from functools import cache
from typing import Any, Self

from insonify import __version__
from insonify.errors import ClusterError, InsonifyError, reason
from insonify.extras import optional
from insonify.jit import kernels_digest
from insonify.mission.crew import Crew, Failure, Place, fly_run, pin_kernels

Work = Callable[[Any], Any]
_ANSWER_S = 10
_MOMENT_S = 0.5
_ONE_AT_A_TIME = threading.Lock()
"""Kernels that run on several threads may not be called from several threads."""


class Cluster(Crew):
    """A Dask cluster that runs already.

    A worker of its flies one run at a time, and its kernels use as many threads as the worker has.

    Attributes:
        threads: Of all workers.
    """

    def __init__(
        self, address: str, work: Work = fly_run, what: str = "a campaign on a cluster"
    ) -> None:
        """Call the scheduler.

        Args:
            address: As in ``tcp://10.0.0.1:8786``, or ``host:port``.
            work: What a worker does with what it is given, a function of a module.
            what: That in words, for messages.

        Raises:
            ClusterError: Nothing answers there, or a worker has another insonify.
            MissingExtraError: Dask is not installed.
        """
        self._dask: Any = optional("distributed", "cluster", what)
        for name in ("distributed.client", "distributed.core", "distributed.comm"):
            logging.getLogger(name).setLevel(logging.CRITICAL)  # we say it in a sentence
        self._address, self._work = address, work
        self._flying: dict[Any, Place] = {}
        try:
            self._client = self._dask.Client(address, timeout=_ANSWER_S, set_as_default=False)
        except (OSError, TimeoutError, ValueError, RuntimeError) as err:
            raise ClusterError(
                f"--scheduler {address}: no Dask scheduler answers there ({reason(err)}); check "
                "the address, and that the same versions of Dask are installed on both sides"
            ) from err
        try:
            self._check_workers()
        except BaseException:
            self._client.close()
            raise

    def _check_workers(self) -> None:
        """Refuse workers that would make something else, before the first run."""
        self.threads: int = sum(self._client.nthreads().values())
        answers = self._client.run(own_version, on_error="return")
        for worker, answer in answers.items():
            if answer != own_version():
                raise ClusterError(_other(self._address, worker, answer))

    def room(self) -> int:
        """Two for each thread there is, so that none waits for work."""
        return max(2, 2 * self.threads) - len(self._flying)

    def take(self, place: Place, config: Any) -> None:
        """Send a run, or what else the work is done with, to the scheduler."""
        future = self._client.submit(do_on_worker, self._work, config, own_version(), pure=False)
        self._flying[future] = place

    def landed(self) -> list[tuple[Place, Any]]:
        """What came back; a run whose worker died again and again has failed.

        Raises:
            ClusterError: The scheduler is gone, or a worker has another insonify.
        """
        try:
            with self._client.as_current():
                self._dask.wait(list(self._flying), _MOMENT_S, return_when="FIRST_COMPLETED")
        except (TimeoutError, self._dask.TimeoutError):
            pass
        except (self._dask.CancelledError, OSError) as err:
            raise self._lost() from err
        if self._client.status != "running":
            raise self._lost()
        try:
            self.threads = sum(self._client.nthreads().values())  # workers come and go
        except OSError as err:
            raise self._lost() from err
        over = [future for future in self._flying if future.done()]
        return [(self._flying.pop(future), self._outcome(future)) for future in over]

    def _outcome(self, future: Any) -> Any:
        if future.status == "finished":
            return future.result()
        if future.status != "error":
            raise self._lost()
        err = future.exception()
        if isinstance(err, InsonifyError):
            raise err
        if isinstance(err, ModuleNotFoundError):
            raise ClusterError(_other(self._address, "a worker", err))
        if type(err).__name__ == "KilledWorker":
            return Failure(
                "the workers that had it died, one after another, most likely for want of memory; "
                "give them more, or fewer threads"
            )
        return Failure(f"{type(err).__name__}: {reason(err)}")

    def _lost(self) -> ClusterError:
        return ClusterError(
            f"--scheduler {self._address}: the connection was lost; what is complete is kept, and "
            "the same command goes on from there"
        )

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(self, *raised: object) -> None:
        """Call off what is not complete; the cluster stays."""
        if self._client.status == "running":
            self._client.cancel(list(self._flying))
        self._client.close()


@cache
def own_version() -> str:
    """What must be the same on both sides: insonify's version, and its kernels."""
    return f"{__version__}, kernels {kernels_digest()}"


def do_on_worker(work: Work, config: Any, version: str) -> Any:
    """On a worker: the work, unless something else would come of it than was asked for."""
    if own_version() != version:
        raise ClusterError(_other("", "a worker", own_version(), version))
    with _ONE_AT_A_TIME:
        from distributed import get_worker

        pin_kernels(get_worker().state.nthreads)
        return work(config)


def _other(address: str, worker: str, has: object, here: str | None = None) -> str:
    what = f"no insonify ({reason(has)})" if isinstance(has, BaseException) else f"insonify {has}"
    where = f"--scheduler {address}: " if address else ""
    return (
        f"{where}{worker} has {what}, and here is insonify {here or own_version()}; install the "
        "same version for all"
    )
