"""What can be left out: a clear sentence where it is needed, and nothing lost where it is not."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from insonify.io.recordings.arrays import save_arrays
from insonify.types import FanGeometry, Ping, Pose, PosedPing

pytestmark = pytest.mark.slow

PYPROJECT = Path(__file__).parents[1] / "pyproject.toml"
GROUPS = {
    "simulation": ["embreex", "manifold3d", "collada"],
    "reports": ["matplotlib", "jinja2", "plotly"],
    "recordings": ["mcap", "rosbags", "zstandard", "apsw"],
}


def _without(modules: list[str], *words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """The command in a process in which some modules cannot be imported."""
    code = (
        "import sys\n"
        f"for name in {modules!r}: sys.modules[name] = None\n"
        f"sys.argv = ['insonify', *{list(words)!r}]\n"
        "from insonify.cli import main\n"
        "main()\n"
    )
    return subprocess.run(
        [sys.executable, "-c", code], cwd=cwd, capture_output=True, text=True, check=False
    )


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    rng = np.random.default_rng(3)
    fan = FanGeometry(0.7, 0.2, 8, 16, 0.2, 2.0)
    images = (rng.random((4, 16, 8)) > 0.9).astype(np.float32)
    pings = [
        PosedPing(Ping(image, fan, float(k)), Pose(0.0, 0.1 * k, -2.0))
        for k, image in enumerate(images)
    ]
    save_arrays(tmp_path / "dive.npz", pings)
    return tmp_path / "dive.npz"


def test_without_embree_a_recording_is_mapped_planned_from_and_exported(recording: Path) -> None:
    folder = recording.parent
    mapped = _without(["embreex"], "map", "dive.npz", "--out", "m", "--json", cwd=folder)
    assert mapped.returncode == 0, mapped.stderr
    assert json.loads(mapped.stdout)["occupied_voxels"] > 0
    assert (folder / "m/report.html").is_file()
    for words in (
        ["plan", "m", "--from", "0 0 -2 0", "--clearance", "0", "--out", "p"],
        ["export", "m", "m.bt"],
        ["info", "dive.npz"],
        ["config", "tetrapod"],
    ):
        done = _without(["embreex"], *words, cwd=folder)
        assert done.returncode == 0, done.stderr


def test_without_embree_the_view_opens(recording: Path) -> None:
    """As far as the story; the page itself has tests of its own."""
    code = (
        "import sys; sys.modules['embreex'] = None\n"
        "from pathlib import Path\n"
        "from insonify.io.recordings.recording import Reading\n"
        "from insonify.results.map import MapConfig\n"
        "from insonify.view.sources import open_story\n"
        "import insonify.view.page\n"
        f"told = open_story(Path({str(recording)!r}), Reading(), MapConfig())\n"
        "told.go_on(lambda done, count: None, lambda: False)\n"
        "print(len(told.story.moments))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.stdout, done.returncode) == ("4\n", 0), done.stderr


@pytest.mark.parametrize("module", ["embreex", "manifold3d"])
def test_a_scan_without_what_it_needs_is_one_sentence(module: str, tmp_path: Path) -> None:
    done = _without([module], "scan", "tetrapod", "--out", "o", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    lines = [line for line in done.stderr.splitlines() if "compiling" not in line]
    (line,) = lines
    assert module in line and "pip install 'insonify[simulation]'" in line
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize("module", GROUPS["reports"])
def test_without_reports_a_map_is_whole_and_says_what_lacks(module: str, recording: Path) -> None:
    done = _without([module], "map", "dive.npz", "--out", "m", cwd=recording.parent)
    assert done.returncode == 0, done.stderr
    names = {path.name for path in (recording.parent / "m").iterdir()}
    assert {"map.npz", "map.ply", "result.json"} <= names and "report.html" not in names
    assert f"no report is written: reports and pictures need {module}" in done.stderr
    drawn = _without([module], "info", "dive.npz", "--picture", "p.png", cwd=recording.parent)
    assert drawn.returncode == 2 and "pip install 'insonify[reports]'" in drawn.stderr


@pytest.mark.parametrize("module", GROUPS["recordings"])
def test_without_recordings_arrays_are_mapped_and_bags_say_what_lacks(
    module: str, recording: Path
) -> None:
    folder = recording.parent
    done = _without([module], "map", "dive.npz", "--out", "m", cwd=folder)
    assert done.returncode == 0, done.stderr
    (folder / "dive.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(64))
    bag = _without([module], "info", "dive.mcap", cwd=folder)
    assert bag.returncode == 2
    assert re.search(rf"need {module}, .*pip install 'insonify\[recordings\]'", bag.stderr)


def test_the_groups_come_with_a_plain_install() -> None:
    project = tomllib.loads(PYPROJECT.read_text(encoding="utf-8"))["project"]
    for group in GROUPS:
        assert set(project["optional-dependencies"][group]) <= set(project["dependencies"])


@pytest.mark.parametrize(
    ("module", "extra", "words"),
    [
        ("pyarrow", "campaigns", []),
        ("distributed", "cluster", ["--scheduler", "127.0.0.1:9"]),
    ],
)
def test_a_campaign_says_what_it_lacks_before_it_flies(
    module: str, extra: str, words: list[str], tmp_path: Path
) -> None:
    (tmp_path / "c.toml").write_text('scenarios = ["tetrapod"]\n')
    done = _without([module], "campaign", "c.toml", "--out", "o", *words, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert module in line and f"pip install 'insonify[{extra}]'" in line
    assert not (tmp_path / "o").exists()
