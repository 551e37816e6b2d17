"""How a session fares, and its heartbeat: mapping, silent, without poses, or gone."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from insonify.doctor import examine_session
from insonify.io.heartbeat import FRESH_S, Heartbeat, heartbeats, write_heartbeat
from insonify.io.recordings.arrays import save_arrays
from insonify.io.recordings.recording import Reading
from insonify.live.counts import Counts
from insonify.live.health import OK, STALE, WARN, Health, Pulse
from insonify.live.poser import Poser
from insonify.live.session import Finished, Heard, Session, Tick
from insonify.mapping.factory import make_mapper
from insonify.mapping.mapper import MappingSettings
from insonify.mission.remap import Remap
from insonify.types import FanGeometry, Ping, Pose, PosedPing

FAN = FanGeometry(0.7, 0.2, 8, 16, 0.2, 2.0)
PING = Ping(np.zeros((16, 8), np.float32), FAN)
POSED, UNPOSED = Heard(PosedPing(PING, Pose(0.0, 0.0, -3.0)), 1), Heard(PosedPing(PING), 1)


@pytest.fixture
def session() -> Session:
    settings = MappingSettings()
    return Session(Poser(Reading(), Counts()), Remap(settings, make_mapper("bayes", settings)))


class Clock:
    def __init__(self) -> None:
        self.now_s = 1000.0

    def monotonic(self) -> float:
        return self.now_s


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(time, "monotonic", made.monotonic)
    return made


def test_a_session_is_judged_by_its_last_seconds(session: Session, clock: Clock) -> None:
    fares = Health()
    fares.watch(session, Tick())
    assert fares.state(session) == (OK, "")  # it has just begun
    clock.now_s += 7.0
    assert fares.state(session) == (OK, "")  # it was busy, and may have been sent pings
    fares.watch(session, Tick())
    assert fares.state(session) == (WARN, "no ping for 7 s")
    for _ in range(300):
        fares.watch(session, UNPOSED)
        clock.now_s += 0.05
    assert fares.state(session) == (WARN, "most pings have no pose")
    for _ in range(60):  # poses come: what was before is over
        fares.watch(session, POSED)
        clock.now_s += 0.05
    assert fares.state(session) == (OK, "")
    clock.now_s += 30.0
    fares.watch(session, Tick())
    assert fares.state(session) == (WARN, "no ping for 30 s")
    fares.watch(session, Finished())
    assert fares.state(session)[0] == STALE


def test_a_map_that_takes_no_more_says_why(session: Session, clock: Clock) -> None:
    fares = Health()
    session.counts.refused, session.counts.last_damage = 3, "no memory is left"
    fares.watch(session, UNPOSED)
    assert fares.state(session) == (WARN, "no memory is left")


def test_it_is_written_each_second_and_gone_at_the_end(
    session: Session, clock: Clock, tmp_path: Path
) -> None:
    new = tmp_path / ".dive-abcdefgh" / "new"
    new.mkdir(parents=True)
    pulse = Pulse(new)
    pulse.watch(session, POSED)
    told = examine_session(tmp_path)
    assert not told.fault and str(new) in told.told
    for folder in (tmp_path / "dive", tmp_path.parent, tmp_path):  # its name, and where it lies
        assert [path.parent for path, _ in heartbeats(folder)] == [new]
    assert not heartbeats(tmp_path / "div") and not heartbeats(new)
    clock.now_s += 0.5
    pulse.watch(session, Tick())
    clock.now_s += FRESH_S
    assert examine_session(tmp_path).fault and "10 s old" in examine_session(tmp_path).told
    pulse.watch(session, Tick())
    assert "no ping for 10 s" in examine_session(tmp_path).fault
    clock.now_s -= 900.0  # the machine was started anew
    assert "none runs" in examine_session(tmp_path).fault
    pulse.watch(session, Finished())
    assert not list(new.iterdir())


def test_of_two_the_later_counts_and_what_is_none_is_left_out(tmp_path: Path) -> None:
    now_s = time.monotonic()
    for name, at_s in {".dive-aaaaaaaa": now_s - 60.0, ".dive-bbbbbbbb": now_s}.items():
        (tmp_path / name / "new").mkdir(parents=True)
        beat = Heartbeat(at_s, True, "mapping", 2, 2)
        write_heartbeat(tmp_path / name / "new", beat)
    assert not examine_session(tmp_path).fault
    file = tmp_path / ".dive-bbbbbbbb" / "new" / "heartbeat.json"
    whole = json.loads(file.read_text())
    for text in ("", "[]", "{}", json.dumps(whole | {"version": 2}), json.dumps(whole | {"a": 1})):
        file.write_text(text)
        assert "60 s old" in examine_session(tmp_path).told


@pytest.mark.slow
def test_the_command_tells_a_session_that_maps_from_one_that_was_killed(tmp_path: Path) -> None:
    pings = [
        PosedPing(Ping(PING.image, FAN, 0.5 * k), Pose(0.1 * k, 0.0, -3.0)) for k in range(400)
    ]
    save_arrays(tmp_path / "dive.npz", pings)
    words = ["live", "--from", "dive.npz", "--rate", "1", "--out", "runs/L"]
    (tmp_path / "runs").mkdir()
    live = subprocess.Popen(
        [sys.executable, "-m", "insonify", *words], cwd=tmp_path, stderr=subprocess.DEVNULL
    )
    try:
        until = time.monotonic() + 60.0
        while (shown := doctor(tmp_path)).returncode:
            assert shown.returncode == 1 and "none runs" in shown.stderr, shown.stderr
            assert time.monotonic() < until and live.poll() is None
            time.sleep(0.2)
        assert "are mapped" in shown.stdout and "nothing lacks" in shown.stderr
    finally:
        live.send_signal(signal.SIGKILL)
        live.wait()
    ((file, _),) = heartbeats(tmp_path)
    told = json.loads(file.read_text())
    file.write_text(json.dumps(told | {"at_s": told["at_s"] - 60.0}))  # a minute later
    shown = doctor(tmp_path, "--json")
    assert shown.returncode == 1
    assert "s old" in json.loads(shown.stdout)[0]["told"]


def doctor(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    line = [sys.executable, "-m", "insonify", "doctor", "--live", ".", *words]
    return subprocess.run(line, cwd=folder, capture_output=True, text=True, check=False)
