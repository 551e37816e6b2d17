"""Every page as people see it: ``python -m benchmarks.screenshots --out DIR [--run RUN]``.

At a desk and on a phone: the report of a scan, of a campaign and of a map; the view at its first,
middle and last ping; the first page of the docs, if they are built.  Prints for each whether it
scrolls sideways, complains, or asks for anything elsewhere, and how long the view takes to come.
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks.chromium import (
    DESKTOP,
    PHONE,
    chromium,
    errors,
    fetched,
    missing,
    resize,
    scrolls_sideways,
)

SIZES = {"desktop": DESKTOP, "phone": PHONE}
DOCS = Path("build/docs/index.html")
PATIENCE_S = 60.0
_SETTLES_S = 3.0
"""Software draws slowly."""
_ARROW_LEFT, _HOME = "\ue012", "\ue011"
_CAMPAIGN = """
title = "Two planners, two seeds"
scenarios = ["tetrapod"]
planners = ["entropy", "uniform"]
seeds = [0, 1]

[set]
mapping.voxel_m = 0.2
survey.waypoints = 16
"""


def main() -> None:
    """Make all of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder for the pictures")
    parser.add_argument(
        "--run", type=Path, help="result folder of a scan; by default of a tetrapod"
    )
    parser.add_argument("--quick", action="store_true", help="no campaign, no map")
    given = parser.parse_args()
    if missing():
        sys.exit(missing())
    given.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch, chromium(*DESKTOP) as browser:
        made = Path(scratch)
        run = given.run or made / "scan"
        if given.run is None:
            _insonify("scan", "tetrapod", "--out", str(run))
        else:
            _insonify("report", str(run), "--out", str(made / "report.html"))
        report = run / "report.html" if given.run is None else made / "report.html"
        _photograph(browser, report, given.out, "report")
        if not given.quick:
            for name, page in _more(made, run):
                _photograph(browser, page, given.out, name)
        _view(browser, run, given.out)
        if DOCS.is_file():
            _photograph(browser, DOCS.resolve(), given.out, "docs")
        else:
            print(f"docs: {DOCS} is not built (make docs)")


def _more(made: Path, run: Path) -> Iterator[tuple[str, Path]]:
    """The reports of a campaign and of a map."""
    (made / "campaign.toml").write_text(_CAMPAIGN, encoding="utf-8")
    _insonify("campaign", str(made / "campaign.toml"), "--out", str(made / "campaign"))
    yield "campaign", made / "campaign/report.html"
    _insonify("map", str(run / "recording.mcap"), "--out", str(made / "map"))
    yield "map", made / "map/report.html"


def _insonify(*words: str) -> None:
    subprocess.run([sys.executable, "-m", "insonify", *words], check=True, capture_output=True)


def _photograph(browser: Any, page: Path, out: Path, name: str) -> None:
    """A page of a file, all of it."""
    print(f"{name}: {page.stat().st_size / 1e6:.2f} MB")
    for where, size in SIZES.items():
        resize(browser, size)
        browser.get(page.as_uri())
        if browser.find_elements("css selector", "#scene"):
            wait_for(browser, "#scene .gl-container canvas")
        resize(browser, size, whole=True)
        time.sleep(_SETTLES_S)
        _keep(browser, out, f"{name}-{where}", size[0])


def _view(browser: Any, run: Path, out: Path) -> None:
    """The view of a run at its first, middle and last ping."""
    for where, size in SIZES.items():
        resize(browser, size)
        started = time.monotonic()
        with serving(run) as url:
            addressed = time.monotonic()
            browser.get(url)
            wait_for(browser, "[data-image='ping']")
            ready = time.monotonic()
            print(f"view, {where}: address after {addressed - started:.2f} s, ", end="")
            print(f"first sonar image after {ready - started:.2f} s")
            browser.execute_script(
                "document.querySelectorAll('[class*=Notification-close]').forEach(b => b.click())"
            )
            slider = browser.find_element("css selector", "[role=slider]")
            for moment, keys in _moments(browser):
                slider.send_keys(*keys)
                time.sleep(_SETTLES_S)
                _keep(browser, out, f"view-{moment}-{where}", size[0])
            browser.get("about:blank")  # or it would miss its server


def _moments(browser: Any) -> Iterator[tuple[str, list[str]]]:
    """Names of moments, and what to press to come from one to the next."""
    slider = browser.find_element("css selector", "[role=slider]")
    limit = time.monotonic() + PATIENCE_S
    last = 0
    while time.monotonic() < limit:  # until all pings are read
        time.sleep(1.5)
        now = int(slider.get_attribute("aria-valuemax"))
        if now == last:
            break
        last = now
    yield "last", ["\ue010"]
    yield "middle", [_ARROW_LEFT] * (last // 2)
    yield "start", [_HOME]


@contextmanager
def serving(run: Path) -> Iterator[str]:
    """The address of the real command's view, as soon as it is printed."""
    line = [sys.executable, "-m", "insonify", "view", str(run)]
    with subprocess.Popen(line, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        yield process.stderr.readline().split()[1]
        process.send_signal(signal.SIGINT)
        process.wait(PATIENCE_S)


def wait_for(browser: Any, selector: str) -> None:
    """Wait until a page shows something."""
    limit = time.monotonic() + PATIENCE_S
    while not browser.find_elements("css selector", selector):
        if time.monotonic() > limit:
            raise TimeoutError(f"{browser.current_url} shows no {selector}")
        time.sleep(0.05)


def _keep(browser: Any, out: Path, name: str, width: int) -> None:
    browser.save_screenshot(str(out / f"{name}.png"))
    told = ["scrolls sideways"] if scrolls_sideways(browser, width) else []
    told += [f"complains: {message}" for message in errors(browser)]
    here = ("file:", "http://127.0.0.1:")
    told += [f"asks for {name}" for name in fetched(browser) if not name.startswith(here)]
    print(f"  {name}.png: {'; '.join(told) or 'well'}", flush=True)


if __name__ == "__main__":
    main()
