"""Recordings of a session that rolls on to the next: the same map, also after a kill between."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from benchmarks import live_kills

from insonify.io.maps import load_map, ondisk, save_map
from insonify.io.recordings import open_recording
from insonify.io.recordings.recording import Reading, RecordingWarning
from insonify.io.recordings.ros.bags import BagMessage
from insonify.io.recordings.ros.mcap_writing import McapWriter
from insonify.live import keeping
from insonify.live import session as session_module
from insonify.live.counts import Counts
from insonify.live.played import as_message
from insonify.live.poser import Poser
from insonify.live.running import Order, run_session
from insonify.live.session import Session
from insonify.mapping.factory import make_mapper
from insonify.mapping.mapper import MappingSettings
from insonify.mission.remap import map_recordings
from insonify.results.map import MapConfig
from insonify.results.replay import posed_messages
from insonify.types import FanGeometry, Ping, Pose, PosedPing

FAN = FanGeometry(0.7, 0.2, 32, 64, 0.2, 2.0)
SCANS = """
import numpy as np
from insonify.mapping.bayes import BayesMapper

class Scans(BayesMapper):
    '''Tells at the end of a scan how long it was: two scans are not one of both lengths.'''

    name = "scans"
    fresh = 0

    def integrate(self, ping, pose):
        super().integrate(ping, pose)
        self.fresh += 1

    def finish_scan(self):
        self.voxels.log_odds[:] += np.float32(0.001 * self.fresh**2)
        self.fresh = 0

    def save(self):
        return {"fresh": np.array(self.fresh)}

    def load(self, arrays):
        self.fresh = int(arrays["fresh"])
"""


class GoneError(BaseException):
    """As a kill: nothing is said, and nothing is ended well."""


@pytest.fixture(autouse=True)
def no_reports(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("insonify.results.map._report", lambda remap, path: None)


def dive(pings: int) -> list[BagMessage]:
    """Pings that tell their poses, of noise, which no recording makes much smaller."""
    rng, told = np.random.default_rng(5), []
    for k in range(1, pings + 1):
        ping = Ping((rng.random((64, 32)) * (rng.random((64, 32)) > 0.8)).astype(np.float32), FAN)
        posed = PosedPing(ping, Pose(0.03 * k, 0.0, -3.0, yaw_rad=0.02 * k))
        messages = posed_messages("sonar", posed, k * 10**9, 1e6, 1500.0, picture=False)
        told += [as_message(topic, one, k * 10**9) for topic, one in messages.items()]
    return told


def dies(told: list[BagMessage]) -> Iterator[BagMessage]:
    yield from told
    raise GoneError


def now_and_then(save: Callable[..., None]) -> Callable[..., None]:
    """Checkpoints that depend on no clock."""

    def write(keeper: keeping.Keeper, session: Session) -> None:
        if session.number % 7 == 0:
            save(keeper, session)
            if keeper._saver is not None:
                keeper._saver.join()

    return write


@pytest.mark.parametrize("deaths", [(), (30,), (33, 34, 71)])
@pytest.mark.parametrize(
    ("mapper", "memory_bytes"),
    [("bayes", None), ("carving", None), ("scans.py:Scans", None), ("bayes", 1300 * 2560)],
)
def test_a_session_that_rolls_is_mapped_again_from_its_recordings(
    mapper: str, memory_bytes: int | None, deaths: tuple[int, ...], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """With a checkpoint at every seventh ping, so that a restart begins inside a recording."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scans.py").write_text(SCANS)
    monkeypatch.setattr(keeping, "MOST_BYTES", 60_000)
    monkeypatch.setattr(keeping, "FLUSH_S", 0.0)
    monkeypatch.setattr(keeping, "_LEAST_S", 0.0)
    monkeypatch.setattr(keeping.Keeper, "_save", now_and_then(keeping.Keeper._save))
    monkeypatch.setattr(session_module, "TICK_S", 0.0)
    monkeypatch.setattr(ondisk, "LEAST_BYTES", 0)
    voxel_m = 0.1 if memory_bytes is None else 0.03  # so that it is more than what is held
    settings = MappingSettings(voxel_m=voxel_m, pixel_threshold=120)
    config = MapConfig(mapper=mapper, mapping=settings)
    told = dive(80)
    each = len(told) // 80
    begin = 0
    for end in (*deaths, 80):
        some = told[begin * each : end * each]
        begin = end
        poser = Poser(Reading(), Counts())
        order = Order(config, None, tmp_path / "L", memory_bytes=memory_bytes, job="job")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RecordingWarning)
            if end < 80:
                with pytest.raises(GoneError):
                    run_session(order, poser, dies(some))
            else:
                run_session(order, poser, iter(some))
    parts = sorted((tmp_path / "L/recordings").iterdir())
    assert len(parts) >= 4 + (len(deaths) > 0)
    assert [part.name for part in parts] == [f"{k:03d}.mcap" for k in range(1, len(parts) + 1)]
    made = make_mapper(mapper, settings)
    remap = map_recordings([open_recording(part) for part in parts], settings, mapper=made)
    save_map(remap.mapper.voxels, tmp_path / "again.npz")
    assert remap.pings == 80
    if memory_bytes is not None:
        save_map(load_map(tmp_path / "L/map.zarr"), tmp_path / "L/map.npz")
    assert (tmp_path / "L/map.npz").read_bytes() == (tmp_path / "again.npz").read_bytes()


ROLLING = (
    "from insonify.live import keeping\nkeeping.MOST_BYTES = {}\nkeeping.FLUSH_S = 0.5\n"
    "from insonify.cli import main\nmain()\n"
)
"""The command with recordings of so many bytes."""


@pytest.mark.slow
def test_what_was_on_the_disk_at_a_kill_is_in_the_map(
    domain: int, tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The short version of `python -m benchmarks.live_kills`, with recordings that roll."""
    fan = FanGeometry(1.0, 0.3, 32, 80, 0.5, 8.0)
    with McapWriter(tmp_path / "long.mcap") as writer:
        for k in range(1, 41):
            ping = Ping(
                (rng.random((80, 32)) * (rng.random((80, 32)) > 0.8)).astype(np.float32), fan
            )
            posed = PosedPing(ping, Pose(0.1 * k, 0.0, -5.0, yaw_rad=0.01 * k))
            told = posed_messages("sonar", posed, k * 10**9, 1e6, 1500.0, picture=False)
            for topic, message in told.items():
                writer.write(topic, message, k * 10**9)

    def start(*words: str, home: Path) -> subprocess.Popen[str]:
        line = [sys.executable, "-c", ROLLING.format(30_000), *words]
        return subprocess.Popen(line, cwd=home, text=True, stdout=subprocess.DEVNULL,
                                stderr=subprocess.PIPE, env=os.environ)  # fmt: skip

    monkeypatch.setattr(live_kills, "start", start)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)
        trial = live_kills.trial(tmp_path, tmp_path / "long.mcap", 3.0, 1, rng)
    assert trial.kills == 1 and trial.flushed and trial.received > len(trial.flushed)
    assert trial.good, trial
    assert len(list((tmp_path / "L/recordings").iterdir())) > 3
    assert not list(tmp_path.glob(".L-*"))
