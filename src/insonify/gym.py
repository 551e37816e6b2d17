"""Active scanning as a Gymnasium environment: where to ping next is the action.

``import insonify.gym`` registers ``insonify/Scan-v0``, which takes the arguments of `ScanEnv`, and
one environment for each scenario: ``insonify/Tetrapod-v0``, ``insonify/Wreck-v0``...  World, mapper
and loop are those of ``insonify scan``: an action becomes the answer of its planner.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from insonify.config.layers import parse_setting
from insonify.config.settings import Table
from insonify.errors import ConfigError
from insonify.evaluation import ground_truth, solid_f1
from insonify.extras import require
from insonify.mapping.mapper import Belief, check_voxels
from insonify.mapping.voxels import VoxelMap, VoxelWindow
from insonify.mission.loop import Pinged, Scanned, fly
from insonify.mission.run import carrier_of, check_memory
from insonify.mission.setup import Config, World, scenario_config, scenarios
from insonify.planning.baselines import path_over_centre
from insonify.planning.decision import Decision
from insonify.planning.entropy import entropy_map
from insonify.planning.once import comes_near
from insonify.planning.rosette import DISTINCT_LOBES, RosettePlanner
from insonify.seeds import Stream, generator
from insonify.types import Array, Box, Float64, Nav, Ping, Pose, ScanPath
from insonify.vehicle.settings import TELEPORT

require("gymnasium", "environments", "gymnasium")

import gymnasium  # noqa: E402
from gymnasium import spaces  # noqa: E402

MOVES, REWARDS = ("pose", "lobe"), ("f1", "entropy")
Observation = dict[str, Array]
_SURFACE_M = -0.5
"""Highest place of the sonar, below the water's surface."""
_LEAST_M = 1.0
"""Shorter moves count as so long where a reward is by the metre."""
_MOVES_A_PING = 2
"""An episode is cut off after so many moves for each ping of its budget: refused ones cost none."""


@dataclass(frozen=True, slots=True)
class Reach:
    """Where an action can send the sonar: a box, of which its numbers from -1 to 1 are shares.

    Attributes:
        low_m: The box's low corner.
        high_m: Its high one.
    """

    low_m: Float64
    high_m: Float64

    @classmethod
    def of(cls, world: World) -> Reach:
        """From where a world's sonar can hear its region, or its first scan begins."""
        area, region = world.area, world.area.region
        range_m = world.config.sonar.range_max_m
        beside_m = max(range_m, area.approach_m)
        low, high = np.array(region.low_m), np.array(region.high_m)
        low[:2] -= beside_m
        high[:2] += beside_m
        high[2] = max(min(high[2] + range_m, _SURFACE_M), area.z_m)
        return cls(low, high)

    def pose(self, action: Float64) -> Pose:
        """The pose of an action: shares of x, y, z and of half a turn from east to the left."""
        x, y, z = (self.low_m + (action[:3] + 1.0) / 2.0 * (self.high_m - self.low_m)).tolist()
        return Pose(x, y, z, yaw_rad=float(action[3]) * math.pi)

    def action(self, pose: Pose) -> Float64:
        """The action of a pose."""
        share = 2.0 * (np.array(pose.position_m) - self.low_m) / (self.high_m - self.low_m) - 1.0
        return np.append(share, math.remainder(pose.yaw_rad, math.tau) / math.pi)


class _Asked:
    """A planner that flies the path it was given last."""

    name = "asked"
    path: ScanPath

    def next_scan(self, belief: Belief, nav: Nav) -> Decision:
        return Decision(path=self.path)


class _Episode:
    """A mission whose scans are asked for one by one."""

    def __init__(self, config: Config) -> None:
        self.world = World(config)
        self.mapper = self.world.mapper()
        check_voxels(self.mapper, config.mapping)
        self.truth = ground_truth(self.world.scene, self.world.stage.bodies, config.mapping.voxel_m)
        planner = self.world.planner()
        assert isinstance(planner, RosettePlanner)
        self.rosette, self.reach = planner, Reach.of(self.world)
        self.pose: Pose | None = None
        self.ping: Ping | None = None
        self.pings, self.moves, self.path_m = 0, 0, 0.0
        self._asked, noise = _Asked(), generator(config.seed, Stream.NOISE)
        self._clearance_m, sonar = config.survey.clearance_m, self.world.sonar
        carrier = carrier_of(self.world, lambda true, _: sonar.ping(self.world.scene, true, noise))
        self._steps = fly(carrier, self.mapper, self._asked)

    def hindrance(self, path: ScanPath) -> str:
        """What bars the straight way to a path and along it; nothing if it is free."""
        way = path.waypoints if self.pose is None else (self.pose, *path.waypoints)
        if comes_near(self.mapper.voxels, way, self._clearance_m):
            return "mapped"
        if self.world.scene.first_collision(ScanPath(way), self._clearance_m) is not None:
            return "obstacle"
        return ""

    def fly(self, path: ScanPath) -> None:
        """Ping along a path that nothing bars, and map the pings."""
        self._asked.path = path
        for step in self._steps:
            if isinstance(step, Pinged):
                pose = step.posed.pose
                assert pose is not None
                before = pose if self.pose is None else self.pose
                self.path_m += math.dist(before.position_m, pose.position_m)
                self.pose, self.ping = pose, step.posed.ping
                self.pings += 1
            elif isinstance(step, Scanned):
                return


class ScanEnv(gymnasium.Env[Observation, Array | np.integer[Any]]):
    """One object to be mapped well with few pings.

    Observation, a dictionary:

    - ``occupancy`` and ``entropy``, (nx, ny, nz) float32: of the designated area, p and bits;
    - ``image``, (bins, beams) float32: the last ping, zeros before the first;
    - ``pose``, (4,): where it was, as an action has it; before the first where the order begins;
    - ``left``, (1,) float32: the share of the budget that is left.

    Action, by ``moves``: ``pose``, (4,) from -1 to 1, is the pose of the next ping (see `Reach`),
    to which the sonar goes straight; ``lobe`` is the number of a rosette's lobe, flown whole.

    A move is refused where it leads out of reach (``outside``), nearer than
    ``survey.clearance_m`` to the centre of a voxel that is mapped as occupied (``mapped``), or to
    anything there is (``obstacle``): the sonar stays where it is, nothing is heard, and the reward
    is minus the penalty.

    The episode terminates when the budget of pings or of metres is spent, and is truncated after
    two moves for each ping of the budget, which only those meet whose moves are refused.  ``info``
    has ``f1`` (solid, voxel for voxel), ``entropy_bits``, ``pings``, ``path_m``, ``seed`` and
    ``refused``, the reason or "".
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    def __init__(
        self,
        scenario: str = "tetrapod",
        settings: Iterable[str | Table] = (),
        moves: str = "pose",
        reward: str = "f1",
        pings: int | None = None,
        path_m: float = math.inf,
        penalty: float = 0.01,
    ) -> None:
        """Make ready; the first `reset` builds a world.

        Args:
            scenario: Its name.
            settings: On top of it, each ``KEY=VALUE`` as after ``--set``, or a table as in a
                config file.  The planner that they name is not asked.
            moves: What an action is: ``pose`` or ``lobe``.
            reward: What a move gains: ``f1`` or ``entropy`` (the share of all bits of the area that
                it resolves); or that by the metre of its way, ``f1_per_m`` or ``entropy_per_m``,
                where less than a metre counts as one.
            pings: The budget; by default the rosette's (``rosette.pings``).
            path_m: The other budget, metres.
            penalty: Taken for a move that is refused.

        Raises:
            ConfigError: One of these makes no sense.
            InsonifyError: The config does not make a world that can be scanned.
        """
        layers = [parse_setting(one) if isinstance(one, str) else one for one in settings]
        always: Table = {"planner": "rosette", "planner_options": {}}
        self._config = scenario_config(scenario, [*layers, always])
        self._pings = self._config.rosette.pings if pings is None else pings
        self._path_m, self._penalty = path_m, penalty
        self._moves, self._reward = moves, reward.removesuffix("_per_m")
        self._by_metre = reward.endswith("_per_m")
        self._check(reward)
        world = World(self._config)
        check_memory(world)
        size_m = np.array(world.area.region.size_m)
        self._shape = tuple(np.ceil(size_m / self._config.mapping.voxel_m - 1e-9).astype(int))
        self._episode: _Episode | None = None
        self._over = True
        self.action_space = (
            spaces.Box(-1.0, 1.0, (4,), np.float64)
            if moves == "pose"
            else spaces.Discrete(DISTINCT_LOBES)
        )
        self.observation_space = cast("spaces.Space[Observation]", self._observed())

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin anew in the world of a seed, as ``scan --seed`` has it; by default of another one.

        Args:
            seed: Of seabed, noise and what else the scenario draws.
            options: None are known.

        Returns:
            The observation, and ``info``.
        """
        super().reset(seed=seed)
        drawn = int(self.np_random.integers(1 << 31)) if seed is None else seed
        self._episode = _Episode(self._config.model_copy(update={"seed": drawn}))
        self._over = False
        self._look()
        return self._observation(), self._info("")

    def step(
        self, action: Array | np.integer[Any]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Fly a move, if nothing bars it.

        Returns:
            Observation, reward, whether the budget is spent, whether it was cut off, ``info``.

        Raises:
            gymnasium.error.ResetNeeded: The episode is over, or none was begun.
        """
        episode = self._episode
        if episode is None or self._over:
            raise gymnasium.error.ResetNeeded("the budget is spent: call reset() first")
        worth, metres = self._worth, episode.path_m
        path = self._path(action)
        refused = "outside" if path is None else episode.hindrance(path)
        episode.moves += 1
        gain = -self._penalty
        if path is not None and not refused:
            episode.fly(path)
            self._look()
            gain = self._worth - worth
            if self._by_metre:
                gain /= max(episode.path_m - metres, _LEAST_M)
        terminated = episode.pings >= self._pings or episode.path_m >= self._path_m
        truncated = not terminated and episode.moves >= _MOVES_A_PING * self._pings
        self._over = terminated or truncated
        return self._observation(), gain, terminated, truncated, self._info(refused)

    def action_of(self, pose: Pose) -> Float64:
        """The action that goes to a pose, (4,); roll and pitch are left out.

        Raises:
            gymnasium.error.ResetNeeded: No episode was begun.
        """
        if self._episode is None:
            raise gymnasium.error.ResetNeeded("call reset() first")
        return self._episode.reach.action(pose)

    @property
    def voxels(self) -> VoxelMap:
        """The map so far.

        Raises:
            gymnasium.error.ResetNeeded: No episode was begun.
        """
        if self._episode is None:
            raise gymnasium.error.ResetNeeded("call reset() first")
        return self._episode.mapper.voxels

    def _check(self, reward: str) -> None:
        if self._config.vehicle.name != TELEPORT:
            raise ConfigError(
                f"vehicle.name: an environment has no vehicle, not {self._config.vehicle.name!r}"
            )
        if self._moves not in MOVES:
            raise ConfigError(f"moves are {' or '.join(MOVES)}, not {self._moves!r}")
        known = [*REWARDS, *(f"{name}_per_m" for name in REWARDS)]
        if reward not in known:
            raise ConfigError(f"reward is one of {', '.join(known)}, not {reward!r}")
        if self._pings < 1 or not self._path_m > 0.0:
            raise ConfigError(
                f"pings and path_m are budgets above 0, not {self._pings} and {self._path_m:g}"
            )
        if not 0.0 <= self._penalty < math.inf:
            raise ConfigError(f"penalty is taken off, so 0 or more, not {self._penalty:g}")

    def _observed(self) -> spaces.Dict:
        geometry = self._config.sonar.geometry
        return spaces.Dict(
            {
                "occupancy": spaces.Box(0.0, 1.0, self._shape, np.float32),
                "entropy": spaces.Box(0.0, 1.0, self._shape, np.float32),
                "image": spaces.Box(0.0, 1.0, (geometry.bins, geometry.beams), np.float32),
                "pose": spaces.Box(-1.0, 1.0, (4,), np.float64),
                "left": spaces.Box(0.0, 1.0, (1,), np.float32),
            }
        )

    def _path(self, action: Array | np.integer[Any]) -> ScanPath | None:
        """The scan of an action; None if it leads out of reach."""
        episode = self._episode
        assert episode is not None
        if self._moves == "lobe":
            left = self._pings - episode.pings
            if not self.action_space.contains(action):
                return None
            return episode.rosette.lobe_path(int(action), episode.pose, left)
        shares = np.asarray(action, np.float64)
        if shares.shape != (4,) or not (np.abs(shares) <= 1.0).all():  # nor is NaN
            return None
        return ScanPath((episode.reach.pose(shares),))

    def _look(self) -> None:
        """Take note of the map as it is: the area's voxels, and what they are worth."""
        episode = self._episode
        assert episode is not None
        voxel_m = self._config.mapping.voxel_m
        middle = np.array(episode.world.area.region.centre_m) / voxel_m
        first = np.rint(middle - np.array(self._shape) / 2)
        box = Box.of(first * voxel_m, (first + self._shape) * voxel_m)
        self._window: VoxelWindow = episode.mapper.voxels.window(box)
        self._entropy = entropy_map(self._window)
        self._bits = float(self._entropy.sum(dtype=np.float64))
        self._f1 = solid_f1(episode.mapper.voxels, episode.truth)
        self._worth = self._f1 if self._reward == "f1" else -self._bits / self._entropy.size

    def _observation(self) -> Observation:
        episode = self._episode
        assert episode is not None
        area, ping = episode.world.area, episode.ping
        geometry, pose = self._config.sonar.geometry, episode.pose
        if pose is None:
            pose = path_over_centre(area, area.heading_rad).waypoints[0]
        blank = np.zeros((geometry.bins, geometry.beams), np.float32)
        left = min(1.0 - episode.pings / self._pings, 1.0 - episode.path_m / self._path_m)
        return {
            "occupancy": self._window.probability,
            "entropy": self._entropy.copy(),
            "image": blank if ping is None else np.array(ping.image),
            "pose": np.clip(episode.reach.action(pose), -1.0, 1.0),
            "left": np.array([max(0.0, left)], np.float32),
        }

    def _info(self, refused: str) -> dict[str, Any]:
        episode = self._episode
        assert episode is not None
        return {
            "f1": self._f1,
            "entropy_bits": self._bits,
            "pings": episode.pings,
            "path_m": episode.path_m,
            "seed": episode.world.config.seed,
            "refused": refused,
        }


def _register() -> None:
    entry = f"{__name__}:ScanEnv"
    gymnasium.register("insonify/Scan-v0", entry)
    for name in scenarios():
        title = "".join(word.capitalize() for word in name.replace("_", "-").split("-"))
        gymnasium.register(f"insonify/{title}-v0", entry, kwargs={"scenario": name})


_register()
