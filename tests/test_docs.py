"""The docs site: it builds without a warning, lists all that is public, and fetches nothing."""

from __future__ import annotations

import html
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import insonify

ROOT = Path(__file__).parents[1]
INTERNAL = {"cli"}


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


def test_the_reference_lists_every_public_name_and_room() -> None:
    pages = [(ROOT / "docs" / name).read_text("utf-8") for name in ("reference.md", "rooms.md")]
    names, rooms = (set(re.findall(r"^::: insonify\.(\w+)", page, re.M)) for page in pages)
    assert names == set(insonify.__all__) - {"__version__"}
    source = Path(insonify.__file__).parent
    parts = {path.stem for path in source.glob("*.py") if not path.name.startswith("__")}
    parts |= {path.parent.name for path in source.glob("*/__init__.py")}
    assert rooms == parts - INTERNAL


def test_examples_are_shown_from_their_first_import() -> None:
    shown = 0
    for page in (ROOT / "docs").glob("*.md"):
        for name, line in re.findall(r'"(examples/[\w.]+):(\d+)"', page.read_text("utf-8")):
            lines = (ROOT / name).read_text("utf-8").splitlines()
            first = next(k for k, text in enumerate(lines, 1) if text.startswith("import"))
            assert int(line) == first, f"{page.name}: {name}"
            shown += 1
    assert shown >= 5


def test_the_site_builds_and_loads_nothing_from_elsewhere(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)],
        capture_output=True, text=True, cwd=ROOT, check=False,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    pages = sorted(tmp_path.glob("*.html"))
    assert {"index.html", "reference.html", "rooms.html", "view.html"} <= {p.name for p in pages}
    for page in pages:
        loads = _Loads()
        loads.feed(page.read_text(encoding="utf-8"))
        assert loads.found
        assert [url for url in loads.found if re.match(r"(https?:)?//", url)] == [], page.name
        if page.name != "404.html":
            missing = [u for u in loads.found if u and not (tmp_path / u.split("?")[0]).is_file()]
            assert [u for u in missing if not u.startswith("data:")] == [], page.name
    reference = html.unescape((tmp_path / "reference.html").read_text(encoding="utf-8"))
    for name in ("execute", "open_recording", "Sonar", "VoxelMap"):
        assert str(getattr(insonify, name).__doc__).splitlines()[0] in reference, name
