"""Result folders: everything appears at once, and nothing that exists is overwritten unasked."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from insonify.errors import OutputError


@contextmanager
def result_folder(target: Path, *, force: bool = False) -> Iterator[Path]:
    """A scratch folder beside ``target`` that takes its name when the block ends well.

    It is made at once, so that a folder that cannot be written is known before any work is done.
    If the block raises, nothing is left behind.  A block that writes nothing leaves no folder.
    With ``force``, the new files replace those of the same name; others in the folder stay.

    Raises:
        OutputError: ``target`` exists and ``force`` is not given, or it cannot be written.
    """
    if target.exists() and not (force and target.is_dir()):
        kind = "already exists" if target.is_dir() else "is a file, not a folder"
        raise OutputError(
            f"{target}: {kind}; give another --out"
            + (", or --force to replace the results in it" if target.is_dir() else "")
        )
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
    except OSError as err:
        raise OutputError(
            f"{target}: cannot be written ({_reason(err)}); give another --out"
        ) from err
    try:
        yield scratch
        _publish(scratch, target)
    except OSError as err:
        raise OutputError(
            f"{target}: the results cannot be written ({_reason(err)}); nothing was kept"
        ) from err
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def unused_folder(wanted: Path) -> Path:
    """``wanted``, or the first of ``wanted-2``, ``wanted-3`` ... that does not exist."""
    folder, number = wanted, 1
    while folder.exists():
        number += 1
        folder = wanted.with_name(f"{wanted.name}-{number}")
    return folder


def _publish(scratch: Path, target: Path) -> None:
    files = sorted(scratch.iterdir())
    if not files:
        return
    if not target.exists():
        scratch.chmod(0o777 & ~_umask())
        scratch.rename(target)
        return
    for file in files:
        file.replace(target / file.name)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _reason(err: OSError) -> str:
    return (err.strerror or str(err)).lower()
