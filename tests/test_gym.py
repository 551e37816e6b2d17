"""The Gymnasium environment: its checker, its sums, and the maps of the loop that it drives."""

from __future__ import annotations

import math
import subprocess
import sys
import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from insonify.errors import ConfigError
from insonify.gym import ScanEnv
from insonify.mapping.voxels import VoxelMap
from insonify.mission.loop import Pinged, Step
from insonify.mission.run import Run, execute
from insonify.mission.setup import World, scenario_config, scenarios
from insonify.planning.rosette import DISTINCT_LOBES
from insonify.types import Array, Pose

pytestmark = pytest.mark.slow

COARSE = ["mapping.voxel_m=0.25", "sampling.over_elevation=64"]
TABLE = {"mapping": {"voxel_m": 0.25}, "sampling": {"over_elevation": 64}}


def _made(**more: Any) -> ScanEnv:
    env = gymnasium.make("insonify/Tetrapod-v0", settings=COARSE, **more).unwrapped
    assert isinstance(env, ScanEnv)
    return env


def _same(a: VoxelMap, b: VoxelMap) -> None:
    assert np.array_equal(a.coords, b.coords)
    assert np.array_equal(a.log_odds, b.log_odds)
    assert np.array_equal(a.seen, b.seen)


def _rosette(pings: int, mapper: str = "bayes") -> tuple[Run, list[Pose]]:
    poses: list[Pose] = []

    def watch(run: Run, step: Step) -> None:
        if isinstance(step, Pinged) and step.posed.pose is not None:
            poses.append(step.posed.pose)

    layers = {"planner": "rosette", "rosette": {"pings": pings}, "mapper": mapper, "seed": 4}
    return execute(scenario_config("tetrapod", [TABLE, layers]), watch=watch), poses


@pytest.mark.parametrize(
    "more",
    [{}, {"moves": "lobe", "reward": "entropy_per_m", "pings": 20}],
    ids=["pose", "lobe"],
)
def test_gymnasiums_checker_has_nothing_to_say(more: dict[str, Any]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(_made(**more))


def test_every_scenario_has_an_environment() -> None:
    for name in scenarios():
        title = name.title().replace("-", "")
        spec = gymnasium.spec(f"insonify/{title}-v0")
        assert spec.kwargs == {"scenario": name}
    env = gymnasium.make("insonify/Scan-v0", scenario="pipe", settings=[TABLE]).unwrapped
    assert isinstance(env, ScanEnv) and env.action_space.shape == (4,)


def _played(seed: int) -> list[tuple[dict[str, Array], Any]]:
    env = _made(pings=6)
    told: list[tuple[dict[str, Array], Any]] = [env.reset(seed=seed)]
    env.action_space.seed(1)
    for _ in range(6):
        observation, *rest = env.step(env.action_space.sample())
        told.append((observation, tuple(rest)))
    return told


def test_a_seed_and_its_actions_give_the_same_bytes() -> None:
    first, again, other = _played(7), _played(7), _played(8)
    for (a, more), (b, same) in zip(first, again, strict=True):
        assert {k: v.tobytes() for k, v in a.items()} == {k: v.tobytes() for k, v in b.items()}
        assert more == same
    assert any(
        a["image"].tobytes() != b["image"].tobytes()
        for (a, _), (b, _) in zip(first, other, strict=True)
    )


@pytest.mark.parametrize("reward", ["f1", "entropy"])
def test_rewards_add_up_to_what_was_gained(reward: str) -> None:
    env, penalty = _made(reward=reward, pings=25, penalty=0.5), 0.5
    observation, before = env.reset(seed=4)
    total, refused = 0.0, 0
    env.action_space.seed(3)
    _, poses = _rosette(25)
    over, turn = False, 0
    while not over:
        wild = turn % 5 == 4
        action = env.action_space.sample() if wild else env.action_of(poses[turn % 25])
        observation, gain, terminated, truncated, info = env.step(action)
        refused += bool(info["refused"])
        total, over, turn = total + gain, terminated or truncated, turn + 1
    bits = before["entropy_bits"] - info["entropy_bits"]
    gained = {"f1": info["f1"] - before["f1"], "entropy": bits / observation["entropy"].size}
    assert total + penalty * refused == pytest.approx(gained[reward], abs=1e-9)
    assert gained[reward] > 0.001 and terminated and not truncated
    assert observation["left"] == [0.0] and info["pings"] == 25
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(action)


def test_by_the_metre_a_gain_is_divided_by_its_way() -> None:
    whole, by_metre = _made(), _made(reward="f1_per_m")
    _, poses = _rosette(4)
    for env in (whole, by_metre):
        env.reset(seed=4)
    before = 0.0
    for pose in (*poses[:2], poses[1], poses[3]):
        _, gain, _, _, info = whole.step(whole.action_of(pose))
        _, divided, _, _, _ = by_metre.step(by_metre.action_of(pose))
        metres, before = info["path_m"] - before, info["path_m"]
        assert divided == pytest.approx(gain / max(metres, 1.0))


@pytest.mark.parametrize("mapper", ["bayes", "carving"])
def test_lobes_in_turn_make_the_rosettes_own_map(mapper: str) -> None:
    run, _ = _rosette(50, mapper)
    env = gymnasium.make(
        "insonify/Scan-v0", scenario="tetrapod", moves="lobe", pings=50,
        settings=[*COARSE, f"mapper={mapper}"],
    ).unwrapped  # fmt: skip
    assert isinstance(env, ScanEnv)
    env.reset(seed=4)
    terminated, lobe = False, 0
    while not terminated:
        _, _, terminated, truncated, info = env.step(np.int64(lobe % DISTINCT_LOBES))
        lobe += 1
        assert not truncated and info["refused"] == ""
    _same(env.voxels, run.mapper.voxels)
    metrics = run.history[-1].metrics["solid"]["exact"]
    assert info["f1"] == pytest.approx(metrics["f1"])
    assert info["pings"] == run.pings == 50 and info["path_m"] == pytest.approx(run.path_m)


def test_poses_in_turn_make_the_map_of_the_loop() -> None:
    """An action is a pose to the last bit or so; the map is that of the poses themselves."""
    _, poses = _rosette(12)
    env = _made(pings=12)
    env.reset(seed=4)
    world = World(scenario_config("tetrapod", [TABLE, {"seed": 4}]))
    mapper, noise = world.mapper(), np.random.default_rng([4, 2])
    for pose in poses:
        observation, _, terminated, _, info = env.step(env.action_of(pose))
        assert info["refused"] == ""
        ping = world.sonar.ping(world.scene, pose, noise)
        mapper.integrate(ping, pose)
        assert np.abs(observation["image"] - ping.image).max() < 1e-3
    assert terminated
    same = np.isclose(env.voxels.log_odds, mapper.voxels.log_odds, atol=1e-4).mean()
    assert same > 0.9999


def test_what_cannot_be_flown_is_refused_and_the_sonar_stays() -> None:
    env = _made(penalty=0.25)
    env.reset(seed=4)
    _, poses = _rosette(20)
    first = env.step(env.action_of(poses[0]))[0]
    voxels = env.voxels.log_odds.copy()
    beyond, nowhere = np.array([0.0, 0.0, 1.5, 0.0]), np.full(4, math.nan)
    inside = env.action_of(Pose(0.0, 0.0, -19.0))  # of the object
    for action, why in [(beyond, "outside"), (nowhere, "outside"), (inside, "obstacle")]:
        observation, reward, terminated, truncated, info = env.step(action)
        if why == "obstacle" and info["refused"] == "mapped":
            why = "mapped"
        assert (info["refused"], reward, terminated, truncated) == (why, -0.25, False, False)
        assert info["pings"] == 1
        assert all(np.array_equal(observation[key], first[key]) for key in first)
    assert np.array_equal(env.voxels.log_odds, voxels)
    for pose in poses[1:]:
        env.step(env.action_of(pose))
    occupied = env.voxels.occupied_m()
    top = occupied[np.argmax(occupied[:, 2])]
    *_, info = env.step(env.action_of(Pose(*top.tolist())))
    assert info["refused"] == "mapped"


def test_an_episode_of_refusals_is_cut_off_and_one_of_metres_ends() -> None:
    env = _made(pings=3)
    env.reset(seed=0)
    ends = [env.step(np.full(4, 2.0))[2:4] for _ in range(6)]
    assert ends == [(False, False)] * 5 + [(False, True)]
    env = _made(path_m=5.0)
    env.reset(seed=0)
    _, poses = _rosette(20)
    path_m, terminated = 0.0, False
    for pose in poses:
        observation, _, terminated, truncated, info = env.step(env.action_of(pose))
        assert not truncated and terminated == (info["path_m"] >= 5.0)
        path_m = info["path_m"]
        assert observation["left"][0] == pytest.approx(max(0.0, 1 - path_m / 5.0), abs=0.2)
        if terminated:
            break
    assert terminated


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"moves": "walk"}, "moves are pose or lobe, not 'walk'"),
        ({"reward": "f2"}, "reward is one of f1, entropy, f1_per_m, entropy_per_m, not 'f2'"),
        ({"pings": 0}, "budgets above 0"),
        ({"path_m": math.nan}, "budgets above 0"),
        ({"penalty": -1.0}, "penalty is taken off, so 0 or more"),
        ({"settings": ["vehicle.name=bluerov2"]}, "an environment has no vehicle"),
        ({"settings": ["mapping.voxle_m=1"]}, "voxel_m"),
        ({"scenario": "tetrapot"}, "tetrapod"),
    ],
)
def test_what_makes_no_sense_is_one_sentence(more: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        ScanEnv(**more)


def test_before_the_first_reset_there_is_nothing() -> None:
    env = _made()
    for ask in (lambda: env.step(np.zeros(4)), lambda: env.action_of(Pose(0, 0, -15))):
        with pytest.raises(gymnasium.error.ResetNeeded):
            ask()
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.voxels  # noqa: B018


def test_without_gymnasium_only_its_use_says_what_lacks() -> None:
    code = "import sys; sys.modules['gymnasium'] = None; import insonify; insonify.execute\n"
    for more, wanted in [("", 0), ("import insonify.gym\n", 1)]:
        done = subprocess.run(
            [sys.executable, "-c", code + more], capture_output=True, text=True, check=False
        )
        assert done.returncode == wanted, done.stderr
    assert "pip install 'insonify[gymnasium]'" in done.stderr
