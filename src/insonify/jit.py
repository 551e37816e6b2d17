"""Typed doors to numba, so that kernels keep their signatures under ``mypy --strict``.

Kernels are compiled once and cached on disk.  The cache's folder is named after a digest of all
files that have kernels, so that a change of any of them compiles all anew: a kernel may call those
of other files.  ``parallel_kernel`` spreads ``prange`` over all cores; every kernel in the project
writes each output from one iteration only, so the number of threads never changes a result.
"""

from __future__ import annotations

import hashlib
import logging
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numba
from numba.core import config, event

P = ParamSpec("P")
R = TypeVar("R")

prange = numba.prange
KERNELS: list[Any] = []
"""All that are known so far: those of the modules that were imported."""

_log = logging.getLogger(__name__)
_PACKAGE = Path(__file__).parent
_CONSTANTS = ("mapping/store.py", "mapping/voxels.py", "mapping/extracts.py", "vehicle/model.py")
"""Files without kernels whose constants kernels take."""
_PREFIX = "kernels-"
_KEPT_S = 7 * 24 * 3600.0
_CONFIG: Any = config


def _load_patient_threads() -> None:
    """Load GNU OpenMP so that a thread that waits for others soon sleeps, unless the user said how.

    By default it spins for milliseconds.  Where another program holds a core, that keeps off it the
    very thread that is waited for, and each parallel kernel takes a time slice of the system: a
    ping took 50 ms in place of 2.  Not to spin at all takes a third longer where nothing else runs.
    The setting is read when the library is loaded, so it is set for that only.
    """
    if {"OMP_WAIT_POLICY", "GOMP_SPINCOUNT"} & set(os.environ):
        return
    os.environ["GOMP_SPINCOUNT"] = "1000"
    try:
        with suppress(ImportError):  # there are other threads where this library is not
            import_module("numba.np.ufunc.omppool")
    finally:
        del os.environ["GOMP_SPINCOUNT"]


_load_patient_threads()
if "NUMBA_THREADING_LAYER_PRIORITY" not in os.environ:
    # by TBB, which it takes first where that is installed, numba 0.68 leaks 7 kB a parallel call
    _CONFIG.THREADING_LAYER_PRIORITY = ["omp", "tbb", "workqueue"]


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a serial kernel or a device function called from other kernels."""
    return _compile(function, parallel=False)


def parallel_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a kernel whose ``prange`` loops run on all cores."""
    return _compile(function, parallel=True)


@cache
def cache_folder() -> Path | None:
    """Where compiled kernels are kept; None if nothing can be written, so that nothing is kept.

    That is beside the sources, or else in ``NUMBA_CACHE_DIR`` or the user's own cache.
    """
    name = _PREFIX + kernels_digest()
    given = os.environ.get("NUMBA_CACHE_DIR")
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # noqa: PTH111
    places = [Path(given)] if given else [_PACKAGE / "__pycache__", Path(home) / "insonify"]
    for place in places:
        with suppress(OSError):
            (place / name).mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=place / name):
                pass
            _forget_others(place, name)
            return place / name
    _log.warning(
        "no folder can be written for compiled kernels; each start compiles them anew, slowly"
    )
    return None


def kernels_digest() -> str:
    """A digest of all that compiled code depends on: its sources and numba's version."""
    digest = hashlib.sha256(numba.__version__.encode())
    for path in kernel_sources():
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def kernel_sources() -> list[Path]:
    """All files of the package that have kernels, or constants that are compiled into them."""
    named = {Path(__file__), *(_PACKAGE / name for name in _CONSTANTS)}
    return [
        path
        for path in sorted(_PACKAGE.rglob("*.py"))
        if path in named or b"insonify.jit import" in path.read_bytes()
    ]


def _forget_others(place: Path, name: str) -> None:
    """Remove the kernels of other versions of the sources, unless they may still be in use."""
    os.utime(place / name)
    for folder in place.glob(f"{_PREFIX}*"):
        with suppress(OSError):
            if time.time() - folder.stat().st_mtime > _KEPT_S:
                shutil.rmtree(folder, ignore_errors=True)


def _compile(function: Callable[P, R], parallel: bool) -> Callable[P, R]:
    folder = cache_folder()
    before = _CONFIG.CACHE_DIR
    _CONFIG.CACHE_DIR = "" if folder is None else str(folder)
    try:
        compiled: Callable[P, R] = numba.njit(
            cache=folder is not None, error_model="numpy", nogil=True, parallel=parallel
        )(function)
    finally:
        _CONFIG.CACHE_DIR = before
    KERNELS.append(compiled)
    return compiled


class _Announcer(event.Listener):
    """Says in the log which kernel is being compiled; one that is loaded is not."""

    def on_start(self, event: Any) -> None:
        """One begins; those that it calls come inside it."""
        kernel = event.data["dispatcher"]
        if any(kernel is ours for ours in KERNELS):
            _log.info("compiling %s", kernel.__name__)

    def on_end(self, event: Any) -> None:
        """One is done."""


event.register("numba:compile", _Announcer())  # type: ignore[no-untyped-call]
