"""The docs site: it builds without a warning, lists what is public, searches, fetches nothing."""

from __future__ import annotations

import html
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from benchmarks.gallery import pictures
from benchmarks.pages import SHOWN, pages, shown, with_examples

import insonify

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
INTERNAL = {"cli"}
EXAMPLE = re.compile(r"<!-- example: (examples/[\w.]+) -->")
TALLEST_PX = 32_000
PHONE_PX, DESKTOP_PX = 390, 1280


class _Loads(HTMLParser):
    """Addresses that a browser loads with a page."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag in ("script", "img", "iframe", "source"):
            self.found.append(given.get("src") or "")
        if tag == "link" and given.get("rel") in ("stylesheet", "icon", "preload", "preconnect"):
            self.found.append(given.get("href") or "")


class _Code(HTMLParser):
    """Blocks of code as a reader sees them."""

    def __init__(self) -> None:
        super().__init__()
        self.blocks: list[str] = []
        self.inside = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "pre":
            self.blocks.append("")
            self.inside = True

    def handle_endtag(self, tag: str) -> None:
        if tag == "pre":
            self.inside = False

    def handle_data(self, data: str) -> None:
        if self.inside:
            self.blocks[-1] += data


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site as make docs builds it."""
    folder = tmp_path_factory.mktemp("docs")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        capture_output=True, text=True, cwd=ROOT, check=False,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return folder


def test_the_reference_lists_every_public_name_and_room() -> None:
    reference = ROOT / "docs/reference"
    listed = {
        page.name: set(re.findall(r"^::: insonify\.(\w+)", page.read_text("utf-8"), re.M))
        for page in reference.glob("*.md")
    }
    assert listed.pop("index.md") == set(insonify.__all__) - {"__version__"}
    source = Path(insonify.__file__).parent
    parts = {path.stem for path in source.glob("*.py") if not path.name.startswith("__")}
    parts |= {path.parent.name for path in source.glob("*/__init__.py")}
    assert set.union(*listed.values()) == parts - INTERNAL


def test_the_comparison_has_the_figures_of_the_readme() -> None:
    readme = (ROOT / "README.md").read_text("utf-8")
    compared = " ".join((ROOT / "docs/compare.md").read_text("utf-8").split())
    for row, said in (
        (r"against OctoMap [^|]*\| (\d+) times faster", "takes one {}th of its time"),
        (r"Table 1's sonar[^|]*\| (\d+) a second", "{} images a second"),
        (r"\| (\d+ to \d+) times faster, error under 2 %", "{} times faster than the times"),
    ):
        found = re.search(row, readme)
        assert found and said.format(found[1]) in compared, row


def test_the_gallerys_pictures_are_there_and_small() -> None:
    shown = re.findall(r"\((images/[^)]+)\)", (ROOT / "docs/gallery.md").read_text("utf-8"))
    assert set(pictures()) <= set(shown) and len(shown) >= 10
    for image in pictures():
        assert (ROOT / "docs" / image).stat().st_size < 150_000, image


def _shown() -> list[tuple[str, str]]:
    """Page and example of each example that the docs show."""
    return [
        (page.stem, name) for page in pages() for name in EXAMPLE.findall(page.read_text("utf-8"))
    ]


def test_files_that_the_docs_name_are_there() -> None:
    pages = [*(ROOT / "docs").glob("*.md"), *ROOT.glob("*.md")]
    named = {
        (page.name, path)
        for page in pages
        for path in re.findall(
            r"`([\w.]+(?:/[\w.]+)+\.(?:py|toml|jinja))`", page.read_text("utf-8")
        )
        if not path.startswith("views/")  # the folder that docs/datasets.md makes
    }
    assert len(named) > 20
    homes = (ROOT, ROOT / "src", ROOT / "src/insonify")
    assert [(p, f) for p, f in sorted(named) if not any((h / f).is_file() for h in homes)] == []


def test_pages_show_the_examples_as_they_are() -> None:
    assert len(_shown()) >= 8
    for page in pages():
        text = page.read_text("utf-8")
        told = f"{page.name}: python -m benchmarks.pages writes its examples anew"
        assert with_examples(text) == text, told
        assert len(EXAMPLE.findall(text)) == len(SHOWN.findall(text)), page.name


def test_the_built_pages_show_the_examples(site: Path) -> None:
    for page, name in _shown():
        code = _Code()
        code.feed((site / f"{page}.html").read_text("utf-8"))
        assert shown(name).strip() in [text.strip() for text in code.blocks], name


def test_no_page_shows_a_mark_instead_of_what_it_stands_for(site: Path) -> None:
    """Neither built nor read as they are, as on a forge."""
    for page in pages():
        assert not re.search(r"-8<-|^ *:::(?! insonify)", page.read_text("utf-8"), re.M), page
    for page in site.rglob("*.html"):
        text = html.unescape(re.sub(r"<[^>]*>", "", page.read_text("utf-8")))
        assert not re.search(r"-\s*8\s*<\s*-|::: insonify", text), page.name
    for name, root in (("contributing", "CONTRIBUTING.md"), ("changelog", "CHANGELOG.md")):
        title = (ROOT / root).read_text("utf-8").splitlines()[0].removeprefix("# ")
        assert f">{title}<" in (site / f"{name}.html").read_text("utf-8")


def test_the_site_loads_nothing_from_elsewhere(site: Path) -> None:
    built = sorted(site.rglob("*.html"))
    assert {"index.html", "sonar.html", "view.html"} <= {page.name for page in built}
    for page in built:
        loads = _Loads()
        loads.feed(page.read_text(encoding="utf-8"))
        assert loads.found
        assert [url for url in loads.found if re.match(r"(https?:)?//", url)] == [], page.name
        if page.name != "404.html":
            missing = [
                u for u in loads.found if u and not (page.parent / u.split("?")[0]).is_file()
            ]
            assert [u for u in missing if not u.startswith("data:")] == [], page.name
    reference = html.unescape((site / "reference/index.html").read_text(encoding="utf-8"))
    for name in ("execute", "open_recording", "Sonar", "VoxelMap"):
        assert str(getattr(insonify, name).__doc__).splitlines()[0] in reference, name


def test_the_search_has_its_index_as_a_script(site: Path) -> None:
    index = (site / "search" / "search_index.js").read_text("utf-8")
    assert index.startswith("var __index = {") and "entropy_map" in index
    for page in site.rglob("*.html"):
        loads = _Loads()
        loads.feed(page.read_text("utf-8"))
        home = site if page.name == "404.html" else page.parent
        workers = [url for url in loads.found if "iframe-worker" in url]
        assert len(workers) == 1 and (home / workers[0].lstrip("/")).is_file(), page.name


@pytest.mark.parametrize("start", ["index.html", "reference/sonar.html"])
def test_the_search_finds_from_a_file(start: str, site: Path, browser: Any) -> None:
    from selenium.webdriver.support.ui import WebDriverWait

    browser.get((site / start).as_uri())
    browser.find_element("css selector", "body").send_keys("/")
    browser.switch_to.active_element.send_keys("entropy_map")
    target = (site / "reference/planning.html").as_uri() + "#insonify.planning.entropy.entropy_map"
    results = "return [...document.querySelectorAll('a.md-search-result__link')].map(a => a.href)"
    # results come while letters do
    WebDriverWait(browser, 30).until(lambda page: target in page.execute_script(results))
    assert all(link.startswith(site.as_uri()) for link in browser.execute_script(results))
    assert [line for line in browser.get_log("browser") if line["level"] == "SEVERE"] == []


def test_pages_fit_a_phone_and_a_desktop(site: Path, browser: Any) -> None:
    """No page scrolls sideways or without end, and none complains."""
    sizes = "const e = document.documentElement; return [e.scrollWidth, e.scrollHeight]"
    for width in (PHONE_PX, DESKTOP_PX):
        screen = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
        try:
            for page in sorted(site.rglob("*.html")):
                if page.name == "404.html":  # its addresses are those of a server's root
                    continue
                browser.get(page.as_uri())
                wide, tall = browser.execute_script(sizes)
                assert wide <= width and tall <= TALLEST_PX, (page.name, wide, tall)
                log = browser.get_log("browser")
                assert [line for line in log if line["level"] == "SEVERE"] == [], page.name
        finally:
            browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
