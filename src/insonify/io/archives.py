"""NumPy archives of ours: read with every way in which they can be damaged."""

from __future__ import annotations

import math
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Container, Iterator, Mapping
from pathlib import Path

import numpy as np

from insonify import memory
from insonify.errors import InsonifyError, reading, reason
from insonify.types import Array

DAMAGE = (
    OSError,
    ValueError,
    KeyError,
    TypeError,
    EOFError,
    OverflowError,
    MemoryError,
    NotImplementedError,
    RuntimeError,
    SyntaxError,
    struct.error,
    tokenize.TokenError,
    zlib.error,
    zipfile.BadZipFile,
)
"""What NumPy's and Python's readers raise on archives with flipped or missing bytes."""


class Archive(Mapping[str, Array]):
    """The arrays of an archive, each read when it is asked for: what nobody knows is never read."""

    def __init__(self, path: Path, error: type[InsonifyError]) -> None:
        """Look what there is.

        Args:
            path: The file.
            error: What is raised.

        Raises:
            InsonifyError: The file is missing or damaged.
        """
        self._path, self._error, self._read = path, error, dict[str, Array]()
        with reading(path, "a NumPy archive", error, *DAMAGE), zipfile.ZipFile(path) as archive:
            self._names = [name.removesuffix(".npy") for name in archive.namelist()]

    def __getitem__(self, name: str) -> Array:
        """An array.

        Raises:
            KeyError: There is none of the name.
            InsonifyError: It is damaged, or larger than what holds it or than memory.
        """
        if name not in self._names:
            raise KeyError(name)
        if name not in self._read:
            check_sizes(self._path, {name}, self._error)
            what = f"an archive with the array {name!r:.40}"
            with (
                reading(self._path, what, self._error, *DAMAGE),
                np.load(self._path, allow_pickle=False) as archive,
            ):
                self._read[name] = archive[name]
        return self._read[name]

    def __contains__(self, name: object) -> bool:
        """Whether it is there; it is not read."""
        return name in self._names

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


def check_sizes(path: Path, names: Container[str], error: type[InsonifyError]) -> None:
    """Refuse arrays that are larger than their archive can honestly hold, before they are made.

    Args:
        path: The archive.
        names: Arrays that will be read.
        error: What is raised.

    Raises:
        InsonifyError: An array is larger than the bytes that hold it, or than memory.
    """
    with reading(path, "a NumPy archive", error, *DAMAGE), zipfile.ZipFile(path) as archive:
        total = sum(
            _honest_bytes(path, archive, entry, error)
            for entry in archive.infolist()
            if entry.filename.removesuffix(".npy") in names
        )
    if not memory.fits(2.0 * total):
        raise error(f"{path}: its arrays need {memory.shortage(2.0 * total)}; split it")


def _honest_bytes(
    path: Path, archive: zipfile.ZipFile, entry: zipfile.ZipInfo, error: type[InsonifyError]
) -> int:
    """What an array needs, which the bytes that hold it must be enough for."""
    name = entry.filename.removesuffix(".npy")
    with archive.open(entry) as stream:
        version = np.lib.format.read_magic(stream)
        read_header = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }.get(version)
        if read_header is None:
            raise ValueError(f"array {name} is of version {version}")
        shape, _, kind = read_header(stream)
    needed = math.prod(shape) * kind.itemsize
    if not 0 <= needed <= entry.file_size:
        raise error(
            f"{path}: damaged, array {name} of shape {shape} does not fit into the "
            f"{entry.file_size} bytes that hold it"
        )
    if entry.file_size > 1100 * entry.compress_size + 4096:  # deflate's limit is 1032
        raise error(f"{path}: damaged, array {name} is a false size")
    return needed


def read_archive(path: Path, form: str, version: int, error: type[InsonifyError]) -> Archive:
    """The arrays of an ``.npz`` that names its format and version.

    Args:
        path: The file.
        form: What its array ``format`` must say, ``insonify-map`` for one.
        version: And its array ``version``.
        error: What is raised, also when an array is asked for that is damaged.

    Raises:
        InsonifyError: The file is missing, of another format or version, or damaged.
    """
    if not path.is_file():
        raise error(f"{path}: there is no such file; check the path")
    with reading(path, "file", error), path.open("rb") as file:
        if file.read(2) != b"PK":
            raise error(f"{path}: not an {form} file")
    arrays = Archive(path, error)
    try:
        known = (str(arrays["format"]), int(arrays["version"])) == (form, version)
    except DAMAGE as err:
        raise error(f"{path}: damaged, or not an {form} file ({reason(err)})") from err
    if not known:
        raise error(
            f"{path}: not a version {version} {form} file; write it again with this version"
        )
    return arrays
