"""What a crash must not lose: the pings as they were mapped, and now and then the map.

In a folder: ``recordings/001.mcap`` and so on, one a start and one a GiB, in chunks that are with
the disk within two seconds; ``checkpoint.npz``, a map and how many pings of which recordings are in
it; of a map on disk it lies with its tiles, in ``map.zarr``, and both become what they are at once.
 The recordings hold each ping in the order of mapping and with the pose it was mapped at,
unrounded, so `map` of them makes the same map, byte for byte.
"""

from __future__ import annotations

import json
import logging
import os
import threading
import time
import warnings
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from insonify.errors import RecordingError, ResultError, reason
from insonify.io.archives import read_archive
from insonify.io.maps.blocks import map_from_blocks, origin_of
from insonify.io.maps.ondisk import CHECKPOINT, TileStore, link
from insonify.io.maps.ondisk import take_over as take_tiles
from insonify.io.recordings import open_recording
from insonify.io.recordings.recording import RecordingWarning
from insonify.io.recordings.ros.mcap_writing import McapWriter
from insonify.live.played import FREQUENCY_HZ, SONAR, SOUND_SPEED_MPS
from insonify.live.session import Event, Finished, Heard, Session
from insonify.mapping.mapper import Mapper
from insonify.mapping.voxels import VoxelMap
from insonify.mission.remap import Remap, map_ping
from insonify.results.map import MAP
from insonify.results.mappers import give_back
from insonify.results.replay import posed_messages
from insonify.types import FanGeometry, Pose, PosedPing

_log = logging.getLogger(__name__)

RECORDINGS = "recordings"
_FORMAT, _VERSION = "insonify-checkpoint", 1
FLUSH_S = 2.0
MOST_BYTES = 1 << 30
"""Of a recording; then the next is begun."""
_LEAST_S, _SHARE = 10.0, 0.02
"""Between two checkpoints; what of the time they may take at most."""
_STAMPS = 4096


class Keeper:
    """Writes pings as they are mapped (a watcher of a session)."""

    def __init__(self, folder: Path, parts: list[dict[str, Any]] | None = None) -> None:
        """Begin the next recording.

        Args:
            folder: Where it all lies.
            parts: What recordings there are: their names, pings, and pings mapped.
        """
        self.folder = folder
        self.parts = [] if parts is None else parts
        self._writer: McapWriter | None = None
        self._stamps: dict[int, None] = {}
        self._flushed_s = self._saved_s = time.monotonic()
        self._saver: threading.Thread | None = None
        self._wait_s = _LEAST_S

    def watch(self, session: Session, event: Event) -> None:
        """Record a ping; make sure of what is recorded."""
        if isinstance(event, Heard):
            self._record(event.posed, event.stamp_ns)
        now_s = time.monotonic()
        if isinstance(event, Finished):
            self._close()
            if self._saver is not None:
                self._saver.join()
            (self.folder / CHECKPOINT).unlink(missing_ok=True)
        elif now_s - self._flushed_s > FLUSH_S:
            self.flush()
            if now_s - self._saved_s > self._wait_s:
                self._save(session)
            self._roll(session)

    def flush(self) -> None:
        """What is recorded is on the disk."""
        self._flushed_s = time.monotonic()
        if self._writer is not None:
            self._writer.flush()

    def abandon(self) -> None:
        """Close what is open: something went wrong, and what is recorded stays."""
        self._close()
        if self._saver is not None:
            self._saver.join()

    def _record(self, posed: PosedPing, stamp_ns: int) -> None:
        if self._writer is None:
            name = f"{len(self.parts) + 1:03d}.mcap"
            (self.folder / RECORDINGS).mkdir(exist_ok=True)
            self._writer = McapWriter(self.folder / RECORDINGS / name)
            self.parts.append({"name": name, "pings": 0, "mapped": 0})
        while stamp_ns in self._stamps:  # a state is found by its stamp
            stamp_ns += 1
        self._stamps[stamp_ns] = None
        if len(self._stamps) > _STAMPS:
            del self._stamps[next(iter(self._stamps))]
        told = posed_messages(SONAR, posed, stamp_ns, FREQUENCY_HZ, SOUND_SPEED_MPS, picture=False)
        for topic, message in told.items():
            self._writer.write(topic, message, stamp_ns)
        self.parts[-1]["pings"] += 1
        self.parts[-1]["mapped"] += posed.pose is not None

    def _roll(self, session: Session) -> None:
        """Begin another recording when one is large; each is a scan of its own."""
        if self._writer is not None and self._writer.size_bytes > MOST_BYTES:
            self._close()
            session.remap.mapper.finish_scan()

    def _close(self) -> None:
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def _save(self, session: Session) -> None:
        """Write a checkpoint beside what goes on; what it holds is flushed."""
        if self._saver is not None and self._saver.is_alive():
            return
        if self._writer is None:  # nothing has come since; and the last scan is finished
            return
        begun_s = time.monotonic()
        arrays = _arrays(session.remap, self.parts)
        store = session.remap.mapper.voxels.store
        if isinstance(store, TileStore):
            store.keep(**arrays)
        taken_s = time.monotonic() - begun_s
        self._saved_s = time.monotonic()
        self._wait_s = max(_LEAST_S, taken_s / _SHARE)
        if isinstance(store, TileStore):
            return
        self._saver = threading.Thread(target=_write, args=(self.folder / CHECKPOINT, arrays))
        self._saver.start()


def _arrays(remap: Remap, parts: list[dict[str, Any]]) -> dict[str, Any]:
    voxels = remap.mapper.voxels
    told = {
        "parts": parts,
        "mapper": remap.mapper.name,
        "settings": remap.settings.model_dump(),
        "brightest": remap.brightest,
        "pings": remap.pings,
        "path_m": remap.path_m,
        "fans": [asdict(fan) for fan in remap.fans],
    }
    state = {f"state_{name}": np.array(v) for name, v in remap.mapper.save().items()}
    return {
        "format": np.array(_FORMAT),
        "version": np.array(_VERSION),
        "told": np.array(json.dumps(told)),
        **(_blocks(voxels) if voxels.in_memory else {}),
        "origin_m": np.array(voxels.origin_m),
        "poses": np.array([pose.numbers for pose in remap.poses]).reshape(-1, 6),
        **state,
    }


def _blocks(voxels: VoxelMap) -> dict[str, Any]:
    arrays = {"coords": voxels.coords, "log_odds": voxels.log_odds, "seen": voxels.seen}
    return {name: array.copy() for name, array in arrays.items()}


def _write(path: Path, arrays: dict[str, Any]) -> None:
    part = path.with_suffix(".part")
    try:
        with part.open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except OSError as err:
        _log.warning("no checkpoint could be written (%s): a restart takes longer", reason(err))


def kept_bytes(folder: Path) -> int:
    """How much of recordings a folder holds; by it the longest of those left is gone on with."""
    return sum(file.stat().st_size for file in (folder / RECORDINGS).glob("*.mcap"))


def take_over(before: Path, folder: Path) -> None:
    """Let what an earlier start left be in a folder too; it stays where it was."""
    (folder / RECORDINGS).mkdir()
    for file in sorted((before / RECORDINGS).glob("*.mcap")):
        link(file, folder / RECORDINGS / file.name)
    if (before / CHECKPOINT).is_file():
        link(before / CHECKPOINT, folder / CHECKPOINT)
    take_tiles(before / MAP, folder / MAP)


def remember(remap: Remap, folder: Path) -> list[dict[str, Any]]:
    """Map again what the recordings in a folder hold, from its checkpoint on.

    Returns:
        The recordings: their names, pings, and pings mapped.

    Raises:
        ResultError: The checkpoint is another mapper's.
    """
    store = remap.mapper.voxels.store
    file = folder / (MAP if isinstance(store, TileStore) else "") / CHECKPOINT
    there = file.is_file() if not isinstance(store, TileStore) else store.resume() is not None
    done = _load(remap, file) if there else {}
    finished = set(list(done)[:-1])  # scans of the checkpoint's map, all but the one that went on
    parts: list[dict[str, Any]] = []
    for file in sorted((folder / RECORDINGS).glob("*.mcap")):
        pings, mapped = _remembered(remap, file, done.get(file.name, 0))
        if pings == 0:  # it was killed before it had written one
            file.unlink()
            continue
        if file.name not in finished:
            remap.mapper.finish_scan()
        name = f"{len(parts) + 1:03d}.mcap"
        if file.name != name:
            file.rename(file.with_name(name))
        parts.append({"name": name, "pings": pings, "mapped": mapped})
    return parts


def _remembered(remap: Remap, file: Path, done: int) -> tuple[int, int]:
    """Map what a recording holds beyond some pings; how many it has, and how many with a pose."""
    pings = mapped = 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)  # that it is cut off is why we are here
        try:
            recording = open_recording(file)
        except RecordingError:
            return 0, 0
        for posed in recording:
            pings += 1
            mapped += posed.pose is not None
            if pings > done:
                map_ping(remap, posed, str(file))
    return pings, mapped


def _load(remap: Remap, path: Path) -> dict[str, int]:
    """Put a checkpoint's map into a mapper; how many pings of each recording it holds."""
    arrays = read_archive(path, _FORMAT, _VERSION, ResultError)
    told = json.loads(str(arrays["told"]))
    mapper: Mapper = remap.mapper
    if told["mapper"] != mapper.name or told["settings"] != remap.settings.model_dump():
        raise ResultError(f"{path}: was made with other settings; give another --out")
    voxels, names = mapper.voxels, ("coords", "log_odds", "seen", "origin_m")
    if isinstance(voxels.store, TileStore):
        voxels.origin_m = origin_of(path, arrays["origin_m"])
    else:
        blocks = (arrays[name] for name in names)
        voxels = map_from_blocks(path, remap.settings.voxel_m, *blocks)
    state = {
        name.removeprefix("state_"): arrays[name] for name in arrays if name.startswith("state_")
    }
    give_back(mapper, voxels, state)
    remap.fans.extend(FanGeometry(**fan | {"mount": Pose(**fan["mount"])}) for fan in told["fans"])
    remap.brightest = float(told["brightest"])
    remap.pings, remap.path_m = int(told["pings"]), float(told["path_m"])
    remap.poses.extend(Pose(*map(float, row)) for row in arrays["poses"])
    return {part["name"]: int(part["pings"]) for part in told["parts"]}
