"""One run: a mission in its world, watched, timed and scored.  A pure function of its config."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import psutil

from insonify.errors import GeometryError, MemoryLimitError
from insonify.evaluation import GroundTruth, ground_truth, score_map
from insonify.frames import world_from_sonar
from insonify.mapping.bayes import BayesMapper, Mapper
from insonify.mapping.fan import blocks_in_fan
from insonify.mapping.voxels import BYTES_PER_VOXEL, VoxelMap
from insonify.mission import (
    Decided,
    Ended,
    Mapped,
    Pinged,
    Scanned,
    Step,
    Teleport,
    collision_message,
    fly,
)
from insonify.planning.baselines import FixedPlan, path_over_centre
from insonify.planning.decision import Decision, Planner, StopReason
from insonify.planning.entropy import entropy_map
from insonify.scenarios import Config, World
from insonify.scene.sounding import hull_contact, sounder
from insonify.types import Float32, Ping, Pose, ScanPath
from insonify.vehicle.craft import Track, pose_errors
from insonify.vehicle.description import vehicle_named
from insonify.vehicle.settings import TELEPORT
from insonify.vehicle.voyage import Voyage

BYTES_PER_AREA_VOXEL = 120
"""Working memory of planning and scoring, for each voxel of the designated area."""

Metrics = dict[str, dict[str, dict[str, float]]]


@dataclass(frozen=True, slots=True)
class HistoryEntry:
    """The state of a run after one scan."""

    scan: int
    pings: int
    path_m: float
    total_entropy_bits: float
    metrics: Metrics


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """What a decision was made on: entropy summed over height, (nx, ny) bits, and the answer.

    Not a number where no voxel has been in view.
    """

    entropy_bits: Float32
    decision: Decision


@dataclass(slots=True, eq=False)
class Flight:
    """What a run flown by a vehicle leaves behind, besides.

    Attributes:
        voyage: The vehicle under way.
        reference: The same pings mapped at the true poses: what pose error costs.
    """

    voyage: Voyage
    reference: Mapper

    @property
    def track(self) -> Track:
        """Where it was, believed to be and was meant to be."""
        return self.voyage.craft.track if self.voyage.craft is not None else Track()

    def result(self, truth: GroundTruth) -> dict[str, Any]:
        """As a part of the run's row."""
        return {
            "name": self.voyage.vehicle.name,
            "navigation": self.voyage.settings.navigation,
            "time_s": self.track.moments[-1].time_s if self.track.moments else 0.0,
            "pose_error": pose_errors(self.track),
            "metrics_at_true_poses": score_map(self.reference.voxels, truth),
        }


@dataclass(slots=True, eq=False)
class Run:
    """Everything a run leaves behind.

    Attributes:
        config: What it ran on.
        world: The simulated world and the order given to the vehicle.
        mapper: The mapper, with its map.
        planner: Name of the planner.
        truth: Ground-truth voxels.
        ahead: The scan that was decided last.
        paths: The scans flown; the last is cut short if the run was interrupted.
        snapshots: One for each decision after the first scan.
        keyframes: Some pings of each scan, for pictures.
        history: One entry a scan.
        stop_reason: Why it ended.
        seconds: Wall time of setup, sonar, mapping and planning; flying counts as sonar.
        noise: What the images' noise is drawn from, as it stands.
        flight: What the vehicle did, if there was one.
    """

    config: Config
    world: World
    mapper: Mapper
    planner: str
    truth: GroundTruth
    ahead: ScanPath = ScanPath(())
    paths: list[ScanPath] = field(default_factory=list)
    snapshots: list[Snapshot] = field(default_factory=list)
    keyframes: list[tuple[int, Pose, Ping]] = field(default_factory=list)
    history: list[HistoryEntry] = field(default_factory=list)
    stop_reason: StopReason = StopReason.INTERRUPTED
    seconds: dict[str, float] = field(default_factory=dict)
    noise: np.random.Generator = field(default_factory=np.random.default_rng)
    flight: Flight | None = None

    @property
    def pings(self) -> int:
        """How many pings were mapped."""
        return sum(len(path.waypoints) for path in self.paths)

    @property
    def path_m(self) -> float:
        """Length flown, transits between the scans included; straight ones without a vehicle."""
        if self.flight is not None:
            return self.flight.track.length_m
        transits = sum(
            math.dist(a.waypoints[-1].position_m, b.waypoints[0].position_m)
            for a, b in zip(self.paths, self.paths[1:], strict=False)
        )
        return transits + sum(path.length_m for path in self.paths)

    def true_pose(self, believed: Pose) -> Pose:
        """Where the sonar's carrier is now, which believes to be at a pose."""
        craft = None if self.flight is None else self.flight.voyage.craft
        return believed if craft is None else craft.true_pose

    def result(self) -> dict[str, Any]:
        """The run as one JSON-ready row."""
        last = self.history[-1]
        flown = {} if self.flight is None else {"vehicle": self.flight.result(self.truth)}
        return {
            "scenario": self.config.scenario,
            "planner": self.planner,
            "mapper": self.mapper.name,
            "seed": self.config.seed,
            "scans": len(self.paths),
            "pings": self.pings,
            "path_m": round(self.path_m, 6),
            "stop_reason": self.stop_reason.value,
            "metrics": last.metrics,
            "history": [
                {
                    "scan": entry.scan,
                    "pings": entry.pings,
                    "path_m": round(entry.path_m, 6),
                    "total_entropy_bits": round(entry.total_entropy_bits, 3),
                    "metrics": entry.metrics,
                }
                for entry in self.history
            ],
            "seconds": {name: round(value, 3) for name, value in self.seconds.items()},
        } | flown


@dataclass(frozen=True, slots=True, eq=False)
class Remembered:
    """A ping of a run that was broken off: what came back, and the noise's generator after it."""

    pose: Pose
    ping: Ping
    set_noise: Callable[[np.random.Generator], None]


def execute(
    config: Config,
    planner: Planner | None = None,
    *,
    remembered: Iterable[Remembered] = (),
    watch: Callable[[Run, Step], None] = lambda run, step: None,
    should_stop: Callable[[], bool] = lambda: False,
    pace: Callable[[float], None] = lambda time_s: None,
) -> Run:
    """Fly a mission to its end and score it.

    Args:
        config: What to run.
        planner: Flies instead of the planner that the config names.
        remembered: The first pings of the same run, broken off before; they are not made again.
        watch: Called after every step, for progress or recording.
        should_stop: Asked after every ping; if true the run ends there, scored as it stands.
        pace: Called with a vehicle's time as it goes on; it may wait.

    Raises:
        InsonifyError: The config does not make a world that can be scanned.
    """
    clock = _Clock()
    world = World(config)
    _check_memory(world)
    mapper = BayesMapper(config.mapping)
    planner = planner or world.planner()
    rng = np.random.default_rng([config.seed, 2])
    carrier = _carrier(world, _sonar(world, rng, remembered), pace)
    if isinstance(carrier, Teleport):
        _check_plan(world, planner)
    truth = ground_truth(world.scene, world.body, config.mapping.voxel_m)
    run = Run(config, world, mapper, planner.name, truth, seconds=clock.seconds, noise=rng)
    if isinstance(carrier, Voyage):
        run.flight = Flight(carrier, BayesMapper(config.mapping))
    clock.lap("setup")
    mission = fly(carrier, mapper, planner)
    for step in _timed(mission, clock):
        _note(run, step)
        watch(run, step)
        if isinstance(step, Mapped) and should_stop():
            break
    if not run.history or run.history[-1].pings < run.pings:
        run.history.append(_assess(run))
    return run


def _carrier(
    world: World, insonify: Callable[[Pose, Pose], Ping], pace: Callable[[float], None]
) -> Teleport | Voyage:
    """What carries the sonar: the vehicle that the config names, or none."""
    config, scene = world.config, world.scene
    clearance_m = config.survey.clearance_m
    if config.vehicle.name == TELEPORT:
        return Teleport(
            lambda pose: insonify(pose, pose),
            lambda path: scene.first_collision(path, clearance_m),
        )
    vehicle = vehicle_named(config.vehicle.name)
    return Voyage(
        vehicle,
        config.vehicle,
        clearance_m,
        insonify,
        sounder(scene),
        hull_contact(scene, vehicle.radius_m),
        np.random.default_rng([config.seed, 3]),
        pace,
    )


def _sonar(
    world: World, rng: np.random.Generator, remembered: Iterable[Remembered]
) -> Callable[[Pose, Pose], Ping]:
    """The sonar in its world, after what is remembered of it: from a true and a believed pose."""
    memory = iter(remembered)

    def insonify(true: Pose, believed: Pose) -> Ping:
        past = next(memory, None)
        if past is None:
            return world.sonar.ping(world.scene, true, rng)
        if past.pose != believed:
            raise GeometryError(
                "the scan that was broken off went another way than this one does; it was made by "
                "another version of insonify, so delete its recording and scan anew"
            )
        past.set_noise(rng)
        return past.ping

    return insonify


class _Clock:
    """Wall time by phase."""

    def __init__(self) -> None:
        self.seconds = dict.fromkeys(("setup", "sonar", "mapping", "planning"), 0.0)
        self.restart()

    def restart(self) -> None:
        self._since = time.perf_counter()

    def lap(self, phase: str) -> None:
        self.seconds[phase] += time.perf_counter() - self._since


_PHASES: dict[type[Step], str] = {Decided: "planning", Pinged: "sonar", Mapped: "mapping"}


def _timed(mission: Iterator[Step], clock: _Clock) -> Iterator[Step]:
    """The mission's steps; the time each took to come goes to its phase."""
    clock.restart()
    for step in mission:
        if type(step) in _PHASES:
            clock.lap(_PHASES[type(step)])
        yield step
        clock.restart()


def _note(run: Run, step: Step) -> None:
    """Write a step into the run."""
    if isinstance(step, Decided):
        if run.paths:
            run.snapshots.append(_snapshot(run, step.decision))
        if step.decision.path is not None:
            run.ahead = step.decision.path
    elif isinstance(step, Pinged):
        _note_ping(run, step)
    elif isinstance(step, Scanned):
        run.history.append(_assess(run))
    elif isinstance(step, Ended):
        run.stop_reason = step.reason


def _note_ping(run: Run, step: Pinged) -> None:
    """Lengthen the scan being flown by a waypoint; keep three pings of each scan."""
    if not run.paths or len(run.paths) == len(run.history):
        run.paths.append(ScanPath(()))
    done, count = len(run.paths[-1].waypoints), len(run.ahead.waypoints)
    run.paths[-1] = ScanPath((*run.paths[-1].waypoints, step.pose))
    if run.flight is not None:
        run.flight.reference.integrate(step.ping, run.true_pose(step.pose))
    if done in {count // 4, count // 2, (3 * count) // 4}:
        run.keyframes.append((len(run.paths), step.pose, step.ping))


def _snapshot(run: Run, decision: Decision) -> Snapshot:
    window = run.mapper.voxels.window(run.world.area.region)
    observed = np.where(window.seen > 0, entropy_map(window), 0.0).sum(axis=2, dtype=np.float32)
    observed[~(window.seen > 0).any(axis=2)] = np.nan
    return Snapshot(observed, decision)


def _assess(run: Run) -> HistoryEntry:
    window = run.mapper.voxels.window(run.world.area.region)
    return HistoryEntry(
        scan=len(run.paths),
        pings=run.pings,
        path_m=run.path_m,
        total_entropy_bits=float(entropy_map(window).sum(dtype=np.float64)),
        metrics=score_map(run.mapper.voxels, run.truth),
    )


def _check_plan(world: World, planner: Planner) -> None:
    """Refuse a fixed plan that would run into something, before it is flown."""
    if not isinstance(planner, FixedPlan):
        return
    poses = tuple(pose for path in planner.plan for pose in path.waypoints)
    hit = world.scene.first_collision(ScanPath(poses), world.config.survey.clearance_m)
    if hit is not None:
        raise GeometryError(collision_message(hit))


def _check_memory(world: World) -> None:
    """Refuse a voxel size whose map would not fit into free memory.

    The estimate is the space that the sonar could sweep on scans over the centre from all sides,
    counted with coarse blocks.
    """
    voxel_m = world.config.mapping.voxel_m
    swept = VoxelMap(max(voxel_m, world.config.sonar.range_max_m / 160))
    geometry = world.config.sonar.geometry
    for heading in np.arange(12) * math.tau / 12:
        for pose in path_over_centre(world.area, heading).waypoints[::4]:
            transform = world_from_sonar(pose, geometry.mount)
            swept.allocate(blocks_in_fan(transform, geometry, swept.block_m))
    area_m3 = math.prod(world.area.region.size_m)
    swept_m3 = swept.block_count * swept.block_m**3
    weight = swept_m3 * BYTES_PER_VOXEL * 3 + area_m3 * BYTES_PER_AREA_VOXEL
    needed = weight / voxel_m**3
    free = psutil.virtual_memory().available
    if needed > 0.9 * free:
        fits = (weight / (0.9 * free)) ** (1 / 3)
        digits = 1 - math.floor(math.log10(fits))
        fits = math.ceil(fits * 10**digits) / 10**digits
        raise MemoryLimitError(
            f"{world.config.object.mesh} is {max(world.body.box.size_m):.3g} m across: voxels of "
            f"{voxel_m:g} m would need about {needed / 1e9:.3g} GB and "
            f"{free / 1e9:.3g} GB are free; voxels of {fits:g} m fit "
            f"(--set mapping.voxel_m={fits:g})"
        )
