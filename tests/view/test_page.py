"""The page in a real browser, from the real command: no console errors, and the slider works."""

from __future__ import annotations

import http.client
import io
import json
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.chromium import DESKTOP, PHONE, errors, fetched, resize, scrolls_sideways
from PIL import Image

from insonify.errors import MissingExtraError, OutputError
from insonify.mapping.voxels import IN_VIEW, VoxelMap
from insonify.types import Array, Box, FanGeometry, Ping, Pose, PosedPing
from insonify.view.guard import guarded, refusal
from insonify.view.page import Page
from insonify.view.story import Story

pytestmark = pytest.mark.slow

SMALL = ["--set", "mapping.voxel_m=0.25", "--set", "survey.waypoints=8"]
PATIENCE_S = 60.0


@contextmanager
def _command(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    """The command, ended by Ctrl-C when the block ends."""
    line = [sys.executable, "-m", "insonify", *arguments]
    with subprocess.Popen(
        line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            yield process
        finally:
            process.send_signal(signal.SIGINT)
            _, told = process.communicate(timeout=PATIENCE_S)
            assert told.endswith("insonify: closing the view\n")


def _until(what: Callable[[], Any]) -> Any:
    limit = time.monotonic() + PATIENCE_S
    while time.monotonic() < limit:
        found = what()
        if found:
            return found
        time.sleep(0.1)
    pytest.fail(f"waited {PATIENCE_S:g} s in vain")


def _text(browser: Any) -> str:
    return str(browser.execute_script("return document.body.innerText"))


def _canvas(browser: Any) -> Array:
    element = browser.find_element("css selector", "canvas")
    return np.asarray(Image.open(io.BytesIO(element.screenshot_as_png)).convert("RGB"), int)


def _changes(browser: Any, before: Array) -> Array:
    """The canvas, once it differs from what it was and stands still."""
    _until(lambda: _different(before, _canvas(browser)))
    return _settled(browser)


def _settled(browser: Any) -> Array:
    seen = [_canvas(browser)]

    def still() -> bool:
        time.sleep(0.5)
        seen.append(_canvas(browser))
        return not _different(seen[-2], seen[-1])

    _until(still)
    return seen[-1]


def _different(before: Array, now: Array) -> bool:
    return bool((np.abs(now - before).max(axis=2) > 24).mean() > 1e-3)


_SOURCE = "return document.querySelector('[data-image=ping] image').getAttribute('href')"


def _no_errors(browser: Any) -> None:
    assert errors(browser) == []
    assert [name for name in fetched(browser) if "//127.0.0.1:" not in name] == []


def _tick(browser: Any, label: str) -> None:
    box = browser.find_element(
        "xpath", f"//*[normalize-space(text())='{label}']/following::input[@type='checkbox'][1]"
    )
    browser.execute_script("arguments[0].click()", box)


def test_a_run_in_the_browser(tmp_path: Path, browser: Any) -> None:
    from selenium.webdriver.common.keys import Keys

    run = tmp_path / "run"
    command = [sys.executable, "-m", "insonify", "scan", "tetrapod", *SMALL, "--out", str(run)]
    subprocess.run(command, check=True, capture_output=True)
    result = json.loads((run / "result.json").read_text())
    with _command("view", str(run), "--json", "--port", "8190") as process:
        assert process.stdout is not None
        said = json.loads(process.stdout.readline())
        assert said["pings"] == result["pings"]
        browser.get(said["url"])
        _until(lambda: f"ping {said['pings']} of {said['pings']}" in _text(browser))
        assert result["why_stopped"] in _text(browser)
        last = browser.execute_script(_SOURCE)
        assert "14.5° port" in _text(browser) and "14.5° stbd" in _text(browser)
        _until(lambda: len(np.unique(_canvas(browser).reshape(-1, 3) // 32, axis=0)) > 8)
        before = _settled(browser)

        slider = browser.find_element("css selector", "[role=slider]")
        slider.send_keys(*[Keys.ARROW_LEFT] * 6)
        _until(lambda: f"ping {said['pings'] - 6} of {said['pings']}" in _text(browser))
        assert result["why_stopped"] not in _text(browser)
        _until(lambda: browser.execute_script(_SOURCE) != last)
        before = _changes(browser, before)

        _tick(browser, "play")
        _until(lambda: f"ping {said['pings']} of {said['pings']}" in _text(browser))
        _until(
            lambda: not browser.find_element("css selector", "input[type='checkbox']").is_selected()
        )
        before = _settled(browser)
        for label in ("occupied voxels", "true object", "entropy"):
            _tick(browser, label)
            before = _changes(browser, before)
        _no_errors(browser)
    assert process.returncode == 0


def test_a_scan_is_shown_while_it_runs(tmp_path: Path, browser: Any) -> None:
    arguments = ["scan", "tetrapod", *SMALL, "--planner", "uniform", "--live"]
    with _command(*arguments, "--out", str(tmp_path / "run")) as process:
        assert process.stderr is not None
        url = process.stderr.readline().removeprefix("View: ").strip()
        browser.get(url)
        _until(lambda: "All planned scans are flown" in _text(browser))
        _until(lambda: (tmp_path / "run" / "result.json").is_file())
        result = json.loads((tmp_path / "run" / "result.json").read_text())
        count, scans = result["pings"], result["scans"]
        assert f"ping {count} of {count}, scan {scans}" in _text(browser)
        assert "stays open" in process.stderr.readline() + process.stderr.readline()
        _no_errors(browser)
    assert process.returncode == 0


def _story(pings: int) -> Story:
    """Pings of a sonar that goes on by a metre each, over a map of one block."""
    fan = FanGeometry(np.radians(60.0), np.radians(14.0), 16, 40, 0.5, 8.0)
    story, voxels = Story("a story"), VoxelMap(0.25)
    voxels.allocate(np.zeros((1, 3), np.int32))
    voxels.log_odds[:], voxels.seen[:] = 1.0, IN_VIEW
    for k in range(pings):
        image = np.full((40, 16), (k + 1) / (pings + 1), np.float32)
        story.add_ping(PosedPing(Ping(image, fan, time_s=float(k)), Pose(1.0 * k, 0.0, 3.0)))
        story.add_map(voxels, Box((-1.0,) * 3, (3.0,) * 3))
    return story


@pytest.mark.parametrize("size", [DESKTOP, PHONE])
def test_keys_and_both_widths(browser: Any, size: tuple[int, int]) -> None:
    from selenium.webdriver import ActionChains, Keys

    def at(number: int) -> bool:
        return f"ping {number} of 6" in _text(browser)

    page = Page(_story(6), port=8310)
    try:
        resize(browser, size)
        browser.get(page.url)
        assert browser.title == "insonify"
        _until(lambda: at(6))
        for key, number in (
            (Keys.ARROW_LEFT, 5), (Keys.ARROW_LEFT, 4), (Keys.ARROW_RIGHT, 5),
            (Keys.ARROW_RIGHT, 6), (Keys.ARROW_RIGHT, 6),
        ):  # fmt: skip
            ActionChains(browser).send_keys(key).perform()
            _until(partial(at, number))
        ActionChains(browser).send_keys(Keys.SPACE).perform()  # from the start again
        _until(lambda: at(1) or at(2))
        _until(lambda: at(6))
        assert not scrolls_sideways(browser, size[0])
        shown = "return document.querySelector(arguments[0]).getBoundingClientRect().toJSON()"
        boxes = [
            browser.execute_script(shown, what)
            for what in ("[data-legend=viridis]", "[data-legend=magma]", "[data-image=ping]")
        ]
        for box in boxes:
            assert 0 <= box["left"] < box["right"] <= size[0]
        assert max(box["bottom"] for box in boxes[:2]) < size[1], "the legends are below the fold"
        assert max(box["bottom"] for box in boxes[:2]) <= boxes[2]["top"] + 1
        if size == PHONE:  # the scene has a place of its own above
            canvas = browser.execute_script(shown, "canvas")
            assert canvas["height"] > 0.3 * size[1] and canvas["bottom"] <= boxes[0]["top"]
        _no_errors(browser)
    finally:
        browser.get("about:blank")
        page.close()


def test_a_map_that_comes_after_its_ping_is_shown(browser: Any) -> None:
    story = _story(2)
    page = Page(story, port=8330)
    try:
        browser.get(page.url)
        _until(lambda: "512 voxels occupied" in _text(browser))
        voxels = VoxelMap(0.25)
        voxels.allocate(np.zeros((1, 3), np.int32))
        voxels.log_odds[:, :7], voxels.seen[:] = 1.0, IN_VIEW
        story.add_map(voxels, Box((-1.0,) * 3, (3.0,) * 3))
        story.changed()
        _until(lambda: "7 voxels occupied" in _text(browser))
    finally:
        browser.get("about:blank")
        page.close()


def test_a_story_that_is_halved_is_shown_where_it_was(browser: Any) -> None:
    """A session that goes on for days keeps every other ping; the numbers stay the pings'."""
    from selenium.webdriver import ActionChains, Keys

    story = _story(9)
    page = Page(story, port=8340, beside=True)
    try:
        browser.get(page.url)
        _until(lambda: "ping 9 of 9" in _text(browser))
        for _ in range(4):
            ActionChains(browser).send_keys(Keys.ARROW_LEFT).perform()
        _until(lambda: "ping 5 of 9" in _text(browser))
        half = story.halved()
        page.show(half)
        _until(lambda: browser.execute_script(_MOST) == "5")
        assert "ping 5 of 9" in _text(browser)
        ActionChains(browser).send_keys(Keys.ARROW_LEFT).perform()
        _until(lambda: "ping 3 of 9" in _text(browser))
        _no_errors(browser)
    finally:
        browser.get("about:blank")
        page.close()


_MOST = "return document.querySelector('[role=slider]').getAttribute('aria-valuemax')"


def test_the_arrows_leave_the_camera_alone(browser: Any) -> None:
    from selenium.webdriver import ActionChains, Keys

    story = _story(1)
    page = Page(story, port=8320)
    try:
        browser.get(page.url)
        _until(lambda: "a story" in _text(browser) and story.moments)
        before = _settled(browser)
        keys = ActionChains(browser).key_down(Keys.ARROW_LEFT).pause(1.0)
        keys.key_up(Keys.ARROW_LEFT).perform()
        assert not _different(before, _settled(browser))
    finally:
        browser.get("about:blank")
        page.close()


def test_what_the_page_needs_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(OutputError, match=r"cannot be served at 203\.0\.113\.1:8195"):
        Page(Story("nowhere"), host="203.0.113.1", port=8195)
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'insonify\[view\]'"):
        Page(Story("nothing"))


def test_what_is_not_there_is_refused_without_an_address(run: Callable[..., str]) -> None:
    assert "there is no such recording" in run("view", "nothing.mcap")
    assert "mapping.voxel_m" in run("view", ".", "--voxel", "-1")


def test_a_port_in_use_is_passed_over() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        page = Page(Story("next"), port=port)
        page.close()
    assert page.url != f"http://127.0.0.1:{port}"


_READING = """
const done = arguments[arguments.length - 1], socket = new WebSocket(arguments[0], arguments[1]);
let bytes = 0;
socket.binaryType = "arraybuffer";
socket.onmessage = (message) => { bytes += message.data.byteLength; };
socket.onerror = () => done(-1);
socket.onopen = () => setTimeout(() => done(bytes), 1000);
"""


def test_no_other_web_page_can_read_it(browser: Any, tmp_path: Path) -> None:
    """A page of another origin in the same browser, and one that has its name point here."""
    viser = pytest.importorskip("viser")
    (tmp_path / "index.html").write_text("<title>evil</title>")
    elsewhere = partial(SimpleHTTPRequestHandler, directory=str(tmp_path))
    page = Page(Story("secret"), port=8290)
    address = page.url.replace("http", "ws")
    spoken = f"viser-v{viser.__version__}"
    with ThreadingHTTPServer(("127.0.0.1", 0), elsewhere) as evil:
        threading.Thread(target=evil.serve_forever, daemon=True).start()
        try:
            browser.get(f"http://127.0.0.1:{evil.server_address[1]}/index.html")
            assert browser.title == "evil"
            assert browser.execute_async_script(_READING, address, spoken) == -1
            browser.get(page.url)
            assert browser.execute_async_script(_READING, address, spoken) > 1000
        finally:
            evil.shutdown()
            page.close()
    browser.get_log("browser")  # it says that it was refused


@pytest.mark.parametrize(
    ("host", "origin", "answered"),
    [
        ("127.0.0.1:8080", None, True),
        ("127.0.0.1:8080", "http://127.0.0.1:8080", True),
        ("localhost:9000", "http://localhost:9000", True),  # a forwarded port
        ("[::1]:8080", "http://[::1]:8080", True),
        ("192.168.1.7:8080", "https://192.168.1.7:8080", True),
        ("boat.example:8080", "http://boat.example:8080", True),  # --host boat.example
        ("127.0.0.1:8080", "http://evil.example", False),
        ("127.0.0.1:8080", "http://127.0.0.1:3000", False),
        ("127.0.0.1:8080", "null", False),
        ("127.0.0.1:8080", "http://127.0.0.1:8080.evil.example", False),
        ("evil.example:8080", "http://evil.example:8080", False),
        ("127.0.0.1.evil.example", None, False),
        ("[", None, False),
        ("", None, False),
        (None, None, False),
    ],
)
def test_who_is_answered(host: str | None, origin: str | None, answered: bool) -> None:
    assert (refusal(host, origin, "boat.example") == "") == answered


def test_foreign_requests_get_nothing() -> None:
    page = Page(Story("secret"), port=8295)
    port = int(page.url.rpartition(":")[2])
    told = {}
    for host, origin in (
        ("127.0.0.1", None), ("evil.example", None), ("127.0.0.1", "http://evil.example"),
    ):  # fmt: skip
        asked = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
        headers = {"Host": f"{host}:{port}"} | ({"Origin": origin} if origin else {})
        asked.request("GET", "/", headers=headers)
        answer = asked.getresponse()
        told[host, origin] = answer.status, len(answer.read())
        asked.close()
    page.close()
    assert told["127.0.0.1", None][0] == 200
    for foreign in (("evil.example", None), ("127.0.0.1", "http://evil.example")):
        assert told[foreign][0] == 403 and told[foreign][1] < 100


def test_a_server_that_would_answer_all_is_not_started() -> None:
    with pytest.raises(OutputError, match="kept from answering other web pages"), guarded("here"):
        pass
