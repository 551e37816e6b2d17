"""Typed doors to numba, so that kernels keep their signatures under ``mypy --strict``.

Kernels are compiled once and cached on disk.  The cache notices a change of the kernel's own file
only, so a kernel calls no kernel of another file (``tests/test_layers.py`` checks it).
``parallel_kernel`` spreads ``prange`` over all cores; every kernel in the project writes each
output from one iteration only, so the number of threads never changes a result.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar

import numba

P = ParamSpec("P")
R = TypeVar("R")

prange = numba.prange


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a serial kernel or a device function called from other kernels."""
    compiled: Callable[P, R] = numba.njit(cache=True, error_model="numpy", nogil=True)(function)
    return compiled


def parallel_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a kernel whose ``prange`` loops run on all cores."""
    compiled: Callable[P, R] = numba.njit(
        cache=True, error_model="numpy", nogil=True, parallel=True
    )(function)
    return compiled
