"""Every command of the README and the docs, as it is written there.

All are parsed by the command line.  Those that can be are run, page by page in the order of the
page, in a folder with the files that the page shows and small ones of a reader's own; what makes a
command small is put behind it, where the last one counts.  ``python -m benchmarks.pages --not-run``
lists the others with the reason.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import sys
import threading
import time
import tomllib
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from functools import cache
from importlib.util import find_spec
from io import StringIO
from itertools import pairwise
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
import trimesh
import typer
from benchmarks.pages import ROOT, Block, Command, blocks, in_words, pages

from insonify.cli import app, main, views
from insonify.mission.campaign import read_campaign

GROUP: Any = typer.main.get_command(app)
PAGES = [page for page in pages() if page.parent.name != "reference"]
DATA = ROOT.parent / "shared/data/recordings"

COARSE = "--set mapping.voxel_m=0.4 --set survey.waypoints=4 --set entropy.max_scans=1"
SMALL = {
    "scan": f"{COARSE} --set rosette.pings=8 --set information.pings=8 --set information.path_m=20",
    "compare": f"{COARSE} --set survey.baseline_scans=1 --seeds 1",
    "campaign": "--workers 1",
    "dataset": "--count 1 --workers 1 --set sonar.beams=32 --set sonar.bins=64 --force",
    "simulate": "--set sonar.bins=128 --force",
    "map": "--voxel 0.4",
    "plan": "--set entropy.termination=0",
    "view": "--port 18080",
}
"""What makes a command small, by the command; what is put behind, where the last one counts."""

LONGEST_S = 120.0
"""After so long a page that is served is closed in any case."""

SMALL_FLIGHT = (
    "--set sonar.beams=16 --set sonar.bins=64 --set vehicle.ping_hz=1 "
    "--set survey.approach_m=2 --set survey.overrun_m=0"
)
"""The same of what a vehicle flies."""

NO_SETTINGS = (
    "mapping.factory",
    "sonar.toml",
    "sonar.ping",
    "poses.csv",
    "train.txt",
    "val.txt",
    "test.txt",
)
"""Modules, functions and files whose names begin like a setting's."""

OWNED = ("holoocean_turtle.npz",)
"""Recordings of others that the project may not hand on; who has them has them run."""

WORLD = """<sdf version="1.9"><world name="w">
<model name="block"><static>true</static><pose>6 0 -18 0 0 0</pose><link name="l"><visual name="v">
<geometry><box><size>2 3 2</size></box></geometry></visual></link></model>
<model name="seabed"><static>true</static><pose>0 0 -20 0 0 0</pose><link name="l"><visual name="v">
<geometry><plane><size>80 80</size><normal>0 0 1</normal></plane></geometry></visual></link></model>
</world></sdf>"""

MANY = """scenarios = ["tetrapod"]
planners = ["uniform", "lawnmower"]
seeds = 2
[set]
mapping.voxel_m = 0.4
survey.waypoints = 4
survey.baseline_scans = 1
"""


def _name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def _parse(words: list[str]) -> None:
    program, *rest = words
    assert program in ("insonify", ".venv/bin/insonify"), words
    if rest in (["--help"], ["--version"]):
        return
    command = GROUP.commands[rest[0]]
    if "--help" not in rest:
        command.make_context(rest[0], rest[1:])


@pytest.mark.parametrize("page", PAGES, ids=_name)
def test_every_command_parses(page: Path) -> None:
    for block in blocks(page):
        for command in block.commands():
            words = command.words
            if words[0].endswith("insonify"):
                _parse(words[: words.index(">")] if ">" in words else words)
            if words[:2] == ["python", "-m"]:
                source = ROOT / f"{words[2].replace('.', '/')}.py"
                assert source.is_file() or find_spec(words[2]), command.text
                for option in [word for word in words[3:] if word.startswith("--")]:
                    assert f'"{option}"' in source.read_text("utf-8"), command.text
    for text in in_words(page):
        words = shlex.split(re.sub(r"(?<= )[A-Z](?= |$)", "1", text))
        if len(words) == 2:  # a command's name, not what one types
            assert words[1] == "--help" or words[1] in GROUP.commands, text
        else:
            _parse(words)


def test_every_extra_that_pip_is_told_is_there() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    for page in PAGES:
        for told in re.findall(r"pip install '[\w.]+\[([\w,-]+)\]'", page.read_text("utf-8")):
            assert set(told.split(",")) <= {*project["optional-dependencies"], "EXTRA"}, page.name


def test_every_table_of_settings_is_toml() -> None:
    shown = [block for page in PAGES for block in blocks(page) if block.language == "toml"]
    assert len(shown) >= 5
    for block in shown:
        tomllib.loads(block.text)


def test_what_is_not_run_says_why() -> None:
    told = [command for page in PAGES for block in blocks(page) for command in block.commands()]
    run = [command for command in told if not command.not_run]
    assert len(run) >= 50
    for command in told:
        assert not command.not_run or len(command.not_run) > 10, command.text


class Desk:
    """A reader's folder: files appear when a command names them, as if they had been there."""

    def __init__(self, folder: Path, made: Callable[[str], Path | None]) -> None:
        self.folder, self.made = folder, made

    def lay(self, words: list[str]) -> None:
        """What the words name and is not there, what they make aside."""
        made = {after for word, after in pairwise(words) if word in ("--out", "--picture", ">")}
        made |= set(words[3:4]) if words[1:2] == ["export"] else set()
        for word in set(words) - made:
            name = word.split(":")[0]
            if re.fullmatch(r"[\w./-]+", name) and not (self.folder / name).exists():
                source = self.made(name)
                if source is not None:
                    (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
                    copy = shutil.copytree if source.is_dir() else shutil.copyfile
                    copy(source, self.folder / name)


@contextmanager
def _as_a_process(words: list[str]) -> Iterator[None]:
    """What the command line changes in its process, set back."""
    told, heard = warnings.showwarning, signal.getsignal(signal.SIGINT)
    argv, sys.argv = sys.argv, words
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("default")
            yield
    finally:
        sys.argv, warnings.showwarning = argv, told
        signal.signal(signal.SIGINT, heard)


def _rests(frame: FrameType | None) -> bool:
    """Whether a thread only waits for Ctrl-C in what serves pages."""
    while frame is not None and frame.f_code.co_filename == threading.__file__:
        frame = frame.f_back
    return frame is not None and frame.f_code.co_filename == views.__file__


def _ctrl_c_once_it_waits(done: threading.Event) -> None:
    """Press Ctrl-C when the command only serves its page; at last in any case."""
    here = threading.main_thread().ident or 0
    limit, rested = time.monotonic() + LONGEST_S, 0
    while rested < 3 and time.monotonic() < limit:
        if done.wait(0.05):
            return
        rested = rested + 1 if _rests(sys._current_frames().get(here)) else 0
    os.kill(os.getpid(), signal.SIGINT)


def _insonify(words: list[str], shown: str) -> str:
    """A command line, to its good end; what it printed."""
    done = threading.Event()
    serves = words[1] == "view" or not {"--live", "--view"}.isdisjoint(words)
    if serves:
        threading.Thread(target=_ctrl_c_once_it_waits, args=[done], daemon=True).start()
    out = StringIO()
    try:
        with _as_a_process(words), redirect_stdout(out), pytest.raises(SystemExit) as ended:
            main()
    finally:
        done.set()
    assert (ended.value.code or 0) == 0, f"{shown} ended with {ended.value.code}"
    return out.getvalue()


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path | None]:
    """Files of a reader's own, each made once."""
    home = tmp_path_factory.mktemp("own")

    @cache
    def a_scan() -> Path:
        small = "--set mapping.voxel_m=0.4 --set survey.waypoints=8 --set entropy.max_scans=2"
        words = f"insonify scan tetrapod {small} --out {home / 'scan'}"
        _insonify(words.split(), words)
        return home / "scan"

    @cache
    def a_map(suffix: str) -> Path:
        target = home / f"map{suffix}"
        words = f"insonify export {a_scan()} {target}"
        _insonify(words.split(), words)
        return target

    @cache
    def text(name: str, words: str) -> Path:
        (home / name).write_text(words, "utf-8")
        return home / name

    @cache
    def a_mesh() -> Path:
        trimesh.creation.box((3.0, 2.0, 2.0)).export(home / "box.dae")
        return home / "box.dae"

    @cache
    def a_plugin() -> Path:
        shown = [block for block in blocks(ROOT / "README.md") if "mine.py" in block.marked("file")]
        return text("mine.py", "\n".join(block.text for block in shown))

    @cache
    def a_campaign() -> Path:
        words = f"insonify campaign {text('many.toml', MANY)} --workers 1 --out {home / 'many'}"
        _insonify(words.split(), words)
        return home / "many"

    def make(name: str) -> Path | None:
        makers: dict[str, Callable[[], Path]] = {
            "insonify-runs/tetrapod-entropy-seed0": a_scan,
            "result": a_scan,
            "RESULT": a_scan,
            "result/map.npz": a_scan,
            "dive.mcap": lambda: a_scan() / "recording.mcap",
            "map": a_scan,
            "map.ot": lambda: a_map(".ot"),
            "map.zarr": lambda: a_map(".zarr"),
            "my.world": lambda: text("my.world", WORLD),
            "site.world": lambda: text("site.world", WORLD),
            "my-mesh.dae": a_mesh,
            "mesh.dae": a_mesh,
            "mine.py": a_plugin,
            "many.toml": lambda: text("many.toml", MANY),
            "insonify-runs/many": a_campaign,
            "insonify-runs/mine": a_campaign,
        }
        if name == "result/map.npz":
            return a_scan() / "map.npz"
        recorded = DATA / name
        if name not in makers:
            return recorded if recorded.is_file() else None
        return makers[name]()

    return make


def _run(command: Command, desk: Desk) -> None:
    """A command of a page, or as much of it as can be done here."""
    words = command.words
    if words[:2] == ["insonify", "campaign"] and words[2].endswith(".toml"):
        desk.lay(words)
        if command.not_run:
            read_campaign(ROOT / words[2] if "/" in words[2] else desk.folder / words[2], [])
    if command.not_run or any(name in words and not (DATA / name).is_file() for name in OWNED):
        return
    desk.lay(words)
    if words[0].endswith("insonify"):
        target = words[words.index(">") + 1] if ">" in words else None
        typed = words[: words.index(">")] if target else words
        small = SMALL.get(typed[1], "") if "--help" not in typed else ""
        small += f" {SMALL_FLIGHT}" if "--vehicle" in typed else ""
        told = _insonify(["insonify", *typed[1:], *small.split()], command.text)
        if target:
            (desk.folder / target).write_text(told, "utf-8")
    elif words[0] == "mkdir":
        (desk.folder / words[-1]).mkdir(parents=True, exist_ok=True)
    else:
        pytest.fail(f"{command.block.page}: {command.text}: a command that nothing here runs")


def _python(block: Block, names: dict[str, Any]) -> None:
    """A block of Python, in the names of those before it."""
    if block.code_not_run or block.marked("example"):  # the examples have tests of their own
        return
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        exec(compile(block.text, f"{block.page}:{block.line}", "exec"), names)


def _keys(table: dict[str, Any], above: str = "") -> Iterator[str]:
    for key, value in table.items():
        yield above + key
        if isinstance(value, dict):
            yield from _keys(value, f"{above}{key}.")


def test_every_setting_that_a_page_names_is_there() -> None:
    known: set[str] = set()
    for words in ("tetrapod", "fls-tank", "structures --for dataset", "tank --for fly"):
        told = _insonify(["insonify", "config", *words.split()], words)
        known |= set(_keys(tomllib.loads(told)))
    rooms = {key.split(".")[0] for key in known}
    named = {
        (page.name, key)
        for page in PAGES
        for key in re.findall(
            r"(?:--set |`)([a-z_]+(?:\.[a-z_]+)+)(?==|`)", page.read_text("utf-8")
        )
        if key.split(".")[0] in rooms and key not in NO_SETTINGS
    }
    assert len(named) > 50
    assert [(page, key) for page, key in sorted(named) if key not in known] == []


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page)], ids=_name)
def test_the_commands_of_a_page_run(
    page: Path,
    made: Callable[[str], Path | None],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    desk, names = Desk(tmp_path, made), {"__name__": "docs"}
    for block in blocks(page):
        for name in block.marked("file"):
            with (tmp_path / name).open("a", encoding="utf-8") as file:
                file.write(f"{block.text}\n")
            desk.lay(re.findall(r'"([\w.]+\.py):', block.text))
    for block in blocks(page):
        for first in block.marked("first"):
            words = shlex.split(first)
            desk.lay(words)
            _insonify(words, first)
        if block.language == "python":
            desk.lay(re.findall(r'"([\w./-]+)"', block.text))
            _python(block, names)
        for command in block.commands():
            _run(command, desk)
        for picture in block.marked("picture"):
            assert (tmp_path / picture.split(" = ")[0]).is_file(), picture
