"""Result folders: everything appears at once, and nothing that exists is overwritten unasked."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from insonify.errors import OutputError

RESULT = "result.json"
PARTS = (
    "map.npz",
    "map.ply",
    "mapper.npz",
    "entropy.npz",
    "decisions.npz",
    "truth.npz",
    "trajectory.csv",
    "recording.mcap",
    "foxglove.json",
    "report.html",
)
"""Files that are read back, or looked at, as parts of the result they lie with."""

BESIDE = ".origin.json"
"""Ends the name of the file that tells a map's origin where its format cannot."""


@dataclass(slots=True)
class ResultFolder:
    """Where a result is written, and where it goes.

    Attributes:
        scratch: Write here.
        target: The folder it becomes; after the block, the one it became.
    """

    scratch: Path
    target: Path


@contextmanager
def result_folder(target: Path, *, force: bool = False) -> Iterator[ResultFolder]:
    """A scratch folder beside ``target`` that takes its name when the block ends well.

    It is made at once, so that a folder that cannot be written is known before any work is done.
    If the block raises, nothing is left behind.  A block that writes nothing, or moves the scratch
    folder away, leaves no folder.
    With ``force``, the new files replace those of the same name, and `PARTS` of the earlier result
    that the new one does not have go with it; other files in the folder stay.
    If another process has made ``target`` meanwhile, the result takes the next free name.

    Raises:
        OutputError: ``target`` exists and ``force`` is not given, or it cannot be written.
    """
    if os.path.lexists(target) and not (force and target.is_dir()):  # a link to nowhere counts
        kind = "already exists" if target.is_dir() else "is a file, not a folder"
        raise OutputError(
            f"{target}: {kind}; give another --out"
            + (", or --force to replace the results in it" if target.is_dir() else "")
        )
    made = [parent for parent in target.parents if not os.path.lexists(parent)]
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
    except OSError as err:
        _remove_empty(made)
        raise OutputError(
            f"{target}: cannot be written ({_reason(err)}); give another --out"
        ) from err
    place = ResultFolder(scratch, target)
    try:
        yield place
        place.target = _publish(scratch, target, force)
    except OSError as err:
        if not _is_about(err, scratch, target):
            raise
        raise OutputError(
            f"{target}: the results cannot be written ({_reason(err)}); nothing was kept"
        ) from err
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
        _remove_empty(made)


def write_file(path: Path, data: bytes) -> None:
    """Write a file that appears whole or not at all, in the place of one of its name.

    Raises:
        OutputError: It cannot be written.
    """
    scratch = path.with_name(f".{path.name}.part")
    try:
        scratch.write_bytes(data)
        scratch.replace(path)
    except OSError as err:
        with suppress(OSError):
            scratch.unlink()
        raise OutputError(f"{path}: cannot be written ({_reason(err)})") from err


@contextmanager
def result_file(target: Path, *, force: bool = False) -> Iterator[Path]:
    """A scratch path of the same name that becomes ``target`` when the block ends well.

    It may be made a file or, for formats that are folders, a folder.  With ``force`` a file, or a
    folder of the same format (a Zarr group), is replaced.  A file that tells the origin of a map
    (`insonify.io.maps.sidecar`) belongs to it.

    Raises:
        OutputError: ``target`` exists and may not be replaced, or it cannot be written.
    """
    beside = f"{target.name}{BESIDE}"
    exists = os.path.lexists(target) or (target.parent / beside).is_file()
    if exists and not force:
        raise OutputError(f"{target}: already exists; give another name, or --force to replace it")
    if target.is_dir() and not (target / "zarr.json").is_file():
        raise OutputError(f"{target}: is a folder; give the name of a file")
    try:
        scratch = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
    except OSError as err:
        raise OutputError(
            f"{target}: cannot be written ({_reason(err)}); give another place"
        ) from err
    try:
        yield scratch / target.name
        if target.is_dir() and not target.is_symlink():
            target.rename(scratch / f"{target.name}.replaced")
        told = (scratch / beside).is_file()
        if told:  # first, so that a file never lies there without it
            (scratch / beside).replace(target.parent / beside)
        (scratch / target.name).replace(target)
        if not told:
            (target.parent / beside).unlink(missing_ok=True)
    except OSError as err:
        if not _is_about(err, scratch, target):
            raise
        raise OutputError(f"{target}: cannot be written ({_reason(err)})") from err
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _remove_empty(folders: list[Path]) -> None:
    """Remove those of some folders, the deepest first, that hold nothing."""
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()


def unused_folder(wanted: Path) -> Path:
    """``wanted``, or the first of ``wanted-2``, ``wanted-3`` ... that does not exist."""
    folder, number = wanted, 1
    while os.path.lexists(folder):
        number += 1
        folder = wanted.with_name(f"{wanted.name}-{number}")
    return folder


def _publish(scratch: Path, target: Path, force: bool) -> Path:
    """Give a finished result its name; returns the one it got."""
    files = sorted(scratch.iterdir()) if scratch.is_dir() else []  # the block may have moved it
    if not files:
        return target
    if force and target.is_dir():
        names = {file.name for file in files}
        for file in files:
            if (target / file.name).is_dir() and not file.is_dir():
                raise OSError(errno.EISDIR, f"{file.name} is a folder there")
        for file in files:
            if (target / file.name).is_dir():
                (target / file.name).rename(scratch / f"{file.name}.replaced")
            file.replace(target / file.name)
        if RESULT in names:
            for part in PARTS:
                if part not in names and (target / part).is_file():
                    (target / part).unlink()
        return target
    scratch.chmod(0o777 & ~_umask())
    while True:
        free = unused_folder(target)
        try:
            scratch.rename(free)
            return free
        except OSError:
            if not os.path.lexists(free):
                raise


def _is_about(err: OSError, *places: Path) -> bool:
    """Whether an error is one of writing there, and not of something else that a job does."""
    if err.errno is None:
        return False
    if not isinstance(err.filename, str | os.PathLike):
        return True  # a write to a file that was open
    path = Path(err.filename).absolute()
    return any(path.is_relative_to(place.absolute()) for place in places)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _reason(err: OSError) -> str:
    return (err.strerror or str(err)).lower()
