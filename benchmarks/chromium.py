"""A headless Chromium that reaches nothing but this machine, for pictures and tests of pages."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

DESKTOP, PHONE = (1280, 900), (390, 844)
"""Widths and heights that pages are looked at with, in CSS pixels."""
_PHONE_FROM = 600
_FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--enable-unsafe-swiftshader",
    "--hide-scrollbars",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
)


def missing() -> str:
    """Why there is no browser to be had, or nothing."""
    if shutil.which("chromium") and shutil.which("chromedriver"):
        return ""
    return "needs chromium and chromedriver on the PATH (.ci/run installs them)"


@contextmanager
def chromium(width: int, height: int) -> Iterator[Any]:
    """The browser with a window of some pixels, its console's log kept."""
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    for flag in (*_FLAGS, f"--window-size={width},{height}"):
        options.add_argument(flag)
    options.binary_location = str(shutil.which("chromium"))
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    service = webdriver.ChromeService(executable_path=shutil.which("chromedriver"))
    with webdriver.Chrome(options=options, service=service) as browser:
        yield browser


def resize(browser: Any, size: tuple[int, int], whole: bool = False) -> None:
    """Show a page in a window of a width and height; a narrow one is a phone's.

    Args:
        browser: Of `chromium`.
        size: Width and height, CSS pixels.
        whole: Make the window as high as the page, for a picture of all of it.
    """
    width, height = size
    if whole:
        resize(browser, size)
        height = int(browser.execute_script("return document.documentElement.scrollHeight"))
    browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {
            "width": width,
            "height": height,
            "deviceScaleFactor": 1,
            "mobile": width < _PHONE_FROM,
        },
    )


def scrolls_sideways(browser: Any, width: int) -> bool:
    """Whether a page is wider than the window it was given; a phone's would show it smaller."""
    widest = browser.execute_script("return document.documentElement.scrollWidth")
    return int(widest) > width


def errors(browser: Any) -> list[str]:
    """What a page complained of since it was last asked."""
    found = browser.get_log("browser")
    return [str(entry["message"]) for entry in found if entry["level"] == "SEVERE"]


def fetched(browser: Any) -> list[str]:
    """The addresses that a page has asked for, those it holds itself aside."""
    names = "return performance.getEntriesByType('resource').map(entry => entry.name)"
    return [
        str(name)
        for name in browser.execute_script(names)
        if not name.startswith(("data:", "blob:"))
    ]
