"""Recordings of sonar: many formats, one way to read them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from insonify.errors import RecordingError
from insonify.io.recordings.aris import MAGIC as ARIS_MAGIC
from insonify.io.recordings.aris import read_aris
from insonify.io.recordings.arrays import read_arrays
from insonify.io.recordings.images import read_images
from insonify.io.recordings.magic import MCAP_MAGIC, ROS1_MAGIC, SQLITE_MAGIC
from insonify.io.recordings.oculus import START as OCULUS_START
from insonify.io.recordings.oculus import read_oculus
from insonify.io.recordings.oculus_log import START as LOG_START
from insonify.io.recordings.ping360 import PLAIN_START as PING_VIEWER_PLAIN
from insonify.io.recordings.ping360 import START as PING_VIEWER
from insonify.io.recordings.ping360 import read_ping360
from insonify.io.recordings.poses import is_telemetry
from insonify.io.recordings.range_images import STARTS as RANGE_IMAGES
from insonify.io.recordings.range_images import read_range_images
from insonify.io.recordings.recording import (
    Reading,
    Recording,
    at_other_times,
    in_our_axes,
    with_poses,
)
from insonify.io.recordings.simulated import read_simulated
from insonify.types import PosedPing

if TYPE_CHECKING:
    from insonify.io.recordings.ros.bags import Bag

_PICKLES = (b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05")


def open_bag_at(path: Path) -> Bag | None:
    """The bag at a path; None if it is a recording of another format.

    Raises:
        RecordingError: It is missing, or cannot be read.
        MissingExtraError: The packages for bags are not installed.
    """
    head = _head(path)
    folder = head is None and (path / "metadata.yaml").is_file()
    if not folder and (head is None or not head.startswith((MCAP_MAGIC, ROS1_MAGIC, SQLITE_MAGIC))):
        return None
    from insonify.io.recordings.ros.bags import open_bag

    return open_bag(path, head or b"")


def open_recording(path: Path, reading: Reading = Reading()) -> Recording:
    """Open a recording of any known format, told by its first bytes.

    Raises:
        RecordingError: It is missing, of no known format, or damaged beyond reading.
        MissingExtraError: Its format needs packages that are not installed.
    """
    bag = open_bag_at(path)
    head = _head(path)
    if bag is not None:
        from insonify.io.recordings.ros.recording import read_bag

        recording = read_bag(bag, reading)
    elif head is not None:
        recording = at_other_times(in_our_axes(_file(path, head, reading), reading), reading)
    else:
        recording = _folder(path, reading)
    if reading.clock_offset_s != 0.0 and not recording.timed:
        raise RecordingError(f"{path}: it has no clock, so --clock-offset says nothing")
    return with_poses(recording, reading)


def load_pings(path: Path | str, reading: Reading = Reading()) -> Iterator[PosedPing]:
    """The pings of a recording, or of what ``simulate`` or ``fly`` left, one in memory at a time.

    Each has its image ``ping.image``, (bins, beams) float32 in [0, 1] with the first beam to port;
    ``ping.geometry``, what its pixels mean; ``ping.time_s``; and ``pose``, where the body was.

    Raises:
        RecordingError: It is missing, of no known format, or damaged beyond reading.
    """
    return iter(open_recording(Path(path), reading))


def _head(path: Path) -> bytes | None:
    """The first bytes of a file; None of a folder."""
    try:
        if path.is_dir():
            return None
        if path.exists() and not path.is_file():
            raise RecordingError(f"{path}: neither a file nor a folder")
        with path.open("rb") as file:
            head = file.read(16)
    except FileNotFoundError as err:
        raise RecordingError(f"{path}: there is no such recording; check the path") from err
    except OSError as err:
        raise RecordingError(f"{path}: cannot be read ({err.strerror})") from err
    if not head:
        raise RecordingError(f"{path}: an empty file")
    return head


def _folder(path: Path, reading: Reading) -> Recording:
    simulated = read_simulated(path, reading)
    if simulated is not None:
        return at_other_times(in_our_axes(simulated, reading), reading)
    return read_images(path, reading)


def _file(path: Path, head: bytes, reading: Reading) -> Recording:
    if head[:4] == ARIS_MAGIC:
        return read_aris(path, reading)
    if head[:2] == OCULUS_START or head[:4] == LOG_START:
        return read_oculus(path, reading)
    if head[:16] in (PING_VIEWER[:16], PING_VIEWER_PLAIN[:16]):
        return read_ping360(path, reading)
    if head[:4] in RANGE_IMAGES:
        return read_range_images(path, reading)
    if head[:2] == b"PK":
        return read_arrays(path, reading)
    if is_telemetry(path):
        raise RecordingError(
            f"{path}: telemetry, which holds poses and no pings; give it to one with --poses"
        )
    if head[:2] in _PICKLES or path.suffix in {".pkl", ".pickle"}:
        raise RecordingError(f"{path}: a Python pickle; those run code and are not read")
    raise RecordingError(
        f"{path}: of no known format (it begins with {head[:8]!r}); known are MCAP, ROS bags, "
        "ARIS version 5, Oculus pings and logs, Ping360 logs, Sonar 3D-15 (.sonar), NumPy archives "
        "(.npz) and folders of images"
    )
