"""A map on disk that is flushed while it is made, so that the same command goes on after a kill."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from insonify.io.maps.ondisk import CHECKPOINT, TileStore
from insonify.mapping.mapper import Mapper
from insonify.mapping.voxels import VoxelMap
from insonify.results.map import MAP
from insonify.types import Array, FanGeometry, Float32, Float64, Ping, Pose

_LEAST_S, _SHARE = 20.0, 0.02
"""Between two flushes; what of the time they may take at most."""
_STATE = "state_"


class KeptMapper:
    """Hands pings to a mapper, and flushes its map now and then with how many it has had.

    Pings that a map was gone on with has had already are passed over.
    """

    def __init__(self, mapper: Mapper, store: TileStore) -> None:
        """Go on with what a store held at its last flush, if there was one.

        Args:
            mapper: With nothing mapped.
            store: The map's.
        """
        self.name, self._mapper, self._store = mapper.name, mapper, store
        self._had = 0
        arrays = store.resume()
        if arrays is not None:
            x, y, z = arrays["origin_m"].tolist()
            mapper.voxels.origin_m = x, y, z
            self._had = int(arrays["pings"])
            state = {
                name.removeprefix(_STATE): array
                for name, array in arrays.items()
                if name.startswith(_STATE)
            }
            if state:
                mapper.load(state)
        self._pings = 0
        self._flushed_s, self._wait_s = time.monotonic(), _LEAST_S

    @property
    def voxels(self) -> VoxelMap:
        """The mapper's."""
        return self._mapper.voxels

    @voxels.setter
    def voxels(self, voxels: VoxelMap) -> None:
        self._mapper.voxels = voxels

    def integrate(self, ping: Ping, pose: Pose) -> None:
        """Update the map with a ping that is not in it yet."""
        self._pings += 1
        if self._pings <= self._had:
            return
        self._mapper.integrate(ping, pose)
        begun_s = time.monotonic()
        if begun_s - self._flushed_s > self._wait_s:
            state = {f"{_STATE}{name}": array for name, array in self._mapper.save().items()}
            origin_m = np.array(self.voxels.origin_m)
            self._store.keep(pings=np.array(self._pings), origin_m=origin_m, **state)
            self._flushed_s = time.monotonic()
            self._wait_s = max(_LEAST_S, (self._flushed_s - begun_s) / _SHARE)

    def finish_scan(self) -> None:
        """As the mapper does, but for scans that were over at the last flush."""
        if self._pings >= self._had:  # it is flushed with a ping, before its scan is finished
            self._mapper.finish_scan()

    def tells(self, poses: Sequence[Pose], geometry: FanGeometry, voxels_m: Float64) -> Float32:
        """As the mapper does."""
        return self._mapper.tells(poses, geometry, voxels_m)

    def save(self) -> dict[str, Array]:
        """As the mapper does."""
        return self._mapper.save()

    def load(self, arrays: Mapping[str, Array]) -> None:
        """As the mapper does."""
        self._mapper.load(arrays)


def kept_pings(folder: Path) -> int:
    """How many pings are in what a process that was killed has left of a map, 0 if nothing is."""
    try:
        with np.load(folder / MAP / CHECKPOINT, allow_pickle=False) as arrays:
            return int(arrays["pings"])
    except (OSError, ValueError, KeyError):
        return 0
