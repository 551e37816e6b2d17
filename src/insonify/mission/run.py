"""One run: a mission in its world, watched, timed and scored.  A pure function of its config."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from insonify import memory
from insonify.config.toml import config_to_toml
from insonify.display import Told
from insonify.errors import GeometryError, MemoryLimitError
from insonify.evaluation import GroundTruth, ghosts, ground_truth, score_map, solids_of
from insonify.frames import world_from_sonar
from insonify.mapping.factory import bytes_per_voxel
from insonify.mapping.fan import blocks_in_fan, fan_box
from insonify.mapping.mapper import Mapper, check_voxels
from insonify.mapping.voxels import VoxelMap
from insonify.mission.account import Account
from insonify.mission.clock import Clock, timed
from insonify.mission.loop import (
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
from insonify.mission.result import FlightResult, ScanResult, ScanRow
from insonify.mission.setup import Config, World, copied, naming
from insonify.planning.baselines import FixedPlan, path_over_centre
from insonify.planning.decision import DecisionRecord, Planner
from insonify.planning.entropy import entropy_map
from insonify.scene.probes import hull_contact, ray_query
from insonify.seeds import Stream, generator
from insonify.types import Float32, Ping, Pose, PosedPing, ScanPath, StopReason
from insonify.vehicle.craft import Track, pose_errors
from insonify.vehicle.description import vehicle_named
from insonify.vehicle.instruments import doubtful
from insonify.vehicle.settings import TELEPORT
from insonify.vehicle.voyage import Surroundings, Voyage

BYTES_PER_AREA_VOXEL = 120
"""Working memory of planning and scoring, for each voxel of the designated area."""
KEYFRAMES = (1, 2, 3)
"""Quarters of a scan whose pings are kept for pictures."""


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

    @property
    def time_s(self) -> float:
        """How long it has been under way."""
        return self.track.moments[-1].time_s if self.track.moments else 0.0

    def result(self, truth: GroundTruth) -> FlightResult:
        """Its figures."""
        return FlightResult(
            name=self.voyage.vehicle.name,
            navigation=self.voyage.settings.navigation,
            time_s=self.time_s,
            pose_error=pose_errors(self.track),
            metrics_at_true_poses=score_map(self.reference.voxels, truth),
        )


@dataclass(slots=True, eq=False)
class Run(Told):
    """A run while it lasts, and everything it leaves behind.

    Attributes:
        config: What it runs on.
        world: The simulated world and the order given to the vehicle.
        mapper: The mapper, with its map.
        planner: Name of the planner.
        truth: Ground-truth voxels.
        ahead: The scan that was decided last.
        paths: The scans flown; the last is cut short if the run was interrupted.
        decisions: What the planner answered, with what it was made on.
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
    decisions: list[DecisionRecord] = field(default_factory=list)
    keyframes: list[tuple[int, PosedPing]] = field(default_factory=list)
    history: list[ScanRow] = field(default_factory=list)
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

    def result(self) -> ScanResult:
        """The run's figures."""
        region = self.world.area.region
        return ScanResult(
            scenario=self.config.scenario,
            planner=self.planner,
            mapper=self.mapper.name,
            seed=self.config.seed,
            scans=len(self.paths),
            pings=self.pings,
            path_m=round(self.path_m, 6),
            stop_reason=self.stop_reason,
            why_stopped=self.why_stopped,
            metrics=self.history[-1].metrics,
            history=tuple(self.history),
            region_m=(region.low_m, region.high_m),
            seconds={name: round(value, 3) for name, value in self.seconds.items()},
            vehicle=None if self.flight is None else self.flight.result(self.truth),
        )

    @property
    def why_stopped(self) -> str:
        """In a sentence: the planner's own, if it was the planner."""
        last = self.decisions[-1].decision if self.decisions else None
        if last is not None and last.stop is self.stop_reason and last.why_not is not None:
            return last.why_not
        return self.stop_reason.sentence

    def account(self) -> Account:
        """The run for those who look at it."""
        return Account(
            result=self.result(),
            config_toml=config_to_toml(self.config, "scan"),
            region=self.world.area.region,
            voxels=self.mapper.voxels,
            truth=self.truth,
            solids=solids_of(self.world.scene),
            decisions=tuple(self.decisions),
            paths=tuple(self.paths),
            keyframes=tuple(self.keyframes),
            moments=() if self.flight is None else tuple(self.flight.track.moments),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Remembered:
    """A ping of a run that was broken off: what came back, and the noise's generator after it."""

    posed: PosedPing
    set_noise: Callable[[np.random.Generator], None]
    source: str


def execute(
    config: Config,
    planner: Planner | None = None,
    mapper: Mapper | None = None,
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
        mapper: Maps instead of the mapper that the config names; its map is empty.  The run's
            config names the classes of both.
        remembered: The first pings of the same run, broken off before; they are not made again.
        watch: Called after every step, for progress or recording.
        should_stop: Asked after every ping; if true the run ends there, scored as it stands.
        pace: Called with a vehicle's time as it goes on; it may wait.

    Raises:
        InsonifyError: The config does not make a world that can be scanned.
    """
    clock = Clock()
    config = naming(config, planner, mapper)
    world = World(config)
    check_memory(world)
    mapper = world.mapper() if mapper is None else mapper
    check_voxels(mapper, config.mapping)
    planner = world.planner() if planner is None else planner
    noise = generator(config.seed, Stream.NOISE)
    carrier = carrier_of(world, _sonar(world, noise, remembered), pace)
    if isinstance(carrier, Teleport):
        _check_plan(world, planner)
    truth = ground_truth(world.scene, world.stage.bodies, config.mapping.voxel_m)
    run = Run(config, world, mapper, planner.name, truth, seconds=clock.seconds, noise=noise)
    if isinstance(carrier, Voyage):
        run.flight = Flight(carrier, copied(mapper))
    clock.lap("setup")
    _follow(run, timed(fly(carrier, mapper, planner), clock), watch, should_stop)
    return run


def _follow(
    run: Run,
    steps: Iterable[Step],
    watch: Callable[[Run, Step], None],
    should_stop: Callable[[], bool],
) -> None:
    """Take a mission's steps until it ends, or is to stop."""
    for step in steps:
        _note(run, step)
        watch(run, step)
        if run.flight is not None:
            run.flight.track.readings.clear()  # whoever records them has
        if isinstance(step, Mapped) and should_stop():
            break
    if not run.history or run.history[-1].pings < run.pings:  # the last scan was cut short
        run.mapper.finish_scan()
        _note_scan(run)


def carrier_of(
    world: World,
    insonify: Callable[[Pose, Pose], Ping],
    pace: Callable[[float], None] = lambda time_s: None,
) -> Teleport | Voyage:
    """What carries the sonar: the vehicle that the config names, or none."""
    config, scene = world.config, world.scene
    clearance_m = config.survey.clearance_m
    if config.vehicle.name == TELEPORT:
        return Teleport(
            insonify,
            lambda path: scene.first_collision(path, clearance_m),
            partial(doubtful, config.vehicle.pose_noise, generator(config.seed, Stream.POSES)),
        )
    vehicle = vehicle_named(config.vehicle.name)
    surroundings = Surroundings(insonify, ray_query(scene), hull_contact(scene, vehicle.radius_m))
    rng = generator(config.seed, Stream.VEHICLE)
    return Voyage(vehicle, config.vehicle, clearance_m, surroundings, rng, pace)


def _sonar(
    world: World, noise: np.random.Generator, remembered: Iterable[Remembered]
) -> Callable[[Pose, Pose], Ping]:
    """The sonar in its world, after what is remembered of it: from a true and a believed pose."""
    pasts = iter(remembered)

    def insonify(true: Pose, believed: Pose) -> Ping:
        past = next(pasts, None)
        if past is None:
            return world.sonar.ping(world.scene, true, noise)
        if past.posed.pose != believed:
            raise GeometryError(
                f"{past.source}: the scan that was broken off went another way than this one "
                "does, as its planner or mapper or insonify has changed since; delete it, or give "
                "another --out"
            )
        world.sonar.skip(true, noise)
        past.set_noise(noise)
        return past.posed.ping

    return insonify


def _note(run: Run, step: Step) -> None:
    """Write a step into the run."""
    if isinstance(step, Decided):
        entropy_bits = _entropy_from_above(run) if run.paths else None
        run.decisions.append(DecisionRecord(run.pings, step.decision, entropy_bits))
        if step.decision.path is not None:
            run.ahead = step.decision.path
    elif isinstance(step, Pinged):
        _note_ping(run, step.posed)
    elif isinstance(step, Scanned):
        _note_scan(run)
    elif isinstance(step, Ended):
        run.stop_reason = step.reason


def _note_ping(run: Run, posed: PosedPing) -> None:
    """Lengthen the scan being flown by a waypoint; keep three pings of each scan."""
    if not run.paths or len(run.paths) == len(run.history):
        run.paths.append(ScanPath(()))
    assert posed.pose is not None
    done, count = len(run.paths[-1].waypoints), len(run.ahead.waypoints)
    run.paths[-1] = ScanPath((*run.paths[-1].waypoints, posed.pose))
    if run.flight is not None and posed.true_pose is not None:
        run.flight.reference.integrate(posed.ping, posed.true_pose)
    if done in {quarter * count // 4 for quarter in KEYFRAMES}:
        run.keyframes.append((len(run.paths), posed))


def _note_scan(run: Run) -> None:
    if run.flight is not None:
        run.flight.reference.finish_scan()
    run.history.append(_assess(run))


def _entropy_from_above(run: Run) -> Float32:
    """The entropy of the designated area summed over height, as in `DecisionRecord`."""
    window = run.mapper.voxels.window(run.world.area.region)
    observed: Float32 = np.where(window.seen > 0, entropy_map(window), 0.0).sum(
        axis=2, dtype=np.float32
    )
    observed[~(window.seen > 0).any(axis=2)] = np.nan
    return observed


def _assess(run: Run) -> ScanRow:
    window = run.mapper.voxels.window(run.world.area.region)
    return ScanRow(
        scan=len(run.paths),
        pings=run.pings,
        path_m=round(run.path_m, 6),
        time_s=None if run.flight is None else run.flight.time_s,
        total_entropy_bits=round(float(entropy_map(window).sum(dtype=np.float64)), 3),
        metrics=score_map(run.mapper.voxels, run.truth),
        ghosts=round(ghosts(window, run.truth, run.world.scene), 6),
    )


def _check_plan(world: World, planner: Planner) -> None:
    """Refuse a fixed plan that would run into something, before it is flown."""
    if not isinstance(planner, FixedPlan):
        return
    poses = tuple(pose for path in planner.plan for pose in path.waypoints)
    hit = world.scene.first_collision(ScanPath(poses), world.config.survey.clearance_m)
    if hit is not None:
        raise GeometryError(collision_message(hit))


def check_memory(world: World) -> None:
    """Refuse a voxel size whose map would not fit into free memory.

    The estimate is the space that the sonar could sweep on scans over the centre from all sides,
    counted with coarse blocks, or if that is more, all of the area as deep as its fan reaches.
    """
    voxel_m = world.config.mapping.voxel_m
    swept = VoxelMap(max(voxel_m, world.config.sonar.range_max_m / 160))
    geometry = world.config.sonar.geometry
    for heading in np.arange(12) * math.tau / 12:
        for pose in path_over_centre(world.area, heading).waypoints[::4]:
            transform = world_from_sonar(pose, geometry.mount)
            swept.allocate(blocks_in_fan(transform, geometry, swept.block_m))
    size_x, size_y, size_z = world.area.region.size_m
    fan = fan_box(world_from_sonar(Pose(0.0, 0.0, 0.0), geometry.mount), geometry)
    area_m3 = size_x * size_y * size_z
    swept_m3 = max(swept.block_count * swept.block_m**3, size_x * size_y * fan.size_m[2])
    kept = bytes_per_voxel(world.config.mapper, world.config.mapping)
    weight = swept_m3 * kept + area_m3 * BYTES_PER_AREA_VOXEL
    needed = weight / voxel_m**3
    if memory.fits(needed):
        return
    fits = (weight / max(1.0, memory.SHARE * memory.free_bytes())) ** (1 / 3)
    digits = 1 - math.floor(math.log10(fits))
    fits = math.ceil(fits * 10**digits) / 10**digits
    raise MemoryLimitError(
        f"what is scanned is {max(world.stage.box.size_m):.3g} m across: voxels "
        f"of {voxel_m:g} m would need {memory.shortage(needed)}; voxels of {fits:g} m fit "
        f"(--set mapping.voxel_m={fits:g})"
    )
