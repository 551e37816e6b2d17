"""Damaged inputs: ``python -m benchmarks.fuzz [--count N] [--seed S] [--data DIR]``.

Every reader gets files with bytes cut off, flipped, overwritten, doubled or taken out, and empty
ones.  Each must give what can be read, with a warning or without, or one sentence that names the
file: no other exception, no reading that takes longer than a few seconds, no asking for memory out
of all proportion.
"""

from __future__ import annotations

import argparse
import importlib
import resource
import shutil
import signal
import sys
import tempfile
import time
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer

from benchmarks import samples
from benchmarks.bag_samples import BagMaker, plain_bag
from insonify.errors import InsonifyError
from insonify.io.maps import load_map, save_map
from insonify.io.recordings import open_recording
from insonify.io.recordings.arrays import save_arrays
from insonify.io.recordings.poses import read_poses
from insonify.io.recordings.ros.messages import message_types
from insonify.mapping.voxels import IN_VIEW, OBSERVED, VoxelMap
from insonify.sonar.devices import named_device
from insonify.types import FanGeometry, Ping, Pose, PosedPing

MOST_BYTES = 1 << 30
"""Address space that reading a file of some kilobytes may take beyond what is in use."""
MOST_SECONDS = 5
Make = Callable[[Path, np.random.Generator], Path]


@dataclass(frozen=True, slots=True)
class Reader:
    """A reader and how to make a sound input for it.

    ``make`` returns the file to damage; ``read`` gets it, or ``whole`` of it: its folder.
    """

    name: str
    make: Make
    read: Callable[[Path], object]
    whole: Callable[[Path], Path] = lambda path: path


@dataclass(slots=True)
class Tally:
    """What came of the damaged files of one reader."""

    outcomes: Counter[str] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)
    slowest_s: float = 0.0


class TooLongError(BaseException):
    """A reader did not come back; no reader may catch it."""


def _pings(path: Path) -> int:
    return sum(1 for _ in open_recording(path))


def _aris(folder: Path, rng: np.random.Generator) -> Path:
    path = folder / "a.aris"
    path.write_bytes(samples.aris(samples.pixels(rng, 3, 12, 48)))
    return path


def _oculus(version: int) -> Make:
    def make(folder: Path, rng: np.random.Generator) -> Path:
        bearings = np.linspace(-20.0, 20.0, 9)
        one = samples.oculus(samples.pixels(rng, 12, 9), bearings, version=version)
        (folder / "o.raw").write_bytes(3 * one)
        return folder / "o.raw"

    return make


def _oculus_log(packed: bool) -> Make:
    def make(folder: Path, rng: np.random.Generator) -> Path:
        one = samples.oculus(samples.pixels(rng, 12, 9), np.linspace(-20.0, 20.0, 9))
        (folder / "o.oculus").write_bytes(samples.oculus_log([one] * 3, packed=packed))
        return folder / "o.oculus"

    return make


def _ping360(folder: Path, rng: np.random.Generator) -> Path:
    log = samples.ping360_log([190, 200, 210], samples.pixels(rng, 3, 200), chunk=150)
    (folder / "p.bin").write_bytes(log)
    return folder / "p.bin"


def _sonar3d(folder: Path, rng: np.random.Generator) -> Path:
    rip = importlib.import_module("wlsonar.range_image_protocol")
    message = rip.RangeImage(
        range=5.0, width=8, height=6, fov_horizontal=30.0, fov_vertical=20.0,
        image_pixel_scale=0.001, speed_of_sound=1500.0,
        image_pixel_data=rng.integers(0, 5000, 48).tolist(),
    )  # fmt: skip
    (folder / "w.sonar").write_bytes(3 * rip.packb(message))
    return folder / "w.sonar"


def _arrays(folder: Path, rng: np.random.Generator) -> Path:
    fan = FanGeometry(0.5, 0.2, 6, 8, 0.1, 2.0)
    pings = [
        PosedPing(Ping(rng.random((8, 6), np.float32), fan, float(k)), Pose(k, 0.0, 0.0))
        for k in range(3)
    ]
    save_arrays(folder / "r.npz", pings)
    return folder / "r.npz"


def _inside_arrays(name: str) -> Make:
    """One array of an archive, which is packed again after the damage, its checksum right."""

    def make(folder: Path, rng: np.random.Generator) -> Path:
        with zipfile.ZipFile(_arrays(folder, rng)) as archive:
            archive.extractall(folder / "inside")
        return folder / "inside" / f"{name}.npy"

    return make


def _packed(path: Path) -> Path:
    whole = path.parent.with_suffix(".npz")
    with zipfile.ZipFile(whole, "w") as archive:
        for file in sorted(path.parent.iterdir()):
            archive.write(file, file.name)
    return whole


def _image(kind: str) -> Make:
    def make(folder: Path, rng: np.random.Generator) -> Path:
        images = samples.pixels(rng, 3, 10, 8)
        samples.image_folder(folder / "f", images, samples.tum_rows(3), kind=kind)
        return folder / "f" / f"0001.{kind}"

    return make


def _beside(name: str) -> Make:
    def make(folder: Path, rng: np.random.Generator) -> Path:
        _image("png")(folder, rng)
        return folder / "f" / name

    return make


def _bag(kind: str) -> Make:
    def make(folder: Path, rng: np.random.Generator) -> Path:
        path = plain_bag(folder / "b", kind, rng)
        return next(path.glob("*.db3")) if path.is_dir() else path

    return make


def _metadata(folder: Path, rng: np.random.Generator) -> Path:
    return plain_bag(folder / "b", "db3", rng) / "metadata.yaml"


def _bare_mcap(folder: Path, rng: np.random.Generator) -> Path:
    """No compression and no checksums, so that damage reaches the messages."""
    maker = BagMaker("mcap")
    store = message_types()
    azimuths, ranges = np.radians([10.0, 0.0, -10.0]), np.arange(1.0, 7.0)
    with (folder / "m.mcap").open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE, enable_crcs=False)
        writer.start(profile="ros2", library="samples")
        channels = {}
        for number in range(3):
            image = samples.pixels(rng, 6, 3)
            ping = maker.projected(1.0 + number, image, azimuths, ranges, 0.2)
            level = np.array([0.0, 0.0, 0.0, 1.0])
            pose = maker.odometry(1.0 + number, np.zeros(3), level)
            mount = maker.link(1.0, "base_link", "sonar", np.zeros(3), np.full(4, 0.5))
            for topic, message in (("/tf_static", mount), ("/sonar", ping), ("/odom", pose)):
                kind = message.__msgtype__
                if topic not in channels:
                    text, _ = store.generate_msgdef(kind, ros_version=2)
                    schema = writer.register_schema(kind, "ros2msg", text.encode())
                    channels[topic] = writer.register_channel(topic, "cdr", schema)
                data = bytes(maker.store.serialize_cdr(message, kind))
                writer.add_message(channels[topic], 10**9 * (1 + number), data, 0)
        writer.finish()  # type: ignore[no-untyped-call]
    return folder / "m.mcap"


def _map(suffix: str, inner: str = "") -> Make:
    """A map, or the first file of a kind inside one that is a folder."""

    def make(folder: Path, rng: np.random.Generator) -> Path:
        voxels = VoxelMap(0.1)
        slots = voxels.allocate(rng.integers(-4, 4, (5, 3)).astype(np.int32))
        voxels.log_odds[slots] = rng.normal(size=(len(slots), 512)).astype(np.float32)
        voxels.seen[slots] = IN_VIEW | OBSERVED
        save_map(voxels, folder / f"map{suffix}")
        path = folder / f"map{suffix}"
        return min(path.glob(inner)) if inner else path

    return make


def _zarr(path: Path) -> Path:
    return next(folder for folder in path.parents if folder.suffix == ".zarr")


READERS = (
    Reader("ARIS", _aris, _pings),
    Reader("Oculus v1", _oculus(1), _pings),
    Reader("Oculus v2", _oculus(2), _pings),
    Reader("Oculus log", _oculus_log(False), _pings),
    Reader("Oculus log, packed", _oculus_log(True), _pings),
    Reader("Ping360 log", _ping360, _pings),
    Reader("Sonar 3D-15", _sonar3d, _pings),
    Reader("arrays (.npz)", _arrays, _pings),
    Reader("arrays, images", _inside_arrays("images"), _pings, _packed),
    Reader("arrays, poses", _inside_arrays("pose_body"), _pings, _packed),
    Reader("image PNG", _image("png"), _pings, lambda path: path.parent),
    Reader("image TIFF", _image("tif"), _pings, lambda path: path.parent),
    Reader("image PGM", _image("pgm"), _pings, lambda path: path.parent),
    Reader("poses beside images", _beside("poses.csv"), _pings, lambda path: path.parent),
    Reader("sonar beside images", _beside("sonar.toml"), _pings, lambda path: path.parent),
    Reader("poses (TUM)", _beside("poses.csv"), read_poses),
    Reader("sonar (TOML)", _beside("sonar.toml"), lambda path: named_device(str(path))),
    Reader("MCAP", _bag("mcap"), _pings),
    Reader("MCAP, bare", _bare_mcap, _pings),
    Reader("ROS 1 bag", _bag("ros1"), _pings),
    Reader("ROS 2 bag, SQLite", _bag("db3"), _pings, lambda path: path.parent),
    Reader("ROS 2 bag, metadata", _metadata, _pings, lambda path: path.parent),
    Reader("map (.npz)", _map(".npz"), load_map),
    Reader("map (.bt)", _map(".bt"), load_map),
    Reader("map (.ot)", _map(".ot"), load_map),
    Reader("map (.zarr)", _map(".zarr", "zarr.json"), load_map, _zarr),
    Reader("map (.zarr), array", _map(".zarr", "log_odds/zarr.json"), load_map, _zarr),
    Reader("map (.zarr), blocks", _map(".zarr", "coords/c/0/0"), load_map, _zarr),
    Reader("map (.zarr), chunk", _map(".zarr", "log_odds/c/*/*/*"), load_map, _zarr),
)


def real_readers(folder: Path) -> tuple[Reader, ...]:
    """The recordings of a folder, each to be damaged in a copy."""

    def copied(source: Path) -> Make:
        def make(scratch: Path, rng: np.random.Generator) -> Path:
            (scratch / source.name).write_bytes(source.read_bytes())
            return scratch / source.name

        return make

    files = sorted(file for file in folder.iterdir() if file.is_file())
    return tuple(Reader(file.name, copied(file), _pings) for file in files)


def damaged(raw: bytes, rng: np.random.Generator) -> bytes:
    """A copy of some bytes with one kind of damage, or none where chance will have it."""
    size, kind = len(raw), int(rng.integers(0, 8))
    at = int(rng.integers(0, size))
    out = bytearray(raw)
    if kind == 0:
        return raw[:at]
    if kind == 1:
        return b"" if rng.random() < 0.2 else raw[: int(rng.integers(0, min(size, 64)))]
    if kind == 2:  # numbers at their limits
        word = [b"\0", b"\xff", b"\x7f", b"\x80", b"\x01"][int(rng.integers(0, 5))]
        width = int(rng.integers(1, 9))
        out[at : at + width] = word * min(width, size - at)
    elif kind == 3:
        length = int(rng.integers(1, 1 + min(200, size - at)))
        del out[at : at + length]
    elif kind == 4:
        length = int(rng.integers(1, 1 + min(200, size - at)))
        out[at:at] = out[at : at + length]
    elif kind == 5:
        length = int(rng.integers(1, 1 + min(32, size - at)))
        out[at : at + length] = rng.bytes(length)
    else:  # flipped bits, near the start, where headers lie, as often as anywhere
        for _ in range(int(rng.integers(1, 9))):
            spot = int(rng.integers(0, size if kind == 6 else min(size, 600)))
            out[spot] ^= 1 << int(rng.integers(0, 8))
    return bytes(out)


@contextmanager
def limits(seconds: int) -> Iterator[None]:
    """An alarm if the block does not end, and a limit on the memory it may ask for."""

    def ring(signum: int, frame: object) -> None:
        raise TooLongError

    before = signal.signal(signal.SIGALRM, ring)
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MOST_BYTES, hard))
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        signal.signal(signal.SIGALRM, before)


def try_one(reader: Reader, file: Path, data: bytes, tally: Tally) -> None:
    """Give a reader a damaged file, and note what came of it."""
    file.write_bytes(data)
    started = time.perf_counter()
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            with limits(MOST_SECONDS):
                reader.read(reader.whole(file))
            outcome = "read, with a warning" if told else "read"
        except InsonifyError as err:
            outcome = _judge(err, tally)
        except TooLongError:
            outcome = "took too long"
            tally.failures.append(f"{MOST_SECONDS} s were not enough")
        except Exception as err:  # noqa: BLE001 - what is looked for
            outcome = f"{type(err).__name__}"
            tally.failures.append(f"{type(err).__name__}: {err}")
    tally.outcomes[outcome] += 1
    tally.slowest_s = max(tally.slowest_s, time.perf_counter() - started)


def _judge(err: InsonifyError, tally: Tally) -> str:
    cause: BaseException | None = err
    while cause is not None:
        if isinstance(cause, MemoryError):
            tally.failures.append(f"asked for too much memory: {err}")
            return "asked for too much memory"
        cause = cause.__cause__
    if "\n" in str(err) or len(str(err)) > 1000:
        tally.failures.append(f"not one sentence: {err}")
    return "refused"


def fuzz(
    count: int, seed: int, readers: tuple[Reader, ...] = READERS, *, keep: Path | None = None
) -> dict[str, Tally]:
    """Damage ``count`` files, shared among the readers; those that fail a reader are kept."""
    tallies = {reader.name: Tally() for reader in readers}
    for number, reader in enumerate(readers):
        rng = np.random.default_rng([seed, number])
        tally = tallies[reader.name]
        with tempfile.TemporaryDirectory() as folder:
            file = reader.make(Path(folder), rng)
            raw = file.read_bytes()
            reader.read(reader.whole(file))  # sound, it must be read
            share = count // len(readers) + (number < count % len(readers))
            for turn in range(share):
                data = damaged(raw, rng)
                failures = len(tally.failures)
                try_one(reader, file, data, tally)
                if keep is not None and len(tally.failures) > failures:
                    name = f"{reader.name.replace(' ', '-')}-{turn}{file.suffix}"
                    shutil.copy(file, keep / name)
    return tallies


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, help="folder for the files that fail a reader")
    parser.add_argument("--data", type=Path, help="a folder of recordings to damage as well")
    given = parser.parse_args()
    readers = READERS + (real_readers(given.data) if given.data is not None else ())
    if given.keep is not None:
        given.keep.mkdir(parents=True, exist_ok=True)
    started = time.perf_counter()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    tallies = fuzz(given.count, given.seed, readers, keep=given.keep)
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    failures = 0
    for name, tally in tallies.items():
        outcomes = ", ".join(f"{n} {what}" for what, n in sorted(tally.outcomes.items()))
        print(f"{name:22} slowest {1e3 * tally.slowest_s:6.0f} ms: {outcomes}")
        for failure, times in Counter(tally.failures).most_common(8):
            print(f"    FAILED {times} times: {failure[:300]!r}")
        failures += len(tally.failures)
    total = sum(sum(tally.outcomes.values()) for tally in tallies.values())
    seconds = time.perf_counter() - started
    print(f"{total} files in {seconds:.0f} s, {failures} failures, memory grew by {grown:.0f} MB")
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
