"""A session on our own page: in a real browser, and what of it is kept."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.bag_samples import plain_bag
from benchmarks.chromium import errors, fetched

from insonify.io.recordings.recording import Reading
from insonify.live import showing
from insonify.live.counts import Counts
from insonify.live.poser import Poser
from insonify.live.session import Event, Finished, Heard, Session, Tick
from insonify.live.showing import Narrator
from insonify.mapping.factory import make_mapper
from insonify.mapping.mapper import MappingSettings
from insonify.mission.remap import Remap, map_ping
from insonify.types import FanGeometry, Ping, Pose, PosedPing
from insonify.view.story import Story

FAN = FanGeometry(1.0, 0.3, 16, 40, 0.5, 8.0)
FAR = Pose(500_000.0, 4_000_000.0, -10.0)


class NoPage:
    """Stands for a page: which stories it was to show."""

    def __init__(self) -> None:
        self.shown: list[Story] = []

    def show(self, story: Story) -> None:
        self.shown.append(story)


def told(count: int, narrator: Callable[[Session, Event], None]) -> Session:
    """A session of pings that go north a metre each, image k of brightness k / 255, told."""
    settings = MappingSettings(voxel_m=0.5)
    session = Session(Poser(Reading(), Counts()), Remap(settings, make_mapper("bayes", settings)))
    for k in range(count):
        ping = Ping(np.full((40, 16), k / 255.0, np.float32), FAN, float(k))
        posed = PosedPing(ping, FAR.moved((0.0, 1.0 * k, 0.0)))
        map_ping(session.remap, posed, "test")
        session.counts.pings += 1
        session.counts.mapped += 1
        narrator(session, Heard(posed, 10**9 * k))
        narrator(session, Tick())
    narrator(session, Finished())
    return session


def test_what_a_session_tells_is_told_in_the_frame_of_its_map() -> None:
    page, story = NoPage(), Story("a dive")
    session = told(5, Narrator(page, story, None).watch)  # type: ignore[arg-type]
    origin = session.remap.mapper.voxels.origin_m
    assert origin != (0.0, 0.0, 0.0)
    assert [moment.pose for moment in story.moments] == session.remap.poses
    assert story.pings == 5 and "5 of 5 pings are mapped" in story.end
    found = story.maps.at(5)
    assert found is not None and found[0] == 5
    assert found[1].occupied.count == int((session.remap.mapper.voxels.log_odds > 0).sum())
    assert not page.shown


def test_the_last_ping_is_in_the_map_when_no_more_come(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(showing, "_EVERY_S", 0.2)
    monkeypatch.setattr(showing, "_PATIENCE_S", 0.1)
    story = Story("a dive")
    narrator = Narrator(NoPage(), story, None)  # type: ignore[arg-type]

    def watch(session: Session, event: Event) -> None:
        if not isinstance(event, Finished):
            narrator.watch(session, event)

    session = told(3, watch)
    found = story.maps.at(3)
    assert found is not None and found[0] == 1

    def shown() -> bool:
        narrator.watch(session, Tick())
        found = story.maps.at(3)
        return found is not None and found[0] == 3

    until(shown)


@pytest.mark.parametrize("count", [3, 4, 5, 8, 9, 23, 64])
def test_a_session_that_goes_on_is_told_with_fewer_pings(
    count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(showing, "MOST_MOMENTS", 4)
    page, first = NoPage(), Story("a dive")
    narrator = Narrator(page, first, None)  # type: ignore[arg-type]
    told(count, narrator.watch)
    story = narrator.story
    assert page.shown[-1:] == ([] if count <= 4 else [story])
    assert len(story.moments) <= 5 and story.pings == count
    assert len(story.moments) == len(range(0, count, story.stride))
    for number, moment in enumerate(story.moments, 1):
        ping = (number - 1) * story.stride
        assert moment.time_s == ping
        kept = story.images.at(number)
        assert kept is not None and kept[0] == number and (kept[1] == ping).all()


def until(what: Callable[[], Any]) -> Any:
    limit = time.monotonic() + 60.0
    while time.monotonic() < limit:
        found = what()
        if found:
            return found
        time.sleep(0.1)
    pytest.fail("waited a minute in vain")


def counted(browser: Any) -> int:
    """How many pings the page tells of."""
    text = str(browser.execute_script("return document.body.innerText"))
    found = re.search(r"ping \d+ of (\d+)", text)
    return int(found[1]) if found else 0


@pytest.mark.slow
def test_a_session_in_the_browser(
    tmp_path: Path, browser: Any, run: Callable[..., str], rng: np.random.Generator
) -> None:
    """It is seen to grow; that the browser comes and goes, or never does, changes no byte."""
    pings = 24
    plain_bag(tmp_path / "bag", "mcap", rng, pings)
    words = ["live", "--from", "bag/bag.mcap", "--voxel", "0.1"]
    seen = ["--rate", "3", "--view", "--port", "8420", "--out", "L"]
    line = [sys.executable, "-m", "insonify", *words, *seen]
    with subprocess.Popen(line, cwd=tmp_path, text=True, stderr=subprocess.PIPE,
                          stdout=subprocess.PIPE) as process:  # fmt: skip
        assert process.stderr is not None
        address = process.stderr.readline().removeprefix("View: ").strip()
        assert address.startswith("http://127.0.0.1:")
        browser.get(address)
        begun = until(lambda: counted(browser))
        grown = until(lambda: counted(browser) > begun and counted(browser))
        assert grown <= pings
        browser.get("about:blank")  # gone, while pings come
        assert "Report: L/report.html" in process.stderr.readline()
        assert "stays open until Ctrl-C" in process.stderr.readline()
        browser.get(address)
        ended = f"{pings} of {pings} pings are mapped"
        until(lambda: ended in browser.execute_script("return document.body.innerText"))
        assert counted(browser) == pings
        until(lambda: "voxels occupied" in browser.page_source)
        assert errors(browser) == []
        assert [name for name in fetched(browser) if "//127.0.0.1:" not in name] == []
        browser.get("about:blank")
        process.send_signal(signal.SIGINT)
        _, rest = process.communicate(timeout=60)
    assert process.returncode == 0 and rest.endswith("insonify: closing the view\n")
    run(*words, "--out", "M", code=0)
    assert (tmp_path / "L/map.npz").read_bytes() == (tmp_path / "M/map.npz").read_bytes()


def test_what_is_wrong_is_said_before_an_address(run: Callable[..., str]) -> None:
    assert "no such recording" in run("live", "--from", "nowhere.mcap", "--view", "--out", "X")
    both = run("live", "--view", "--foxglove", "--port", "8000", "--out", "X")
    assert "--port is where" in both
    assert "--port is where" in run("live", "--port", "8000", "--out", "X")
