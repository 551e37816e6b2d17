"""Results on the disk: each appears at once, and nothing that exists is overwritten unasked.

A result that replaces another changes places with it in one step of the kernel, so that a process
that is killed leaves the old one or the new one, and never some of both.
"""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
import stat
from collections.abc import Callable, Container, Generator, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from insonify.errors import OutputError
from insonify.io import scratch as scratches
from insonify.io.beside import BESIDE, finish_beside, replace_beside
from insonify.io.scratch import Scratch

RESULT = "result.json"
PARTS = (
    "map.npz",
    "map.zarr",
    "map.ply",
    "mapper.npz",
    "entropy.npz",
    "decisions.npz",
    "truth.npz",
    "trajectory.csv",
    "recording.mcap",
    "recordings",
    "live.json",
    "foxglove.json",
    "report.html",
)
"""Files that are read back, or looked at, as parts of the result they lie with."""

DATASET = "dataset.zarr"
DATASET_PARTS = (
    "LICENSE",
    "annotations-test.json",
    "annotations-train.json",
    "annotations-val.json",
    "data.yaml",
    "labels",
    "pings.mcap",
    "shards",
    "statistics.png",
    "test.txt",
    "train.txt",
    "val.txt",
)
"""Of a dataset that replaces another: names so common that elsewhere they are the user's."""

_HERE, _EXCHANGE = -100, 2
"""AT_FDCWD of fcntl.h and RENAME_EXCHANGE of Linux's fs.h."""
_CANNOT_EXCHANGE = (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP, errno.EXDEV)


@dataclass(slots=True)
class ResultFolder:
    """Where a result is written, and where it goes.

    Attributes:
        scratch: Write here.
        target: The folder it becomes; after the block, the one it became.
        before: What a process that died left of the same job; gone when the result is whole.
        kept: Set it for the same job to go on with what is in ``scratch`` if the block fails, or
            moves on without a result.
    """

    scratch: Path
    target: Path
    before: Path | None = None
    kept: bool = False


@contextmanager
def result_folder(
    target: Path,
    *,
    force: bool = False,
    job: str = "",
    progress: Callable[[Path], int] = lambda folder: 0,
) -> Iterator[ResultFolder]:
    """A scratch folder beside ``target`` that takes its place when the block ends well.

    It is made at once, so that a folder that cannot be written is known before any work is done.
    If the block raises, nothing is left behind.  A block that writes nothing leaves no folder.
    With ``force``, the new files replace those of the same name, and `PARTS` of the earlier result
    that the new one does not have go with it; other files in the folder stay.
    If another process has made ``target`` meanwhile, the result takes the next free name.
    What killed processes left beside the same target is removed, or found in ``before``.

    Args:
        target: The folder.
        force: Replace the results in it.
        job: All that decides what is made; the same job goes on where a killed one stopped.
        progress: How far a folder is with that job, 0 if not at all.

    Raises:
        OutputError: ``target`` exists and ``force`` is not given, or it cannot be written.
    """
    with _about(target, f"{target}: cannot be written ({{}}); give another --out"):
        real = Path(os.path.realpath(target))  # through links, so that they stay
        left = scratches.dead(real)
    before = scratches.longest(left, job, progress)
    for one in [one for one in left if one is not before and one.job in ("", job)]:
        left.remove(one)
        one.remove()
    try:
        _refuse(target, force)
        place = yield from _made(real, target, force, job, before)
        while left and not place.kept:  # the target is done: nothing is to be gone on with
            left.pop().remove()
    finally:
        for one in left:
            one.leave()


def _made(
    real: Path, target: Path, force: bool, job: str, before: Scratch | None
) -> Generator[ResultFolder, None, ResultFolder]:
    """The block of `result_folder`, between making its scratch folder and publishing it."""
    made = [parent for parent in real.parents if not os.path.lexists(parent)]
    try:
        with _about(target, f"{target}: cannot be written ({{}}); give another --out"):
            real.parent.mkdir(parents=True, exist_ok=True)
            own = scratches.begin(real, job)
    except OutputError:
        _remove_empty(made)
        raise
    place = ResultFolder(own.new, target, None if before is None else before.new)
    try:
        with _about(target, f"{target}: the results cannot be written ({{}}); nothing was kept",
                    own.folder, real):  # fmt: skip
            yield place
            if not place.kept:
                _publish(own, real, place, force)
    finally:
        if place.kept:
            own.leave()
        else:
            own.remove()
        _remove_empty(made)
    return place


def _refuse(target: Path, force: bool) -> None:
    """Refuse a target that exists, if it may not be replaced.

    Raises:
        OutputError: It may not.
    """
    if not os.path.lexists(target):  # a link to nowhere counts
        return
    if not target.is_dir():
        raise OutputError(f"{target}: is a file, not a folder; give another --out")
    if not force:
        raise OutputError(
            f"{target}: already exists; give another --out, or --force to replace the results in it"
        )
    if Path.cwd().is_relative_to(target.resolve()):
        raise OutputError(
            f"{target}: is the folder that you are in, and would be replaced as a whole; name it "
            "from outside"
        )


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
    with _about(target, f"{target}: cannot be written ({{}}); give another place"):
        for one in scratches.dead(target):
            one.remove()
    beside = target.with_name(f"{target.name}{BESIDE}")
    if (os.path.lexists(target) or finish_beside(beside, target)) and not force:
        raise OutputError(f"{target}: already exists; give another name, or --force to replace it")
    if target.is_dir() and not (target / "zarr.json").is_file():
        raise OutputError(f"{target}: is a folder; give the name of a file")
    with _about(target, f"{target}: cannot be written ({{}}); give another place"):
        own = scratches.begin(target)
    try:
        with _about(target, f"{target}: cannot be written ({{}})", own.folder, target):
            new = own.new / target.name
            yield new
            replace_beside(own.new / beside.name, beside, new, target)
            if target.is_dir() and not target.is_symlink():
                _exchange(own, new, target)
            else:
                new.replace(target)
            finish_beside(beside, target)
    finally:
        own.remove()


def _remove_empty(folders: list[Path]) -> None:
    """Remove those of some folders, the deepest first, that hold nothing."""
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()


def unused_folder(wanted: Path, or_one: Callable[[Path], bool] = lambda folder: False) -> Path:
    """``wanted``, or the first of ``wanted-2``, ``wanted-3`` ... that does not exist.

    Args:
        wanted: The folder.
        or_one: Says of one that does exist whether it will do.
    """
    folder, number = wanted, 1
    while os.path.lexists(folder) and not or_one(folder):
        number += 1
        folder = wanted.with_name(f"{wanted.name}-{number}")
    return folder


def _publish(own: Scratch, real: Path, place: ResultFolder, force: bool) -> None:
    """Give a finished result its name, and tell the place which it got."""
    if not any(own.new.iterdir()):
        return
    if force and real.is_dir():
        _replace(own, real)
        return
    own.job = ""  # it is over
    while True:
        free = unused_folder(real)
        try:
            own.new.rename(free)
        except OSError:
            if not os.path.lexists(free):
                raise
        else:
            place.target = place.target.with_name(free.name) if free != real else place.target
            return


def _replace(own: Scratch, real: Path) -> None:
    """Put a result in the place of an earlier one, with the files there that are not results."""
    names = {file.name for file in own.new.iterdir()}
    for name in sorted(names):
        if (real / name).is_dir() and not (own.new / name).is_dir():
            raise OSError(errno.EISDIR, f"{name} is a folder there")
    gone = names | set(PARTS) if RESULT in names else names
    if DATASET in names and (real / DATASET).is_dir():
        gone |= set(DATASET_PARTS)
    _carry(real, own.new, gone)
    own.new.chmod(stat.S_IMODE(real.stat().st_mode))
    own.job = ""  # after this, what lies there may be the earlier result
    former = _exchange(own, own.new, real)
    _carry(former, real, gone)  # what came there in between


def _carry(source: Path, into: Path, gone: Container[str]) -> None:
    """Let what is in a folder be in another too, but what is there already or is to go."""
    for entry in source.iterdir():
        if entry.name not in gone and not os.path.lexists(into / entry.name):
            _link(entry, into / entry.name)


def _link(entry: Path, place: Path) -> None:
    """A file by a second name; a folder made again with such files."""
    if entry.is_dir() and not entry.is_symlink():
        place.mkdir()
        for inner in entry.iterdir():
            _link(inner, place / inner.name)
        shutil.copystat(entry, place)
        return
    try:
        os.link(entry, place, follow_symlinks=False)
    except OSError:  # some file systems know no second names
        shutil.copy2(entry, place, follow_symlinks=False)


def _exchange(own: Scratch, new: Path, target: Path) -> Path:
    """Put a folder in the place of another; where the other is then."""
    try:
        _rename_exchange(new, target)
    except OSError as err:
        if err.errno not in _CANNOT_EXCHANGE:
            raise
    else:
        return new
    following, former = own.folder / scratches.NEXT, own.folder / scratches.OLD
    new.rename(following)
    target.rename(former)  # killed here, the next start does the rest
    try:
        following.rename(target)
    except BaseException:
        former.rename(target)
        raise
    return former


def _rename_exchange(one: Path, other: Path) -> None:
    rename = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if rename is None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))
    if rename(_HERE, os.fsencode(one), _HERE, os.fsencode(other), _EXCHANGE) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number), str(other))


@contextmanager
def _about(target: Path, sentence: str, *places: Path) -> Iterator[None]:
    """Errors of writing at some places, or of all if none is given, as one sentence."""
    try:
        yield
    except OSError as err:
        if places and not _is_about(err, *places):
            raise
        raise OutputError(sentence.format(_reason(err))) from err


def _is_about(err: OSError, *places: Path) -> bool:
    """Whether an error is one of writing there, and not of something else that a job does."""
    if err.errno is None:
        return False
    if not isinstance(err.filename, str | os.PathLike):
        return True  # a write to a file that was open
    path = Path(err.filename).absolute()
    return any(path.is_relative_to(place.absolute()) for place in places)


def _reason(err: OSError) -> str:
    return (err.strerror or str(err)).lower()
