"""NumPy archives of ours: read with every way in which they can be damaged."""

from __future__ import annotations

import struct
import tokenize
import zipfile
import zlib
from pathlib import Path

import numpy as np

from insonify.errors import InsonifyError, reason
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


def read_archive(
    path: Path, form: str, version: int, error: type[InsonifyError]
) -> dict[str, Array]:
    """The arrays of an ``.npz`` that names its format and version.

    Args:
        path: The file.
        form: What its array ``format`` must say, ``insonify-map`` for one.
        version: And its array ``version``.
        error: What is raised.

    Raises:
        InsonifyError: The file is missing, of another format or version, or damaged.
    """
    if not path.is_file():
        raise error(f"{path}: there is no such file; check the path")
    try:
        with path.open("rb") as file:
            if file.read(2) != b"PK":
                raise error(f"{path}: not an {form} file")
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            if str(archive["format"]) != form or int(archive["version"]) != version:
                raise error(
                    f"{path}: not a version {version} {form} file; write it again with this version"
                )
            return {name: archive[name] for name in archive.files}
    except DAMAGE as err:
        raise error(f"{path}: damaged, or not an {form} file ({reason(err)})") from err
