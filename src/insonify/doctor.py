"""What this machine has of what insonify uses, and what to do about what lacks.

Nothing is sent: the bus is looked at, not joined.
"""

from __future__ import annotations

import os
import platform
import shutil
import time
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

from insonify import __version__, memory
from insonify.errors import ConfigError, InsonifyError, reason
from insonify.io.heartbeat import heartbeats

LEAST_FREE_BYTES = 1 << 30
EXTRAS = {
    "recordings": ("rosbags", "mcap", "zstandard", "apsw"),
    "reports": ("matplotlib", "jinja2", "plotly"),
    "simulation": ("embreex", "manifold3d", "collada"),
    "live": ("cyclonedds", "foxglove"),
    "view": ("viser",),
    "maps": ("tifffile", "zarr"),
    "mavlink": ("pymavlink", "serial"),
    "waterlinked": ("wlsonar",),
    "opengl": ("moderngl",),
    "campaigns": ("duckdb", "pandas", "pyarrow"),
    "cluster": ("distributed",),
    "datasets": ("xarray", "zarr"),
    "gymnasium": ("gymnasium",),
    "rerun": ("rerun",),
}
"""Groups of libraries that can be left out, by what is imported."""
_MOST_DOMAIN = 232


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        what: Its name.
        told: What was found.
        fault: What lacks, nothing if it is well.
        remedy: What to do about it.
    """

    what: str
    told: str
    fault: str = ""
    remedy: str = ""


def examine(folder: Path) -> Iterator[Finding]:
    """Look at the machine.

    Args:
        folder: Where results would be written.

    Yields:
        What was found, one after the other.
    """
    for look in (_versions, _threads, _kernels, _embree, _opengl, _extras, _bus, _interfaces):
        yield look()
    yield _memory()
    yield _disk(folder)


def examine_session(folder: Path) -> Finding:
    """Whether `insonify live` runs and maps, by its heartbeat on the disk.

    Args:
        folder: The session's ``--out``, or one that it lies in, as the folder where it was started.
    """
    found = heartbeats(folder)
    fresh = [one for one in found if one[1].fresh]
    if not fresh:
        told = "no session"
        if found:
            told = f"the last sign of one is {time.monotonic() - found[0][1].at_s:.0f} s old"
        return Finding(
            "live", told, f"none runs that writes to {folder}", "see what it said, and start it"
        )
    path, beat = fresh[0]
    told = f"{beat.pings} pings came, {beat.mapped} are mapped; {path.parent}"
    if not beat.well:
        return Finding("live", told, beat.words, "see that the sonar and the poses are sent")
    return Finding("live", told)


def domain_of(text: str) -> int:
    """The DDS domain that ``ROS_DOMAIN_ID`` says.

    Raises:
        ConfigError: It is none.
    """
    text = text.strip() or "0"
    if not text.isdecimal() or int(text) > _MOST_DOMAIN:
        raise ConfigError(f"ROS_DOMAIN_ID is {text!r}, not a number from 0 to {_MOST_DOMAIN}")
    return int(text)


def _versions() -> Finding:
    names = ("numpy", "numba", "scipy", "rosbags", "mcap", "cyclonedds")
    known = [f"{name} {_version(name)}" for name in names]
    python = f"Python {platform.python_version()}"
    return Finding(
        "versions", ", ".join([f"insonify {__version__}", python, platform.machine(), *known])
    )


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def _threads() -> Finding:
    import numba

    told = f"{numba.get_num_threads()} of {os.cpu_count()} cores"
    if numba.get_num_threads() == 1 and len(os.sched_getaffinity(0)) > 1:
        return Finding(
            "threads", told, "kernels use one core", "unset NUMBA_NUM_THREADS, or leave it so"
        )
    return Finding("threads", told)


def _kernels() -> Finding:
    from insonify import jit

    folder = jit.cache_folder()
    if folder is None:
        return Finding(
            "kernels",
            "none kept",
            "no folder can be written for compiled kernels, so each start takes a minute",
            "set NUMBA_CACHE_DIR to a folder that can be written",
        )
    count = sum(1 for _ in folder.rglob("*.nbi"))
    if count == 0:
        return Finding(
            "kernels", "none compiled", "the first start takes minutes", "run: insonify warm-up"
        )
    return Finding("kernels", f"{count} compiled in {folder}; `insonify warm-up` does the others")


def _embree() -> Finding:
    remedy = "pip install 'insonify[simulation]' (there is no wheel for aarch64)"
    told = "not needed to map, plan, or run live; scan, simulate and fly need it, or OpenGL"
    if find_spec("embreex") is None:
        return Finding("Embree", told, "is not installed", remedy)
    try:
        import_module("embreex.rtcore_scene")
    except ImportError as err:
        return Finding("Embree", told, reason(err), remedy)
    return Finding("Embree", f"embreex {_version('embreex')}")


def _opengl() -> Finding:
    try:
        from insonify.sonar.gpu import open_context

        context = open_context()
    except InsonifyError as err:
        return Finding(
            "OpenGL", "only --renderer opengl needs it", str(err), "see what it says, or leave it"
        )
    renderer = str(context.info["GL_RENDERER"])
    return Finding("OpenGL", f"EGL, {renderer}" + ("" if _is_gpu(renderer) else " (no GPU)"))


def _is_gpu(renderer: str) -> bool:
    return not any(word in renderer.lower() for word in ("llvmpipe", "softpipe", "swrast"))


def _extras() -> Finding:
    lacking = [
        name for name, modules in EXTRAS.items() if any(find_spec(one) is None for one in modules)
    ]
    if not lacking:
        return Finding("extras", ", ".join(EXTRAS))
    have = [name for name in EXTRAS if name not in lacking]
    return Finding(
        "extras",
        ", ".join(have) or "none",
        f"{', '.join(lacking)}: not installed, or in part",
        f"if you need them: pip install 'insonify[{','.join(lacking)}]'",
    )


def _bus() -> Finding:
    """What the environment says of DDS; the domain is not joined, which would say hello."""
    uri = os.environ.get("CYCLONEDDS_URI", "")
    try:
        told = f"domain {domain_of(os.environ.get('ROS_DOMAIN_ID', ''))}"
    except ConfigError as err:
        return Finding("DDS", "", str(err), "set it to the robot's, or unset it for 0")
    told += f", CYCLONEDDS_URI {uri[:60]!r}" if uri else ", every interface (no CYCLONEDDS_URI)"
    if find_spec("cyclonedds") is None:
        return Finding("DDS", told, "cyclonedds is not installed", "pip install 'insonify[live]'")
    path = uri.removeprefix("file://").split(",")[0]
    if uri and not uri.lstrip().startswith("<") and not Path(path).is_file():
        return Finding("DDS", told, f"{path}: there is no such file", "set CYCLONEDDS_URI right")
    return Finding("DDS", told)


def _interfaces() -> Finding:
    import psutil

    up = {name: one for name, one in psutil.net_if_stats().items() if one.isup}
    told = ", ".join(
        f"{name}{'' if 'multicast' in one.flags else ' (no multicast)'}" for name, one in up.items()
    )
    if not any("multicast" in one.flags for one in up.values()):
        return Finding(
            "interfaces",
            told or "none",
            "none has multicast, by which DDS finds others",
            "name the others as peers in CYCLONEDDS_URI (docs/onboard.md)",
        )
    return Finding("interfaces", told)


def _memory() -> Finding:
    free = memory.free_bytes()
    told = f"{free / 1e9:.1f} GB free"
    if free < LEAST_FREE_BYTES:
        return Finding("memory", told, "little for a map", "take larger voxels (--voxel)")
    return Finding("memory", told)


def _disk(folder: Path) -> Finding:
    place = next((one for one in (folder, *folder.parents) if one.is_dir()), Path("/"))
    free = shutil.disk_usage(place).free
    told = f"{free / 1e9:.1f} GB free at {place}"
    if not os.access(place, os.W_OK):
        return Finding("disk", told, "it cannot be written", "give another folder (--out)")
    if free < LEAST_FREE_BYTES:
        return Finding(
            "disk", told, "little for a recording", "free some, or give another folder (--out)"
        )
    return Finding("disk", told)
