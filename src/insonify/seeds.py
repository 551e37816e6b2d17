"""Streams of random numbers: each use of a seed draws from a stream of its own."""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Stream(IntEnum):
    """What random numbers are drawn for; the numbers are part of what a seed means."""

    SEABED = 1
    NOISE = 2
    VEHICLE = 3
    DATASET_POSES = 4
    DATASET_NOISE = 5
    PLACE = 6
    FIELD = 7
    POSES = 8
    DATASET_SPLIT = 9


def generator(seed: int, stream: Stream, *number: int) -> np.random.Generator:
    """The generator of a stream of a seed, or of one numbered thing in it."""
    return np.random.default_rng([seed, int(stream), *number])
