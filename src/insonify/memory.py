"""How much memory may be used: the least of what the machine, a container and ulimit leave."""

from __future__ import annotations

import math
import resource
from collections.abc import Iterator
from pathlib import Path

import psutil

SHARE = 0.9
"""Of what is free, so much may be asked for."""
_CGROUPS = Path("/sys/fs/cgroup")
_UNLIMITED = 1 << 60
"""The kernel writes huge numbers where there is no limit."""


def free_bytes() -> int:
    """Memory that this process can still take."""
    free = [int(psutil.virtual_memory().available), *_cgroup_bytes()]
    address_space, _ = resource.getrlimit(resource.RLIMIT_AS)
    if address_space != resource.RLIM_INFINITY:
        free.append(address_space - int(psutil.Process().memory_info().vms))
    return max(0, min(free))


def fits(needed_bytes: float) -> bool:
    """Whether so much can be asked for."""
    return needed_bytes <= SHARE * free_bytes()


def shortage(needed_bytes: float) -> str:
    """What is needed and what is free, for a message."""
    return f"about {needed_bytes / 1e9:.3g} GB and {free_bytes() / 1e9:.3g} GB are free"


def _cgroup_bytes(root: Path = _CGROUPS, own: Path = Path("/proc/self/cgroup")) -> Iterator[int]:
    """What each control group above this process leaves, version 2 or 1."""
    try:
        lines = own.read_text(encoding="ascii").splitlines()
    except OSError:
        return
    for line in lines:
        _, kinds, path = line.split(":", 2)
        if kinds not in ("", "memory"):
            continue
        base, names = (
            (root, ("memory.max", "memory.current", "inactive_file"))
            if kinds == ""
            else (
                root / "memory",
                ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
            )
        )
        group = base / path.lstrip("/")
        for folder in (group, *group.parents):
            left = _left_in(folder, *names)
            if left is not None:
                yield left
            if folder == base:
                break


def _left_in(folder: Path, limit: str, usage: str, cache: str) -> int | None:
    """What a control group leaves; files that are cached make room when it is needed."""
    try:
        most = float((folder / limit).read_text(encoding="ascii").replace("max", "inf"))
        used = int((folder / usage).read_text(encoding="ascii"))
        words = (folder / "memory.stat").read_text(encoding="ascii").split()
    except (OSError, ValueError):
        return None
    if not math.isfinite(most) or most >= _UNLIMITED:
        return None
    cached = dict(zip(words[::2], words[1::2], strict=False)).get(cache, "0")
    return int(most) - used + int(cached)
