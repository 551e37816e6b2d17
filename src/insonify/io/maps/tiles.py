"""Maps as Zarr (version 3): dense arrays over x, y and z in chunks of 64 x 64 x 64 voxels.

A chunk is a tile of 8 x 8 x 8 blocks; where nothing is mapped there is none.  ``coords`` lists the
blocks there are, so that a tile that is missing is noticed, and each chunk has a checksum.  Chunks
are written and read here as Zarr's codecs lay them out, which costs a tenth of what a call of the
library does; the rest of the group is written by the library.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any

import numpy as np

from insonify.errors import MapFileError, reason
from insonify.extras import optional
from insonify.io.maps.blocks import MOST_LOG_ODDS, check_memory, origin_of
from insonify.limits import LARGEST_VOXEL_M, LEAST_VOXEL_M
from insonify.mapping.store import TILE, block_keys
from insonify.mapping.voxels import (
    BLOCK,
    FARTHEST_BLOCK,
    IN_VIEW,
    OBSERVED,
    SURFACE,
    VOXELS_PER_BLOCK,
)
from insonify.types import Array, Float32, Int32, Int64

FORMAT, VERSION = "insonify-map", 3
BLOCKS_PER_TILE = TILE**3
EDGE = TILE * BLOCK
"""Voxels along the edge of a tile."""
FARTHEST_TILE = -(-FARTHEST_BLOCK // TILE)
DAMAGE = (
    OSError,
    ValueError,
    TypeError,
    LookupError,
    AttributeError,
    ArithmeticError,
    AssertionError,
    MemoryError,
    NotImplementedError,
    RuntimeError,
    ImportError,
)
"""What Zarr and its codecs raise on metadata and chunks with flipped or missing bytes."""
_ARRAYS: dict[str, np.dtype[Any]] = {"log_odds": np.dtype("<f4"), "seen": np.dtype("u1")}
_NAMES = {
    "log_odds": "occupancy as log-odds",
    "seen": "bits: 1 has been inside a fan, 2 echo or silence spoke about it, 4 surface",
}
_ROWS = 4096
"""Of ``coords`` in a chunk."""
_NOTHING = -(2**31)
"""What stands in for a missing chunk of ``coords``: no valid value."""
_LEVEL = 1
_PLACE = np.arange(BLOCKS_PER_TILE)
_IN_TILE = (_PLACE // TILE**2, _PLACE // TILE % TILE, _PLACE % TILE)


def zarr_package(what: str) -> Any:
    """The package zarr.

    Raises:
        MissingExtraError: It is not installed.
    """
    return optional("zarr", "maps", what)


def places_of(coords: Int32) -> tuple[Int32, Int64]:
    """The tiles (N, 3) of blocks (N, 3), and their places (N,) in these."""
    x, y, z = (coords & (TILE - 1)).T.astype(np.int64)
    return coords // TILE, (x * TILE + y) * TILE + z


def blocks_of(tile: Int32, places: Int64) -> Int32:
    """The blocks (N, 3) at some places (N,) of a tile (3,)."""
    within = np.column_stack([axis[places] for axis in _IN_TILE])
    return (tile * TILE + within).astype(np.int32)


class TileFiles:
    """The chunks of a group, each written and read whole.

    A chunk that is written is pending, beside the one there was, until `commit` puts all of them
    in place: after a kill and `recover` the group is as it was at the last commit.
    """

    def __init__(
        self, folder: Path, first: Iterable[int] = (-FARTHEST_TILE,) * 3, name: str = "commit"
    ) -> None:
        """Chunks of a folder, there or not.

        Args:
            folder: The group.
            first: The tile of chunk 0, 0, 0.
            name: Of whoever writes, if there are others that write other tiles.
        """
        zarr_package("a .zarr map")
        import google_crc32c
        from numcodecs.zstd import Zstd  # type: ignore[import-untyped]

        self.folder, self.first = folder, np.array(list(first), np.int64)
        self._commit = folder / f"{name}.txt"
        self._crc, self._zstd = google_crc32c.value, Zstd(level=_LEVEL)
        self._pool = ThreadPoolExecutor(2)  # the codec works outside of Python's lock
        self._pending: set[tuple[int, ...]] = set()

    def write(self, tiles: Iterable[tuple[Int32, Float32, Array]]) -> None:
        """Write tiles: the index (3,), log-odds and seen (512 blocks, 512) of each."""
        written = [self._pool.submit(self._write_one, tile) for tile in tiles]
        wait(written)  # also where one fails: nobody writes any more when its error is told
        self._pending.update(one.result() for one in written)

    def _write_one(self, told: tuple[Int32, Float32, Array]) -> tuple[int, ...]:
        tile, log_odds, seen = told
        key = self._key(tile)
        for name, rows in (("log_odds", log_odds), ("seen", seen)):
            dense = np.zeros((EDGE,) * 3, _ARRAYS[name])
            split = dense.reshape(TILE, BLOCK, TILE, BLOCK, TILE, BLOCK)
            x, y, z = _IN_TILE
            split[x, :, y, :, z, :] = rows.reshape(-1, BLOCK, BLOCK, BLOCK)
            packed = bytes(self._zstd.encode(dense))
            path = Path(f"{self._path(name, key)}.new")
            checked = packed + self._crc(packed).to_bytes(4, "little")
            try:
                path.write_bytes(checked)
            except FileNotFoundError:
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(checked)
        return key

    def read(self, tile: Int32) -> tuple[Float32, Array]:
        """Log-odds and seen (512 blocks, 512) of a tile.

        Raises:
            MapFileError: A chunk is missing or damaged.
        """
        key = self._key(tile)
        return self._read_one("log_odds", key), self._read_one("seen", key)

    def _read_one(self, name: str, key: tuple[int, ...]) -> Array:
        path = self._path(name, key)
        if key in self._pending:
            path = Path(f"{path}.new")
        kind = _ARRAYS[name]
        try:
            content = path.read_bytes()
            packed, check = content[:-4], content[-4:]
            if self._crc(packed).to_bytes(4, "little") != check:
                raise MapFileError(f"{path}: damaged, its checksum is another")
            dense = np.empty((EDGE,) * 3, kind)
            self._zstd.decode(packed, dense)
        except FileNotFoundError as err:
            raise MapFileError(f"{path}: is missing, and the map lists blocks in it") from err
        except DAMAGE as err:
            raise MapFileError(f"{path}: damaged ({reason(err)})") from err
        _check_values(path, dense)
        split = dense.reshape(TILE, BLOCK, TILE, BLOCK, TILE, BLOCK)
        rows: Array = split.transpose(0, 2, 4, 1, 3, 5).reshape(BLOCKS_PER_TILE, VOXELS_PER_BLOCK)
        return rows

    def commit(self, also: Iterable[str] = ()) -> None:
        """Put what is pending in place, all of it or, after a kill and `recover`, none.

        Args:
            also: Other files of the folder that lie beside their places too, with ``.new``.
        """
        paths = [self._path(name, key) for key in sorted(self._pending) for name in _ARRAYS]
        listed = [str(path.relative_to(self.folder)) for path in paths] + list(also)
        part = self._commit.with_suffix(".part")
        part.write_text("".join(f"{name}\n" for name in listed), encoding="utf-8")
        os.sync()  # with the disk, before what was there goes
        part.replace(self._commit)
        self._finish()
        self._pending.clear()

    def clear(self) -> None:
        """Remove all that is in the folder."""
        shutil.rmtree(self.folder)
        self.folder.mkdir()

    def recover(self) -> None:
        """Do what is left of a commit that was begun; remove what was never committed."""
        self._finish()
        self._commit.with_suffix(".part").unlink(missing_ok=True)
        for path in self.folder.rglob("*.new"):
            path.unlink()

    def _finish(self) -> None:
        if not self._commit.is_file():
            return
        for line in self._commit.read_text(encoding="utf-8").splitlines():
            fresh = self.folder / f"{line}.new"
            if fresh.is_file():  # those moved before a kill are there already
                fresh.replace(self.folder / line)
        self._commit.unlink()

    def settle(self, tiles: Int32) -> None:
        """Let the chunks begin at 0, 0, 0 with the least of tiles (N, 3), which are all there are.

        To be called with nothing pending.
        """
        least = tiles.min(axis=0).astype(np.int64) if len(tiles) else np.zeros(3, np.int64)
        places = [(self._key(tile), tuple((tile - least).tolist())) for tile in tiles]
        for name in _ARRAYS:
            (self.folder / name).mkdir(exist_ok=True)
            settled = self.folder / name / "settled"
            for old, new in places:
                path = settled.joinpath(*map(str, new))
                path.parent.mkdir(parents=True, exist_ok=True)
                self._path(name, old).replace(path)
            _remove_empty(self.folder / name / "c")
            if settled.is_dir():
                settled.replace(self.folder / name / "c")
        self.first = least

    def _key(self, tile: Int32) -> tuple[int, ...]:
        return tuple((tile - self.first).tolist())

    def _path(self, name: str, key: tuple[int, ...]) -> Path:
        return self.folder.joinpath(name, "c", *map(str, key))


def _remove_empty(folder: Path) -> None:
    """Remove a folder that holds but folders."""
    for path, _, _ in os.walk(folder, topdown=False):
        Path(path).rmdir()


def _check_values(path: Path, values: Array) -> None:
    """Refuse values that no map has.

    Raises:
        MapFileError: They are.
    """
    if values.dtype == np.uint8:
        if (values > (IN_VIEW | OBSERVED | SURFACE)).any():
            raise MapFileError(f"{path}: damaged, what it holds makes no sense")
    elif not (np.abs(values) <= MOST_LOG_ODDS).all():
        raise MapFileError(f"{path}: damaged, it holds log-odds beyond {MOST_LOG_ODDS:g}")


def describe(
    folder: Path,
    coords: Int32,
    first: Int64,
    voxel_m: float,
    origin_m: tuple[float, float, float],
    bits: int,
) -> None:
    """Write what makes chunks a Zarr group.

    Args:
        folder: The group, with its chunks.
        coords: The blocks (N, 3), by tile.
        first: The tile of chunk 0, 0, 0.
        voxel_m: Edge length of a voxel.
        origin_m: Where the map's own frame lies in the world.
        bits: All that any voxel was seen as.
    """
    zarr = zarr_package("a .zarr map")
    across = coords.max(axis=0) // TILE - first + 1 if len(coords) else np.zeros(3, np.int64)
    about = {
        "format": FORMAT,
        "version": VERSION,
        "voxel_m": voxel_m,
        "first_voxel": (first * EDGE).tolist(),
        "seen_as": bits,
    }
    if any(origin_m):
        about["origin_m"] = list(origin_m)
    group = zarr.open_group(folder, mode="a", zarr_format=3, attributes=about)
    codecs = [zarr.codecs.ZstdCodec(level=_LEVEL), zarr.codecs.Crc32cCodec()]
    for name, kind in _ARRAYS.items():
        group.create_array(
            name, shape=tuple((across * EDGE).tolist()), chunks=(EDGE,) * 3, dtype=kind,
            fill_value=0, compressors=codecs, dimension_names=("x", "y", "z"),
            attributes={"long_name": _NAMES[name]},
        )  # fmt: skip
    arrays: dict[str, Any] = {"coords": (coords, _ROWS, _NOTHING, {})}
    for axis, name in enumerate("xyz"):
        index = np.arange(across[axis] * EDGE) + first[axis] * EDGE
        centres_m = (index + 0.5) * voxel_m + origin_m[axis]
        arrays[name] = (centres_m, max(1, len(index)), 0, {"units": "m"})
    for name, (values, rows, nothing, attributes) in arrays.items():
        array = group.create_array(
            name, shape=values.shape, chunks=(rows, *values.shape[1:]), dtype=values.dtype,
            fill_value=nothing, compressors=codecs, attributes=attributes,
            dimension_names=("block", "axis") if name == "coords" else (name,),
        )  # fmt: skip
        if len(values):
            array[:] = values


class About:
    """What a group says of its map."""

    def __init__(self, path: Path) -> None:
        """Read it.

        Raises:
            MapFileError: It is no such group, or is damaged.
        """
        zarr = zarr_package("a .zarr map")
        try:
            group = zarr.open_group(path, mode="r", zarr_format=3)
            self.version = int(group.attrs["version"])
            if group.attrs["format"] != FORMAT or self.version not in (2, VERSION):
                raise MapFileError(f"{path}: not an insonify map of version 2 or {VERSION}")
            self.group = group
            self.voxel_m = float(group.attrs["voxel_m"])
            told = group.attrs.get("origin_m", (0.0, 0.0, 0.0))
            if self.version == VERSION:
                self.bits = int(group.attrs["seen_as"])
                first = np.array(group.attrs["first_voxel"], np.int64)
                self.first = first.reshape(3) // EDGE
                self._check_layout(path, group)
        except DAMAGE as err:
            raise MapFileError(f"{path}: damaged, or not an insonify map ({_said(err)})") from err
        if not LEAST_VOXEL_M <= self.voxel_m <= LARGEST_VOXEL_M:
            raise MapFileError(f"{path}: damaged, a resolution of {self.voxel_m:g} m")
        self.origin_m = origin_of(path, told)

    def coords(self, path: Path) -> Int32:
        """The blocks (N, 3).

        Raises:
            MapFileError: They make no sense.
        """
        listed = self.group["coords"]
        check_memory(path, listed.shape[0] // 200)  # a block's coordinates are 1/200 of the block
        try:
            coords: Int32 = listed[:]
        except DAMAGE as err:
            raise MapFileError(f"{path}: damaged, or not an insonify map ({_said(err)})") from err
        far = len(coords) and int(np.abs(coords.astype(np.int64)).max()) >= FARTHEST_BLOCK
        alone = len(np.unique(block_keys(coords))) == len(coords)
        if far or not alone or (coords // TILE < self.first).any():
            raise MapFileError(f"{path}: damaged, its blocks make no sense")
        return coords

    @staticmethod
    def _check_layout(path: Path, group: Any) -> None:
        for name, kind in _ARRAYS.items():
            array = group[name]
            if (array.chunks, array.dtype, array.ndim) != ((EDGE,) * 3, kind, 3):
                raise MapFileError(f"{path}: damaged, {name} is laid out as {array}")
        coords = group["coords"]
        layout = (coords.chunks, coords.dtype, coords.shape[1:])
        if layout != ((_ROWS, 3), np.dtype(np.int32), (3,)):
            raise MapFileError(f"{path}: damaged, coords is laid out as {layout}")
        if coords.shape[0] > (2 * FARTHEST_BLOCK) ** 2:
            raise MapFileError(f"{path}: damaged, it announces {coords.shape[0]} blocks")


def _said(err: BaseException) -> str:
    return f"{' '.join(str(err).split()):.200}"
