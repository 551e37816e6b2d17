"""What is flown, in which order, by whom: with a crew that flies nothing."""

from __future__ import annotations

import re
from itertools import product
from pathlib import Path
from typing import Any

import numba
import pytest

from insonify.errors import ClusterError, ConfigError
from insonify.mission.campaign import (
    _LISTS,
    CampaignSettings,
    Chain,
    chains,
    factors,
    read_campaign,
    run_key,
    with_scans,
)
from insonify.mission.cluster import do_on_worker
from insonify.mission.crew import (
    Failure,
    Landed,
    Outcome,
    Place,
    fly_all,
    fly_run,
    known_runs,
    pin_kernels,
)
from insonify.mission.result import ScanResult, ScanRow
from insonify.mission.setup import Config, scenario_config
from insonify.types import StopReason

METRICS = {"solid": {"exact": {"f1": 0.5}}}


def _result(config: Config, scans: int = 4) -> ScanResult:
    row = ScanRow(scan=scans, pings=9, path_m=3.0, total_entropy_bits=1.0, metrics=METRICS)
    return ScanResult(
        scenario=config.scenario, planner=config.planner, mapper=config.mapper, seed=config.seed,
        scans=scans, pings=9, path_m=3.0, stop_reason=StopReason.PLAN_FLOWN, metrics=METRICS,
        history=(row,), seconds={},
    )  # fmt: skip


class _Crew:
    """Flies nothing; answers the last run it was given first."""

    def __init__(self, room: int, fail: str = "") -> None:
        self.most, self.fail = room, fail
        self.waiting: list[tuple[Place, Config]] = []
        self.flown: list[Config] = []

    def room(self) -> int:
        return self.most - len(self.waiting)

    def take(self, place: Place, config: Config) -> None:
        self.waiting.append((place, config))
        self.flown.append(config)

    def landed(self) -> list[tuple[Place, Outcome]]:
        place, config = self.waiting.pop()
        if config.planner == self.fail:
            return [(place, Failure("no"))]
        return [(place, _result(config, scans=10 + config.seed))]

    def __enter__(self) -> _Crew:
        return self

    def __exit__(self, *raised: object) -> None:
        pass


def _plan(**told: Any) -> tuple[Chain, ...]:
    return chains(CampaignSettings.model_validate({"scenarios": ["tetrapod"], **told}))


def test_all_combinations_in_order_the_planners_last() -> None:
    plan = _plan(
        scenarios=["tetrapod", "wreck"], models=["cerqueira", "physical"], seeds=[3, 1],
        sonars=["park-2025", "gemini-720i"], planners=["uniform", "entropy"],
        navigation=["none", "dvl"], set={"vehicle": {"name": "bluerov2"}},
    )  # fmt: skip
    told = [factors(run) for one in plan for run in one.runs]
    keys = ("scenario", "sonar", "model", "navigation", "seed", "planner")
    expected = product(
        ("tetrapod", "wreck"), ("park-2025", "gemini-720i"), ("cerqueira", "physical"),
        ("none", "dvl"), (3, 1), ("entropy", "uniform"),
    )  # fmt: skip
    assert [tuple(row[key] for key in keys) for row in told] == list(expected)


def test_noise_is_of_the_runs_without_a_vehicle_alone() -> None:
    vehicle = {"name": "bluerov2", "pose_noise": {"position_m": 0.05}}
    plan = _plan(seeds=1, navigation=["none", "noise", "dvl"], set={"vehicle": vehicle})
    runs = [run for one in plan for run in one.runs]
    assert [factors(run)["navigation"] for run in runs] == ["none", "noise", "dvl"]
    assert [run.vehicle.pose_noise.position_m for run in runs] == [0.0, 0.05, 0.0]
    with pytest.raises(ConfigError, match="needs poses that are off"):
        _plan(navigation=["noise"])
    with pytest.raises(ConfigError, match="pose_noise is for scans without a vehicle"):
        _plan(set={"vehicle": vehicle})


def test_a_campaign_of_one_run_is_that_run() -> None:
    ((run,),) = (one.runs for one in _plan(seeds=[2], set={"mapping": {"voxel_m": 0.25}}))
    assert run == scenario_config("tetrapod", [{"mapping": {"voxel_m": 0.25}, "seed": 2}])


def test_settings_for_some_lie_on_those_of_all_and_on_a_sonars() -> None:
    plan = _plan(
        scenarios=["tetrapod", "wreck"], sonars=["gemini-720i"], planners=["uniform"], seeds=1,
        set={"sonar": {"beams": 60}, "survey": {"waypoints": 9}},
        set_for={"wreck": {"survey": {"waypoints": 7}}, "uniform": {"entropy": {"candidates": 3}}},
    )  # fmt: skip
    tetrapod, wreck = (one.runs[0] for one in plan)
    assert (tetrapod.survey.waypoints, wreck.survey.waypoints) == (9, 7)
    assert {tetrapod.sonar.beams, wreck.sonar.beams} == {60}
    assert tetrapod.sonar.name == "gemini-720i" and wreck.entropy.candidates == 3


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ({"scenarios": ["tetrapot"]}, "did you mean 'tetrapod'"),
        ({"planners": ["entropie"]}, "did you mean 'entropy'"),
        ({"planners": ["nowhere.py:Mine"]}, "no such file"),
        ({"mappers": ["beyes"]}, "did you mean 'bayes'"),
        ({"sonars": ["gemini"]}, "no sonar named 'gemini'"),
        ({"models": ["sigmoid"]}, "'cerqueira' or 'physical', not 'sigmoid'"),
        ({"navigation": ["dvl"]}, "navigation 'dvl' needs a vehicle"),
        ({"set": {"vehicle": {"name": "submarine"}}}, "'submarine'"),
        ({"set": {"maping": {"voxel_m": 1}}}, "maping"),
        ({"set": {"seed": 1}}, "set.seed: the campaign's seeds choose it"),
        ({"set": {"scenario": "wreck"}}, "set.scenario: the campaign's scenarios choose it"),
        ({"planners": ["uniform"], "set_for": {"uniform": {"planner": "x"}}}, "set_for.uniform.pl"),
        ({"sonars": ["park-2025"], "set": {"sonar": {"preset": "x"}}}, "set.sonar: .* sonars"),
        ({"set_for": {"wreck": {}}}, "set_for.wreck: nothing of that name is in the campaign"),
        ({"planners": ["uniform", "uniform"]}, "two runs would both be .*planner uniform"),
        ({"seeds": [1, 1]}, "two runs would both be .*seed 1; name each thing once"),
    ],
)
def test_a_wrong_campaign_is_refused_before_anything_is_flown(
    told: dict[str, Any], words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        _plan(**told)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("scenario = ['tetrapod']", "there is no setting 'scenario'; did you mean 'scenarios'"),
        ("seeds = 3", "setting scenarios: field required"),
        ("scenarios = ['wreck']\nseeds = 0", "setting seeds: should be how many seeds"),
        ("scenarios = ['wreck']\nseeds = 'x'", "setting seeds: .* or a list of them, not 'x'"),
        ("scenarios = ['wreck']\nnavigation = ['gps']", "'noise', 'truth' or 'dvl', not 'gps'"),
        ("scenarios = [", "cannot be read as TOML"),
    ],
)
def test_a_wrong_file_is_named(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "c.toml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=f"c.toml: .*{words}"):
        read_campaign(file)


def test_the_campaign_in_the_docs_is_one(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs/campaigns.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"```toml\n(.*?)```", page, re.S)
    (tmp_path / "c.toml").write_text(text)
    told = read_campaign(tmp_path / "c.toml")
    assert told.seeds == tuple(range(10)) and all(getattr(told, key) for key in _LISTS)
    known = told.model_copy(update={"mappers": ("bayes",), "set_for": {}})
    assert sum(len(one.runs) for one in chains(known)) == 10 * 2 * 3 * 2 * 1 * 2


def test_files_are_looked_for_beside_the_campaign(tmp_path: Path) -> None:
    for name in ("mine.py", "ball.stl", "mine.toml"):
        (tmp_path / name).touch()
    (tmp_path / "c.toml").write_text(
        "scenarios = ['wreck']\nplanners = ['mine.py:Mine']\nsonars = ['mine.toml']\n"
        "[set.object]\nmesh = 'ball.stl'\n[set_for.'mine.py:Mine'.planner_options]\nscans = 3\n"
    )
    told = read_campaign(tmp_path / "c.toml", [{"object": {"scale": 2.0}}])
    mine = f"{tmp_path}/mine.py:Mine"
    assert told.planners == (mine,) and told.sonars == (f"{tmp_path}/mine.toml",)
    assert told.set == {"object": {"mesh": f"{tmp_path}/ball.stl", "scale": 2.0}}
    assert told.set_for == {mine: {"planner_options": {"scans": 3}}}


def test_a_run_is_known_by_its_settings_and_the_files_that_they_name(tmp_path: Path) -> None:
    mesh = tmp_path / "ball.stl"
    mesh.write_bytes(b"one")
    config = scenario_config("tetrapod", [{"object": {"mesh": str(mesh)}}])
    key = run_key(config)
    assert key == run_key(config.model_copy())
    assert key != run_key(config.model_copy(update={"seed": 1}))
    assert key != run_key(with_scans(config, 4))
    mesh.write_bytes(b"another")
    assert key != run_key(config)


@pytest.mark.parametrize("room", [1, 3, 100])
def test_fixed_plans_get_as_many_scans_as_entropy_took(room: int) -> None:
    plan = _plan(planners=["lawnmower", "entropy", "uniform"], seeds=3)
    crew = _Crew(room)
    landed = {one.place: one for one in fly_all(plan, crew)}
    assert len(landed) == len(crew.flown) == 9
    for (number, _), one in landed.items():
        scans = 10 + plan[number].runs[0].seed
        fixed = one.config.planner != "entropy"
        assert one.config.survey.baseline_scans == (scans if fixed else 3)
    # a run is the same, and known by the same key, whoever flies it
    again = {run_key(one.config) for one in fly_all(plan, _Crew(2))}
    assert again == {run_key(one.config) for one in landed.values()}


def test_without_entropy_nothing_waits_and_the_settings_say_how_many() -> None:
    plan = _plan(planners=["lawnmower", "uniform"], seeds=1)
    assert [one.config.survey.baseline_scans for one in fly_all(plan, _Crew(9))] == [3, 3]


def test_fixed_plans_may_keep_their_own_number_of_scans() -> None:
    plan = _plan(planners=["entropy", "uniform"], seeds=1, same_scans=False)
    assert plan[0].following == ()
    scans = {
        one.config.planner: one.config.survey.baseline_scans for one in fly_all(plan, _Crew(1))
    }
    assert scans == {"entropy": 3, "uniform": 3}


def test_runs_that_are_known_are_not_flown_again() -> None:
    plan = _plan(planners=["entropy", "uniform"], seeds=4)
    known: dict[str, ScanResult] = {}

    def flown(until: int) -> list[Landed]:
        crew = _Crew(1)
        found: list[Landed] = []
        for one in fly_all(
            plan, crew, lambda run: known.get(run_key(run)), lambda: len(found) >= until
        ):
            assert isinstance(one.outcome, ScanResult)
            found.append(one)
            known[run_key(one.config)] = one.outcome
        assert len(crew.flown) == sum(not one.known for one in found)
        return found

    assert [one.known for one in flown(3)] == [False] * 3
    there = list(known_runs(plan, lambda run: known.get(run_key(run))))
    assert len(there) == 3
    assert {one.known for one in flown(8)} == {True, False}
    assert all(one.known for one in flown(8))


def test_what_waits_for_a_run_that_failed_fails_and_the_rest_does_not() -> None:
    plan = _plan(planners=["entropy", "uniform"], scenarios=["tetrapod", "wreck"], seeds=1)
    outcomes = [one.outcome for one in fly_all(plan, _Crew(2, fail="entropy"))]
    assert len(outcomes) == 4 and all(isinstance(one, Failure) for one in outcomes)
    told = [one.message for one in outcomes if isinstance(one, Failure)]
    assert told.count("entropy, whose number of scans uniform takes, failed") == 2
    other = [one.outcome for one in fly_all(plan, _Crew(2, fail="uniform"))]
    assert sum(isinstance(one, ScanResult) for one in other) == 2


def test_kernels_of_a_worker_are_pinned_to_its_share() -> None:
    before = numba.get_num_threads()
    try:
        pin_kernels(1)
        assert numba.get_num_threads() == 1
        pin_kernels(100_000)
        assert numba.get_num_threads() == before
    finally:
        numba.set_num_threads(before)


def test_a_worker_of_another_version_flies_nothing() -> None:
    config = scenario_config("tetrapod")
    with pytest.raises(ClusterError, match=r"a worker has insonify .* here is insonify 9.9;"):
        do_on_worker(fly_run, config, "9.9")
