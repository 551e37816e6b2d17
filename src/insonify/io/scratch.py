"""Scratch folders of results: held by a lock while their process lives, found when it has died.

A scratch folder lies beside its target, ``.TARGET-xxxxxxxx``, and holds ``new``, which becomes the
result, ``owner``, locked (flock) for as long as its process lives, and ``job`` where another
process could go on with what is there.  Locks end with their process, whatever ends it; where a
file system has none, nothing is taken for dead.
"""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

NEW, NEXT, OLD = "new", "next", "old"
_OWNER, _JOB = "owner", "job"
_MARK = b"scratch folder of insonify\n"
_RANDOM = "[a-z0-9_]{8}"
"""What `tempfile.mkdtemp` puts at the end."""


@dataclass(slots=True)
class Scratch:
    """A scratch folder that this process holds.

    Attributes:
        folder: All of it.
        lock: The open file that says so.
    """

    folder: Path
    lock: int

    @property
    def new(self) -> Path:
        """What becomes the result."""
        return self.folder / NEW

    @property
    def job(self) -> str:
        """The job that can go on with it; nothing if none can."""
        try:
            return (self.folder / _JOB).read_text(encoding="utf-8")
        except (OSError, ValueError):
            return ""

    @job.setter
    def job(self, text: str) -> None:
        (self.folder / _JOB).unlink(missing_ok=True)
        if text:
            (self.folder / _JOB).write_text(text, encoding="utf-8")

    def leave(self) -> None:
        """Let go of it: the next process finds it."""
        os.close(self.lock)

    def remove(self) -> None:
        """Remove it, last what tells that it is one."""
        for name in (_JOB, NEW, NEXT, OLD):
            _remove(self.folder / name)
        with suppress(OSError):
            (self.folder / _OWNER).unlink()
            self.folder.rmdir()
        self.leave()


def begin(target: Path, job: str = "") -> Scratch:
    """A new scratch folder beside a target.

    Raises:
        OSError: It cannot be made.
    """
    with _alone(target.parent):
        folder = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
        lock = os.open(folder / _OWNER, os.O_CREAT | os.O_WRONLY, 0o600)
        with suppress(OSError):
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.write(lock, _MARK)
    own = Scratch(folder, lock)
    own.new.mkdir()
    own.job = job
    return own


def dead(target: Path) -> list[Scratch]:
    """The scratch folders of a target whose processes are gone; they are this process's now.

    What a kill left between two renames is made good: the target has its new folder.
    """
    pattern = re.compile(rf"\.{re.escape(target.name)}-{_RANDOM}")
    found = []
    with _alone(target.parent) as alone:
        names = [path.name for path in target.parent.iterdir()] if alone else []
        for name in sorted(filter(pattern.fullmatch, names)):
            taken = _taken(target.parent / name)
            if taken is not None:
                found.append(taken)
    for one in found:
        following = one.folder / NEXT
        if (one.folder / OLD).exists() and following.exists() and not os.path.lexists(target):
            following.rename(target)
    return found


def longest(found: Sequence[Scratch], job: str, progress: Callable[[Path], int]) -> Scratch | None:
    """Of dead scratch folders, the one in which a job came furthest; None if in none.

    Args:
        found: As `dead` found them.
        job: What is to be done.
        progress: How far the folder ``new`` is, 0 if there is nothing in it to go on with.
    """

    def reached(one: Scratch) -> int:
        try:
            return progress(one.new)
        except OSError:
            return 0

    same = [one for one in found if job and one.job == job and reached(one) > 0]
    return max(same, key=reached, default=None)


@contextmanager
def _alone(folder: Path) -> Iterator[bool]:
    """No other process begins or looks for a scratch folder there; False if that cannot be had."""
    try:
        held = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError:
        yield False
        return
    try:
        try:
            fcntl.flock(held, fcntl.LOCK_EX)
        except OSError:
            yield False
        else:
            yield True
    finally:
        os.close(held)


def _taken(folder: Path) -> Scratch | None:
    """A scratch folder, if it is one and nobody holds it."""
    try:
        lock = os.open(folder / _OWNER, os.O_RDWR | os.O_NOFOLLOW)
    except OSError:
        with suppress(OSError):
            folder.rmdir()  # if it is empty, its process died before it had a file
        return None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        ours = _MARK.startswith(os.pread(lock, len(_MARK), 0))  # or died before it was written
    except OSError:
        ours = False
    if ours:
        return Scratch(folder, lock)
    os.close(lock)
    return None


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
