"""Typed doors to numba, so that kernels keep their signatures under ``mypy --strict``.

Kernels are compiled once and cached on disk.  The cache notices a change of the kernel's own file
only, so a kernel calls no kernel of another file (``tests/test_layers.py`` checks it).
``parallel_kernel`` spreads ``prange`` over all cores; every kernel in the project writes each
output from one iteration only, so the number of threads never changes a result.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import numba

P = ParamSpec("P")
R = TypeVar("R")

prange = numba.prange


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a serial kernel or a device function called from other kernels."""
    return _compile(function, parallel=False)


def parallel_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a kernel whose ``prange`` loops run on all cores."""
    return _compile(function, parallel=True)


def _compile(function: Callable[P, R], parallel: bool) -> Callable[P, R]:
    options: dict[str, Any] = {"error_model": "numpy", "nogil": True, "parallel": parallel}
    compiled: Callable[P, R]
    try:
        compiled = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # neither the sources' folder nor a home can be written: compile each time
        compiled = numba.njit(**options)(function)
    return compiled
