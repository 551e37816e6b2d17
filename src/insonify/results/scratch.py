"""Results whose making was killed: found again by their scratch folder.

A long job writes into the scratch folder of its result as it goes, beside its config.  If the
process dies, the folder stays.  The same job, started again, goes on from there.
"""

from __future__ import annotations

import os
from glob import escape
from pathlib import Path

import psutil

CONFIG, OWNER = "config.toml", "owner.pid"


def claim(folder: Path, config: str) -> None:
    """Write into a scratch folder whose it is, and of what config."""
    (folder / CONFIG).write_text(config, encoding="utf-8")
    started = psutil.Process().create_time()
    (folder / OWNER).write_text(f"{os.getpid()} {started!r}", encoding="utf-8")


def keep(folder: Path) -> Path:
    """Move a scratch folder to where it outlives its job, for another to find; its new name."""
    kept = folder.with_name(f"{folder.name}-kept")
    folder.replace(kept)
    return kept


def find_unfinished(target: Path, config: str, holds: str) -> Path | None:
    """The scratch folder of a dead job of the same config to the same target, if there is one.

    Args:
        target: The result's folder.
        config: The job's whole config.
        holds: A file or folder that is there when something is worth keeping.
    """
    for folder in sorted(target.parent.glob(f".{escape(target.name)}-*")):
        try:
            same = (folder / CONFIG).read_text(encoding="utf-8") == config
            owner, started = (folder / OWNER).read_text(encoding="utf-8").split()
            if same and (folder / holds).stat().st_size and not _lives(owner, started):
                return folder
        except (OSError, ValueError):
            continue
    return None


def _lives(owner: str, started: str) -> bool:
    """Whether the process that wrote a folder is still the one of its number."""
    try:
        return bool(psutil.Process(int(owner)).create_time() == float(started))
    except psutil.NoSuchProcess:
        return False
    except psutil.AccessDenied:
        return True
