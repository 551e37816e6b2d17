"""A user's own planner and mapper by name: found, made, refused in one sentence."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from insonify.errors import ConfigError
from insonify.io.maps import load_map
from insonify.mapping.factory import make_mapper
from insonify.mapping.mapper import Mapper, MappingSettings
from insonify.mission.setup import scenario_config
from insonify.planning.factory import Task, make_planner
from insonify.planning.once import plan_next
from insonify.results.map import load_mapper
from insonify.sonar.devices import SonarDevice
from insonify.types import Box, Pose

pytestmark = pytest.mark.slow

QUICK = ["--set", "mapping.voxel_m=0.25", "--set", "survey.waypoints=6"]
OWN = '''
import numpy as np
from insonify import BayesMapper, Decision, StopReason

class Still:
    name = "still"
    def __init__(self, area, geometry, scans=0):
        self.scans = scans
    def next_scan(self, belief, nav):
        return Decision(stop=StopReason.PLAN_FLOWN)

class Counting(BayesMapper):
    """Keeps a state of its own: how many pings and scans it has seen."""
    name = "counting"
    pings = scans = 0
    def integrate(self, ping, pose):
        super().integrate(ping, pose)
        self.pings += 1
    def finish_scan(self):
        self.scans += 1
    def save(self):
        return {"count": np.array([self.pings, self.scans])}
    def load(self, arrays):
        if "count" in arrays:
            self.pings, self.scans = arrays["count"].tolist()
    def tells(self, poses, geometry, voxels_m):
        return 0.0 * super().tells(poses, geometry, voxels_m)

class Lame:
    name = "lame"
    def __init__(self, *given):
        pass
'''


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "own.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    return tmp_path


def _run(cwd: Path, *words: str) -> Any:
    done = subprocess.run(
        [sys.executable, "-m", "insonify", *words, "--json"],
        cwd=cwd, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def _task() -> Task:
    from insonify.planning.decision import SurveyArea

    area = SurveyArea(Box((-1, -1, 0), (1, 1, 1)), 2.0, 0.0, 1.0, 1.0, 4)
    return Task(area, SonarDevice().geometry)


def test_by_file_and_by_module_with_options(own: Path) -> None:
    for name in ("own.py:Still", f"{own}/own.py:Still", "own:Still"):
        planner: Any = make_planner(name, _task(), {"scans": 3})
        assert (planner.name, planner.scans) == ("still", 3)
    mapper = make_mapper("own.py:Counting", MappingSettings(voxel_m=0.5))
    assert isinstance(mapper, Mapper)
    assert mapper.voxels.voxel_m == 0.5


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("entrop", {}, "no planner named 'entrop'; did you mean 'entropy'"),
        ("nonesuch", {}, "choose one of entropy, lawnmower, uniform, or give your own"),
        ("none.py:Still", {}, "no such file as none.py"),
        ("nonesuch_module:Still", {}, "no module of that name"),
        ("own.py:Stil", {}, "no class 'Stil'; did you mean 'Still'"),
        ("own.py:Still", {"scan": 1}, "cannot be made .*'scan'"),
        ("own.py:Lame", {}, "lacks next_scan"),
        ("entropy", {"scans": 1}, "planner_options are for a planner of your own"),
    ],
)
def test_what_is_no_planner_is_one_sentence(
    own: Path, name: str, options: dict[str, Any], words: str
) -> None:
    with pytest.raises(ConfigError, match=words) as caught:
        make_planner(name, _task(), options)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("bays", "no mapper named 'bays'; did you mean 'bayes'"),
        ("own.py:Lame", "lacks voxels, integrate, finish_scan, tells, save, load"),
        ("own.py:", "no class ''"),
    ],
)
def test_what_is_no_mapper_is_one_sentence(own: Path, name: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        make_mapper(name, MappingSettings())


def test_a_fault_in_the_users_own_code_keeps_its_traceback(own: Path) -> None:
    (own / "broken.py").write_text(
        "class A:\n    def __init__(self, area, sonar):\n        len(3)\n"
    )
    with pytest.raises(TypeError, match="has no len"):
        make_planner("broken.py:A", _task())
    (own / "missing.py").write_text("import a_module_that_is_not_there\n")
    with pytest.raises(ModuleNotFoundError, match="a_module_that_is_not_there"):
        make_planner("missing:A", _task())


def test_a_wrong_name_is_told_before_any_work() -> None:
    with pytest.raises(ConfigError, match="no mapper named 'carvin'"):
        scenario_config("tetrapod", [{"mapper": "carvin"}])


def test_a_mapper_of_ones_own_in_scan_map_and_plan(own: Path) -> None:
    """Its state is kept beside the map, and a planner asks it what a look would tell."""
    scanned = _run(own, "scan", "tetrapod", *QUICK, "--mapper", "own.py:Counting", "--out", "s")
    assert scanned["mapper"] == "counting"
    mapped = _run(
        own, "map", "s/recording.mcap", "--mapper", "own.py:Counting", "--voxel", "0.25",
        "--out", "m",
    )  # fmt: skip
    assert (mapped["mapper"], mapped["pings"]) == ("counting", scanned["pings"])
    again: Any = load_mapper(own / "s")
    assert (again.pings, again.scans) == (scanned["pings"], scanned["scans"])
    remapped: Any = load_mapper(own / "m")
    assert (remapped.pings, remapped.scans) == (scanned["pings"], 1)
    assert (load_map(own / "s").log_odds == load_map(own / "m").log_odds).all()
    config = scenario_config("tetrapod", [{"mapping": {"voxel_m": 0.25}}])
    pose = Pose(5.0, 5.0, -15.0)
    region = Box.of(*scanned["region_m"])
    decision = plan_next(again, config.sonar.geometry, region, pose, config.entropy, 6)
    assert decision.look is not None and decision.look.h_sum.max() == 0.0
    planned = _run(own, "plan", "s", "--from", "5 5 -15 0", "--out", "p")
    assert planned["best_share"] == 0.0


def test_a_saved_config_with_an_own_planner_runs_again_from_elsewhere(own: Path) -> None:
    (own / "below").mkdir()
    first = _run(own, "scan", "tetrapod", *QUICK, "--planner", "own.py:Still", "--out", "a")
    again = _run(own / "below", "scan", "--config", "../a/config.toml", "--out", "b")
    assert first | {"seconds": 0} == again | {"seconds": 0}
