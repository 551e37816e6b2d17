"""A user's own planner and mapper by name: found, made, refused in one sentence."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from insonify.errors import ConfigError
from insonify.io.maps import load_map
from insonify.io.recordings.arrays import save_arrays
from insonify.mapping.bayes import BayesMapper
from insonify.mapping.factory import make_mapper
from insonify.mapping.mapper import Belief, Mapper, MappingSettings
from insonify.mission.comparison import compare
from insonify.mission.run import execute
from insonify.mission.setup import scenario_config
from insonify.planning.decision import Decision
from insonify.planning.factory import Task, make_planner
from insonify.planning.once import plan_next
from insonify.results.map import load_mapper
from insonify.results.scan import run_scan
from insonify.sonar.devices import SonarDevice
from insonify.types import Box, FanGeometry, Nav, Ping, Pose, PosedPing, StopReason

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

class Numbered(Still):
    name = 7

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


def _run(cwd: Path, *words: str, code: int = 0) -> Any:
    done = subprocess.run(
        [sys.executable, "-m", "insonify", *words, "--json"],
        cwd=cwd, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == code, done.stderr
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
        ("nonesuch", {}, "choose one of entropy, information, lawnmower, lawnmower-near, rosette"),
        ("none.py:Still", {}, "no such file as none.py"),
        ("nonesuch_module:Still", {}, "no module 'nonesuch_module'"),
        ("own.py:Stil", {}, "no class 'Stil'; did you mean 'Still'"),
        ("own.py:Still", {"scan": 1}, "cannot be made .*'scan'"),
        ("own.py:Lame", {}, "lacks next_scan"),
        ("own.py:Counting", {}, "lacks next_scan"),
        ("own.py:Numbered", {}, "its name is no text, but 7"),
        (":Still", {}, "planner ':Still': no module's name"),
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
        ("own.py:Lame", "lacks integrate, finish_scan, tells, save, load"),
        ("own.py:", "no class ''"),
    ],
)
def test_what_is_no_mapper_is_one_sentence(own: Path, name: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        make_mapper(name, MappingSettings())


def test_a_fault_in_the_users_own_code_keeps_its_traceback(own: Path) -> None:
    (own / "broken.py").write_text(
        "class A:\n    def __init__(self, area, sonar):\n        len(3)\n"
        "    def next_scan(self, belief, nav): ...\n"
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
    planned = _run(own, "plan", "s", "--from", "5 5 -15 0", "--out", "p", code=3)
    assert planned["best_share"] == 0.0


def test_a_saved_config_with_an_own_planner_runs_again_from_elsewhere(own: Path) -> None:
    (own / "below").mkdir()
    first = _run(own, "scan", "tetrapod", *QUICK, "--planner", "own.py:Still", "--out", "a")
    again = _run(own / "below", "scan", "--config", "../a/config.toml", "--out", "b")
    assert first | {"seconds": 0} == again | {"seconds": 0}


def test_single_settings_name_files_as_options_do(own: Path) -> None:
    (own / "below").mkdir()
    _run(own, "map", _recording(own), "--set", "mapper=own.py:Counting", "--out", "m")
    planned = _run(own / "below", "plan", "../m", "--from", "5 5 -1 0", "--out", "p", code=3)
    assert planned["best_share"] == 0.0
    named = _run(own, "config", "tetrapod", "--set", "planner=own.py:Still")
    assert named["planner"] == f"{own}/own.py:Still"


def _recording(folder: Path) -> str:
    fan = FanGeometry(1.0, 0.2, 6, 8, 0.1, 5.0)
    image = np.zeros((8, 6), np.float32)
    image[5, 2:4] = 1.0
    pings = [PosedPing(Ping(image, fan, float(k)), Pose(0.1 * k, 0.0, -1.0)) for k in range(4)]
    save_arrays(folder / "r.npz", pings)
    return "r.npz"


def test_a_file_may_import_its_neighbour_and_is_run_once(own: Path) -> None:
    (own / "sub").mkdir()
    (own / "sub/helper_of_mine.py").write_text("SCANS = 7\n")
    (own / "sub/own.py").write_text(
        "import helper_of_mine\nfrom pathlib import Path\nlog = Path('ran')\n"
        "log.write_text(log.read_text() + 'x' if log.exists() else 'x')\n"
        "class Still:\n    name = 'sub'\n    def __init__(self, area, sonar):\n"
        "        self.scans = helper_of_mine.SCANS\n    def next_scan(self, belief, nav): ...\n"
    )
    made: list[Any] = [make_planner("sub/own.py:Still", _task()) for _ in range(2)]
    assert [planner.scans for planner in made] == [7, 7]
    assert (own / "ran").read_text() == "x"
    assert make_planner("own.py:Still", _task()).name == "still"  # of the same stem


class _Idle:
    name = "idle"

    def next_scan(self, belief: Belief, nav: Nav) -> Decision:
        return Decision(stop=StopReason.PLAN_FLOWN)


class _Fair(BayesMapper):
    """As long as nothing was mapped, it is empty, and so false."""

    name = "fair"

    def __len__(self) -> int:
        return self.voxels.block_count


def test_objects_are_taken_and_named(own: Path) -> None:
    config = scenario_config(
        "tetrapod", [{"mapping": {"voxel_m": 0.25}, "survey": {"waypoints": 4}}]
    )
    mapper = _Fair(config.mapping)
    run = execute(config, _Idle(), mapper)
    assert run.mapper is mapper and run.result().mapper == "fair"
    assert (run.config.mapper, run.config.planner) == (
        f"{__name__}:_Fair", f"{__name__}:_Idle"
    )  # fmt: skip
    again = execute(config, mapper=BayesMapper(config.mapping), should_stop=lambda: True)
    assert (again.config.mapper, again.config.planner) == ("bayes", "entropy")
    with pytest.raises(ConfigError, match=r"voxels of 0.5 m, and mapping.voxel_m is 0.25"):
        execute(config, mapper=_Fair(MappingSettings(voxel_m=0.5)))
    with pytest.raises(ConfigError, match="is a class; give an object"):
        execute(config, mapper=_Fair)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="planner \"'uniform'\": lacks name, next_scan"):
        execute(config, "uniform")  # type: ignore[arg-type]


@pytest.mark.parametrize("answer", [None, "east"])
def test_an_answer_that_is_no_decision_is_named(answer: Any) -> None:
    class Mute(_Idle):
        def next_scan(self, belief: Belief, nav: Nav) -> Decision:
            return answer  # type: ignore[no-any-return]

    with pytest.raises(ConfigError, match=f"planner 'idle' gave {answer!r}, which is no Decision"):
        execute(scenario_config("tetrapod", [{"mapping": {"voxel_m": 0.25}}]), Mute())


def test_a_file_that_a_planner_misses_is_its_own_fault(own: Path) -> None:
    (own / "w.py").write_text(
        "class W:\n    name = 'w'\n    def __init__(self, area, sonar):\n        open('weights')\n"
        "    def next_scan(self, belief, nav): ...\n"
    )
    config = scenario_config("tetrapod", [{"planner": "w.py:W", "mapping": {"voxel_m": 0.25}}])
    with pytest.raises(FileNotFoundError, match="weights"):
        run_scan(config, own / "out")
    assert not (own / "out").exists()


def test_options_of_ones_own_planner_leave_others_alone(own: Path) -> None:
    options = [{"planner_options": {"scans": 5}, "mapping": {"voxel_m": 0.25}}]
    rows = compare(["tetrapod"], 1, options, ["lawnmower", "own.py:Still"])
    assert [row.planner for row in rows] == ["lawnmower", "own.py:Still"]
    with pytest.raises(ConfigError, match="planner_options are for a planner of your own"):
        compare(["tetrapod"], 1, options, ["lawnmower"])


def test_a_comparison_tells_of_a_wrong_class_before_its_first_run(own: Path) -> None:
    with pytest.raises(ConfigError, match="no class 'Stil'"):
        compare(["tetrapod"], 1, [], ["entropy", "own.py:Stil"], watch=lambda run, step: 1 / 0)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="no class 'Count'"):
        compare(["tetrapod"], 1, [{"mapper": "own.py:Count"}], ["entropy"])


def test_a_key_that_a_map_does_not_know_is_refused(own: Path) -> None:
    _recording(own)
    for text, code in (("[maping]\nvoxel_m = 0.5\n", 2), ("[survey]\nwaypoints = 5\n", 0)):
        (own / "c.toml").write_text(text)
        done = subprocess.run(
            [sys.executable, "-m", "insonify", "map", "r.npz", "--config", "c.toml", "--out", "o"],
            cwd=own, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == code, done.stderr
        assert ("maping" in done.stderr) == (code == 2)
