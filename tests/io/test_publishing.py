"""Results are old or new wherever their process is killed, and nothing of it stays."""

from __future__ import annotations

import errno
import json
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest

import insonify.io.folders
import insonify.io.scratch
from insonify.errors import OutputError
from insonify.io.folders import result_file, result_folder
from insonify.io.maps.sidecar import load_origin

_STEPS = """
import os, shutil, signal, sys
from pathlib import Path
import insonify.io.folders as folders

work, fallback = Path(sys.argv[1]), len(sys.argv) > 2
if fallback:
    def _no(one, other):
        raise OSError(22, "no exchange here")
    folders._rename_exchange = _no

SHAPES = {
    "scan": (["result.json", "map.npz", "report.html", "trajectory.csv"],
             ["result.json", "map.npz", "report.html", "decisions.npz"]),
    "simulate": (["result.json", "pings/0.npz", "pictures/0.png"],
                 ["result.json", "pings/0.npz", "pings/1.npz", "pictures/0.png"]),
    "plan": (["decision.json", "path.csv"], ["decision.json", "path.csv", "path.geojson"]),
}

def fill(folder, names, word):
    for name in names:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(word)

def publish(place, shape):
    with folders.result_folder(place / "out", force=True) as here:
        fill(here.scratch, SHAPES[shape][1], "new")
        armed.append(True)

armed, seen = [], 0
def count(event, given):
    global seen
    if armed and event.split(".")[0] in ("os", "shutil", "open", "ctypes"):
        seen += 1
        if seen == deadline:
            os.kill(os.getpid(), signal.SIGKILL)

deadline = 0
sys.addaudithook(count)
for shape in SHAPES:
    for deadline in range(1, 400):
        place = work / f"{shape}-{deadline:03d}"
        (place / "out" / "mine").mkdir(parents=True)
        (place / "out/mine/notes").write_text("precious")
        fill(place / "out", SHAPES[shape][0], "old")
        child = os.fork()
        if child == 0:
            publish(place, shape)
            os._exit(0)
        if os.waitpid(child, 0)[1] == 0:
            break
    else:
        sys.exit("never done")
"""
_OLD_AND_NEW = {
    "scan": (["result.json", "map.npz", "report.html", "trajectory.csv"],
             ["result.json", "map.npz", "report.html", "decisions.npz"]),
    "simulate": (["result.json", "pings/0.npz", "pictures/0.png"],
                 ["result.json", "pings/0.npz", "pings/1.npz", "pictures/0.png"]),
    "plan": (["decision.json", "path.csv"], ["decision.json", "path.csv", "path.geojson"]),
}  # fmt: skip


def _names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("fallback", [False, True], ids=["exchange", "two renames"])
def test_a_kill_at_any_step_leaves_the_old_or_the_new(tmp_path: Path, fallback: bool) -> None:
    """Every event of the interpreter between the last file written and the end is one step."""
    words = [sys.executable, "-c", _STEPS, str(tmp_path), *(["two"] if fallback else [])]
    subprocess.run(words, check=True, timeout=120)
    found = set()
    for place in sorted(tmp_path.iterdir()):
        shape = place.name.partition("-")[0]
        if not (place / "out").exists():  # two renames leave a moment; the next start ends it
            assert fallback
            with result_folder(place / "out" / ".." / "out", force=True):
                pass
        held = {
            str(file.relative_to(place / "out")): file.read_text()
            for file in (place / "out").rglob("*")
            if file.is_file()
        }
        assert held.pop("mine/notes") == "precious"
        old, new = _OLD_AND_NEW[shape]
        assert held in (dict.fromkeys(old, "old"), dict.fromkeys(new, "new")), place.name
        found.add((shape, next(iter(held.values()))))
        with result_folder(place / "out", force=True) as here:
            (here.scratch / "later").write_text("")
        assert _names(place) == ["out"], "scratch stayed"
    assert len(found) == 6
    assert len(list(tmp_path.iterdir())) > 40


_DYING = """
import os, signal, sys
from pathlib import Path
from insonify.io.folders import result_folder
with result_folder(Path(sys.argv[1]), job=sys.argv[2]) as place:
    (place.scratch / "steps").write_text(int(sys.argv[3]) * "x")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def _die(target: Path, job: str, steps: int) -> None:
    words = [sys.executable, "-c", _DYING, str(target), job, str(steps)]
    assert subprocess.run(words, check=False).returncode == -signal.SIGKILL


def _steps(folder: Path) -> int:
    return len((folder / "steps").read_text())


def test_the_longest_of_the_dead_goes_on_and_all_are_removed(tmp_path: Path) -> None:
    target = tmp_path / "out"
    (tmp_path / ".out-mine").mkdir()  # not ours
    (tmp_path / ".out-2-abcdefgh").mkdir()
    with ExitStack() as together:
        for steps in (3, 7, 5):
            held = together.enter_context(result_folder(target, job="a"))
            (held.scratch / "steps").write_text(steps * "x")
            held.kept = True
    with result_folder(tmp_path / "out", job="b", progress=_steps) as place_b:
        assert place_b.before is None
        place_b.kept = True
    assert len(list(tmp_path.glob(".out-????????"))) == 4, "those of another job stay until the end"
    with result_folder(target, job="a", progress=_steps) as place_a:
        assert place_a.before is not None and _steps(place_a.before) == 7
        with result_folder(target, job="a", progress=_steps) as other:
            assert other.before is None, "what is gone on with is nobody else's"
        (place_a.scratch / "a").write_text("")
    assert _names(tmp_path) == [".out-2-abcdefgh", ".out-mine", "out"]


def test_what_a_killed_process_leaves_is_gone_on_with(tmp_path: Path) -> None:
    target = tmp_path / "out"
    _die(target, "a", 4)
    with result_folder(target, job="a", progress=_steps) as place:
        assert place.before is not None and _steps(place.before) == 4
        (place.scratch / "a").write_text("")
    assert _names(tmp_path) == ["out"]
    _die(tmp_path / "other", "", 4)
    with result_folder(tmp_path / "other") as place:
        assert len(_names(tmp_path)) == 2, "the dead one goes at the start"
    assert _names(tmp_path) == ["out"]


def test_the_folder_one_stands_in_is_not_taken_away(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "out").mkdir()
    monkeypatch.chdir(tmp_path / "out")
    with pytest.raises(OutputError, match="the folder that you are in"), \
            result_folder(Path(), force=True):  # fmt: skip
        pass


def test_a_link_to_a_folder_stays_one_and_modes_stay(tmp_path: Path) -> None:
    real = tmp_path / "real"
    real.mkdir(mode=0o750)
    (tmp_path / "link").symlink_to(real)
    (real / "gone").symlink_to("nowhere")
    with result_folder(tmp_path / "link", force=True) as place:
        (place.scratch / "a").write_text("1")
    assert (tmp_path / "link").is_symlink() and (real / "a").read_text() == "1"
    assert real.stat().st_mode & 0o777 == 0o750
    assert (real / "gone").is_symlink()
    assert _names(tmp_path) == ["link", "real"]


_ORIGINS = {b"old": (1.0, 2.0, 3.0), b"new": (4.0, 5.0, 6.0), b"plain": (0.0, 0.0, 0.0)}


def _publish_map(target: Path, word: bytes) -> None:
    with result_file(target, force=True) as scratch:
        scratch.write_bytes(word)
        if any(_ORIGINS[word]):
            beside = scratch.with_name(f"{scratch.name}.origin.json")
            beside.write_text(json.dumps({"origin_m": _ORIGINS[word]}))


def _broken_off_after(monkeypatch: pytest.MonkeyPatch, steps: int) -> None:
    """Let the next renaming or removing of a map, or of what tells its origin, not happen."""
    left = iter(range(steps))

    def stepping(name: str) -> Callable[..., object]:
        whole = getattr(Path, name)

        def step(self: Path, *given: object, **more: object) -> object:
            counts = self.name not in ("job", "new", "next", "old", "owner")
            if counts and next(left, None) is None:
                raise KeyboardInterrupt
            return whole(self, *given, **more)

        return step

    for name in ("replace", "unlink"):
        monkeypatch.setattr(Path, name, stepping(name))


@pytest.mark.parametrize(
    ("first", "second"),
    [(b"old", b"new"), (b"old", b"plain"), (b"plain", b"new"), (b"", b"new")],
)
def test_a_map_and_its_origin_are_never_of_two(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, first: bytes, second: bytes
) -> None:
    """Whatever step fails, the origin that is read is that of the map that lies there."""
    target, outcomes = tmp_path / "map.bt", set()
    for steps in range(6):
        for path in tmp_path.iterdir():
            path.unlink()
        if first:
            _publish_map(target, first)
        with monkeypatch.context() as patched:
            _broken_off_after(patched, steps)
            try:
                _publish_map(target, second)
                outcomes.add("whole")
            except KeyboardInterrupt:
                outcomes.add("broken off")
        if target.exists():
            assert load_origin(target) == _ORIGINS[target.read_bytes()], steps
        _publish_map(target, second)
        beside = target.with_name(f"{target.name}.origin.json")
        assert load_origin(target) == _ORIGINS[second]
        assert beside.exists() == any(_ORIGINS[second])
        assert "of" not in (json.loads(beside.read_text()) if beside.exists() else {})
    assert outcomes == {"whole", "broken off"}


def test_an_error_of_the_exchange_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "out").mkdir()

    def refused(one: Path, other: Path) -> None:
        raise OSError(errno.EBUSY, "Device or resource busy", str(other))

    monkeypatch.setattr(insonify.io.folders, "_rename_exchange", refused)
    with (
        pytest.raises(OutputError, match="device or resource busy"),
        result_folder(tmp_path / "out", force=True) as place,
    ):
        (place.scratch / "a").write_text("1")
    assert _names(tmp_path) == ["out"] and _names(tmp_path / "out") == []


@pytest.mark.parametrize("killed", [False, True])
def test_two_renames_lose_no_folder_of_a_format(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, killed: bool
) -> None:
    """Where folders cannot change places, for a Zarr group: broken off, or killed, in between."""
    target = tmp_path / "m.zarr"

    def publish(word: str) -> None:
        with result_file(target, force=True) as scratch:
            scratch.mkdir()
            (scratch / "zarr.json").write_text(word)

    def refused(one: Path, other: Path) -> None:
        raise OSError(errno.EINVAL, "no exchange here")

    publish("old")
    whole = Path.rename

    def rename(self: Path, place: Path) -> Path:
        if self.name == "next":
            raise KeyboardInterrupt
        if killed and self.name == "old":
            raise KeyboardInterrupt  # who is killed puts nothing back
        return whole(self, place)

    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(insonify.io.folders, "_rename_exchange", refused)
        patched.setattr(Path, "rename", rename)
        if killed:
            patched.setattr(insonify.io.scratch.Scratch, "remove", lambda self: self.leave())
        publish("new")
    assert target.exists() != killed
    with pytest.raises(OutputError, match="already exists"), result_file(target):
        pass
    assert (target / "zarr.json").read_text() == ("new" if killed else "old")
    assert _names(tmp_path) == ["m.zarr"]
