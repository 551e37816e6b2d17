"""Carving: its marks against a slow reading of its rule, and what its maps are worth."""

from __future__ import annotations

import json
import math
from importlib import resources

import numba
import numpy as np
import pytest
from scipy.ndimage import maximum_filter

from insonify.config.settings import Table
from insonify.errors import ConfigError, MemoryLimitError
from insonify.evaluation import score_map
from insonify.frames import world_from_sonar
from insonify.mapping.bayes import BayesMapper
from insonify.mapping.carving import CarvingMapper
from insonify.mapping.mapper import CarvingSettings, MappingSettings
from insonify.mapping.odds import CASES, DOUBTED, case_of, odds_table
from insonify.mapping.seabed import SeabedHeights
from insonify.mapping.visibility import DARK, LIT, count_pixels, look
from insonify.mapping.voxels import IN_VIEW, OBSERVED, SURFACE
from insonify.mission.loop import Pinged, Step
from insonify.mission.run import Run, execute
from insonify.mission.setup import World, scenario_config
from insonify.types import Array, Box, FanGeometry, Ping, Pose, PosedPing, estimated

SETTINGS = MappingSettings()


def flown(scenario: str, pings: int, seed: int = 3) -> tuple[Run, list[PosedPing]]:
    heard: list[PosedPing] = []

    def watch(run: Run, step: Step) -> None:
        if isinstance(step, Pinged):
            heard.append(step.posed)

    layers = {"planner": "rosette", "mapper": "carving", "seed": seed, "rosette": {"pings": pings}}
    return execute(scenario_config(scenario, [layers]), watch=watch), heard


@pytest.fixture(scope="module")
def arch() -> tuple[Run, list[PosedPing]]:
    return flown("arch", 100)


def carve(heard: list[PosedPing], mapper: CarvingMapper | None = None) -> CarvingMapper:
    mapper = CarvingMapper(SETTINGS) if mapper is None else mapper
    for posed in heard:
        assert posed.pose is not None
        mapper.integrate(posed.ping, posed.pose)
    return mapper


def test_it_maps_better_than_the_papers_update_from_the_same_pings(
    arch: tuple[Run, list[PosedPing]],
) -> None:
    run, heard = arch
    papers = BayesMapper(SETTINGS)
    for posed in heard:
        assert posed.pose is not None
        papers.integrate(posed.ping, posed.pose)
    ours, theirs = run.history[-1].metrics, score_map(papers.voxels, run.truth)
    assert ours["solid"]["exact"]["f1"] > theirs["solid"]["exact"]["f1"] + 0.1
    assert ours["surface"]["exact"]["f1"] > theirs["surface"]["exact"]["f1"] + 0.1
    assert ours["solid"]["exact"]["f1"] > 0.8


def test_its_probabilities_are_about_right(arch: tuple[Run, list[PosedPing]]) -> None:
    run, _ = arch  # the table was not learnt from an arch
    window = run.mapper.voxels.window(run.truth.box)
    told = ((window.seen & OBSERVED) > 0) & run.truth.scored
    p, solid = window.probability[told], run.truth.solid[told]
    tenth = np.minimum((p * 10).astype(int), 9)
    error = sum(
        abs(p[tenth == k].mean() - solid[tenth == k].mean()) * (tenth == k).mean()
        for k in np.unique(tenth)
    )
    assert error < 0.08


def test_threads_change_nothing(arch: tuple[Run, list[PosedPing]]) -> None:
    _, heard = arch
    whole = carve(heard[:30])
    before = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        alone = carve(heard[:30])
    finally:
        numba.set_num_threads(before)
    for name, array in whole.save().items():
        assert np.array_equal(array, alone.save()[name]), name


def test_it_goes_on_from_what_it_saved(arch: tuple[Run, list[PosedPing]]) -> None:
    _, heard = arch
    whole, half = carve(heard[:40]), carve(heard[:25])
    again = CarvingMapper(SETTINGS)
    again.load({name: array.copy() for name, array in half.save().items()})
    box = Box((-4, -4, -21), (4, 4, -16))
    window, copied = half.voxels.window(box), again.voxels.window(box)
    assert np.array_equal(window.log_odds, copied.log_odds)
    assert np.array_equal(window.seen, copied.seen)
    carve(heard[25:40], again)
    for name, array in whole.save().items():
        assert np.array_equal(array, again.save()[name]), name


def test_it_does_not_go_on_with_other_voxels_inside(arch: tuple[Run, list[PosedPing]]) -> None:
    saved = carve(arch[1][:2]).save()
    other = CarvingMapper(MappingSettings(carving=CarvingSettings(inside=3)))
    with pytest.raises(ConfigError, match=r"inside is 3.*has 2"):
        other.load(saved)


def test_it_does_not_go_on_with_what_an_earlier_version_saved() -> None:
    saved = CarvingMapper(SETTINGS).save()
    saved["fine_sides"] = saved.pop("fine_views")
    with pytest.raises(ConfigError, match="earlier"):
        CarvingMapper(SETTINGS).load(saved)


@pytest.mark.parametrize("inside", [1, 3])
def test_any_number_of_voxels_inside_makes_a_map(
    arch: tuple[Run, list[PosedPing]], inside: int
) -> None:
    run, heard = arch
    mapper = CarvingMapper(MappingSettings(carving=CarvingSettings(inside=inside)))
    carve(heard[:60], mapper)
    scores = score_map(mapper.voxels, run.truth)
    assert scores["solid"]["exact"]["f1"] > 0.6


def test_the_map_is_up_to_date_after_every_ping(arch: tuple[Run, list[PosedPing]]) -> None:
    _, heard = arch
    asked, silent = CarvingMapper(SETTINGS), carve(heard[:12])
    for posed in heard[:12]:
        carve([posed], asked)
        assert asked.voxels.log_odds.any()
    assert np.array_equal(asked.voxels.coords, silent.voxels.coords)
    assert np.array_equal(asked.voxels.log_odds, silent.voxels.log_odds)
    assert np.array_equal(asked.voxels.seen, silent.voxels.seen)


def _small() -> FanGeometry:
    return FanGeometry(0.4, 0.3, 8, 40, 0.0, 2.0, Pose(0, 0, 0, pitch_rad=0.3))


def _reference(
    geometry: FanGeometry,
    transform: Array,
    image: Array,
    angles: tuple[Array, Array],
    voxel_m: float,
) -> tuple[dict[tuple[int, ...], str], set[tuple[int, ...]]]:
    """Marks by stepping along each ray in tenths of a millimetre; and those too near to call."""
    marks: dict[tuple[int, ...], str] = {}
    doubtful: set[tuple[int, ...]] = set()
    r = np.arange(1e-3, geometry.range_max_m, 1e-4)
    for azimuth in angles[0]:
        beam = min(int((geometry.azimuth_fov_rad / 2 - azimuth) / geometry.beam_rad), 7)
        lit_at = image[np.minimum((r / geometry.bin_m).astype(int), geometry.bins - 1), beam] > 0.5
        for elevation in angles[1]:
            flat = math.cos(elevation)
            ahead = [flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)]
            points = transform[:3, 3] + r[:, None] * (transform[:3, :3] @ ahead)
            cells = np.floor(points / voxel_m).astype(int)
            starts = np.flatnonzero(np.r_[True, (np.diff(cells, axis=0) != 0).any(axis=1)])
            for start, stop in zip(starts, [*starts[1:], len(r)], strict=True):
                cell, length = tuple(cells[start].tolist()), (stop - start) * 1e-4
                edge = int(r[start] / geometry.bin_m), int(r[stop - 1] / geometry.bin_m)
                near = min(abs(r[i] / geometry.bin_m % 1 - 0.5) for i in (start, stop - 1)) > 0.49
                if length < 1e-3 or abs(length - voxel_m / 2) < 1e-3 or near or edge[1] < edge[0]:
                    doubtful.add(cell)
                if lit_at[start:stop].any():
                    marks[cell] = "lit"
                    break
                if length >= voxel_m / 2 and marks.get(cell) != "lit":
                    marks[cell] = "dark"
    return marks, doubtful


def test_marks_without_a_seabed_are_those_of_a_slow_reference() -> None:
    geometry, voxel_m = _small(), 0.1
    rng = np.random.default_rng(5)
    image = (rng.random((geometry.bins, geometry.beams)) < 0.03).astype(np.float32)
    image[: geometry.bins // 3] = 0.0
    transform = world_from_sonar(Pose(0.3, -0.2, 0.1, yaw_rad=0.7), geometry.mount)
    low = np.array([-4, -4, -4])
    index = np.arange(8**3, dtype=np.int32).reshape(8, 8, 8)
    blocks = index.size
    marks = np.zeros((3, blocks, 512), np.uint8)
    angles = (np.linspace(0.19, -0.19, 16), np.linspace(-0.14, 0.14, 9))
    fan = np.array([0.2, 0.15, 0.0, geometry.beam_rad, geometry.bin_m])
    look(
        index, low.astype(np.int64), np.arange(blocks), np.zeros((blocks, 512), np.float32),
        np.zeros((blocks, 512), np.uint8), transform, fan, angles, voxel_m,
        count_pixels(image, np.float32(0.5), 0, 0),
        (np.full((8, 8), -1e9), np.zeros((8, 8), bool), 0.1), -1.5, marks,
    )  # fmt: skip
    expected, doubtful = _reference(geometry, transform, image, angles, voxel_m)
    found: dict[tuple[int, ...], str] = {}
    for name, row in (("dark", DARK), ("lit", LIT)):
        for block, k in np.argwhere(marks[row]):
            place = np.array(np.unravel_index(block, (8, 8, 8))) + low
            cell = place * 8 + np.array([k >> 6, (k >> 3) & 7, k & 7])
            found[tuple(cell.tolist())] = (
                name if found.get(tuple(cell.tolist())) != "lit" else "lit"
            )
    sure = [cell for cell in expected if cell not in doubtful]
    assert len(sure) > 200
    wrong = [cell for cell in sure if found.get(cell) != expected[cell]]
    assert len(wrong) <= 0.02 * len(sure), wrong[:5]


@pytest.mark.parametrize("scenario", ["tetrapod", "amphorae"])
def test_the_seabed_is_found_from_pings_alone(scenario: str) -> None:
    run, heard = flown(scenario, 60)
    seabed = SeabedHeights()
    for posed in heard:
        assert posed.pose is not None
        transform = world_from_sonar(posed.pose, posed.ping.geometry.mount)
        seabed.hear(posed.ping.image, 0.3, transform, posed.ping.geometry)
    x = y = np.arange(-3.0, 3.0, 0.4)
    known = seabed.heights(x, y)
    assert known is not None
    truth = run.world.stage.seabed.height_at(*np.meshgrid(x, y, indexing="ij"))
    assert abs(np.mean(known[0] - truth)) < 0.03
    assert np.std(known[0] - truth) < 0.06


def test_a_seabed_is_learnt_after_going_on_from_a_save_of_none() -> None:
    run, heard = flown("tetrapod", 12)
    empty = SeabedHeights().save()
    fresh, again = SeabedHeights(), SeabedHeights()
    again.load(empty)
    for seabed in (fresh, again):
        for posed in heard:
            assert posed.pose is not None
            transform = world_from_sonar(posed.pose, posed.ping.geometry.mount)
            seabed.hear(posed.ping.image, 0.3, transform, posed.ping.geometry)
    for name, array in fresh.save().items():
        assert np.array_equal(array, again.save()[name]), name
    assert run.pings == 12


def test_points_of_a_sonar_at_rest_are_counted_without_end() -> None:
    ping, geometry = np.zeros((40, 8), np.float32), _small()
    ping[30:] = 1.0
    seabed = SeabedHeights()
    transform = world_from_sonar(Pose(0, 0, 0), geometry.mount)
    seabed.hear(ping, 0.5, transform, geometry)
    full = {name: array.copy() for name, array in seabed.save().items()}
    full["seabed_counts"] *= 60_000
    seabed.load(full)
    seabed.hear(ping, 0.5, transform, geometry)
    assert seabed.save()["seabed_counts"].sum() == full["seabed_counts"].sum() + geometry.beams


def test_there_is_no_seabed_where_none_is_heard() -> None:
    geometry = _small()
    up = FanGeometry(0.4, 0.3, 8, 40, 0.0, 2.0, Pose(0, 0, 0, pitch_rad=-0.6))
    rng = np.random.default_rng(0)
    for fan, share in ((geometry, 0.0), (up, 0.5)):
        seabed = SeabedHeights()
        for step in range(40):
            image = (rng.random((fan.bins, fan.beams)) < share).astype(np.float32)
            seabed.hear(image, 0.5, world_from_sonar(Pose(step, 0, 0), fan.mount), fan)
        assert seabed.heights(np.arange(4.0), np.arange(4.0)) is None


def test_a_dark_ping_frees_its_fan_and_nothing_else() -> None:
    geometry = _small()
    mapper = CarvingMapper(MappingSettings(voxel_m=0.1))
    for _ in range(3):
        mapper.integrate(Ping(np.zeros((40, 8), np.float32), geometry), Pose(0, 0, 0))
    window = mapper.voxels.window(Box((-2.5, -2.5, -2.5), (2.5, 2.5, 2.5)))
    assert not window.occupied.any()
    assert not ((window.seen & SURFACE) > 0).any()
    centres = window.centres_m((window.seen & IN_VIEW) > 0)
    turned = (centres - 0) @ world_from_sonar(Pose(0, 0, 0), geometry.mount)[:3, :3]
    assert np.abs(np.arctan2(turned[:, 1], turned[:, 0])).max() < 0.2 + 0.1
    assert (window.log_odds[(window.seen & OBSERVED) > 0] < 0).mean() > 0.95


def test_pixels_that_are_not_known_free_nothing_behind_them() -> None:
    geometry = _small()
    image = np.zeros((40, 8), np.float32)
    image[20:] = np.nan
    mapper = CarvingMapper(MappingSettings(voxel_m=0.1))
    mapper.integrate(Ping(image, geometry), Pose(0, 0, 0))
    window = mapper.voxels.window(Box((-2.5, -2.5, -2.5), (2.5, 2.5, 2.5)))
    free = window.centres_m(((window.seen & OBSERVED) > 0) & (window.log_odds < 0))
    assert len(free)
    assert np.linalg.norm(free, axis=1).max() < 1.0 + 0.1


def test_the_table_has_a_row_for_every_case_and_says_what_it_was_learnt_from() -> None:
    cases = {
        case_of(free / 8, near, covered, (1 << sides) - 1 | doubted, occupied, beside)
        for free in range(9)
        for near in np.linspace(0, 1, 28)
        for covered in np.linspace(0, 1, 9)
        for sides in range(9)
        for occupied in (False, True)
        for beside in (False, True)
        for doubted in (0, DOUBTED)
    }
    assert cases == set(range(CASES))
    table = json.loads(resources.files("insonify.mapping").joinpath("odds.json").read_text())
    assert len(table["solid"]) == len(table["surface"]) == len(odds_table()) == CASES
    assert not {"wreck", "arch", "amphorae", "trap"} & set(table["objects"])
    assert not set(range(100)) & set(table["seeds"])
    free = case_of(1.0, 1.0, 0.0, 255, False, False)
    inside = case_of(0.0, 0.0, 1.0, 255, True, True)
    assert odds_table()[free, 0] < -3 < 2 < odds_table()[inside, 0]


def test_echoes_are_widened_by_what_a_pose_may_be_off() -> None:
    rng = np.random.default_rng(3)
    image = (rng.random((60, 12)) < 0.05).astype(np.float32)
    image[40, 3] = np.nan
    for along, aside in ((0, 0), (2, 0), (0, 1), (3, 2)):
        maybe, surely = count_pixels(image, np.float32(0.5), along, aside)
        wide = maximum_filter(~(image <= 0.5), size=(2 * along + 1, 2 * aside + 1))
        assert np.array_equal(maybe[:, 1:], np.cumsum(wide, axis=0).T), (along, aside)
        assert np.array_equal(surely[:, 1:], np.cumsum(image > 0.5, axis=0).T)


def test_a_ping_from_a_pose_in_doubt_shows_less_and_less_the_farther_away() -> None:
    geometry = _small()
    maps = []
    for std in ((0.0, 0.0), (0.05, 0.0), (0.0, 0.05)):
        mapper = CarvingMapper(MappingSettings(voxel_m=0.1))
        mapper.integrate(
            Ping(np.zeros((40, 8), np.float32), geometry), estimated(Pose(0, 0, 0), std)
        )
        fine = mapper.save()
        block = fine["fine_coords"].tolist().index([2, 0, -1])
        maps.append(fine["fine_log_odds"][block].min())
    near_m = 0.4 * math.dist((2.5, 0.5, -0.5), (0, 0, 0))
    assert maps == pytest.approx([-1.0, -0.5, -1.0 / (1.0 + near_m)], rel=1e-5)


def test_poses_that_are_off_cost_less_when_the_mapper_knows() -> None:
    layers: list[Table] = [
        {"planner": "uniform", "mapper": "carving", "survey": {"waypoints": 25}},
        {"vehicle": {"pose_noise": {"position_m": 0.05, "attitude_deg": 0.5}}},
    ]
    told = execute(scenario_config("tetrapod", layers))

    class Untold(CarvingMapper):
        def integrate(self, ping: Ping, pose: Pose) -> None:
            super().integrate(ping, Pose(*pose.numbers))

    config = scenario_config("tetrapod", layers)
    untold = execute(config, mapper=Untold(config.mapping))
    scores = [run.history[-1].metrics["solid"]["exact"]["f1"] for run in (told, untold)]
    assert scores[0] > max(0.85, scores[1] + 0.1)


def test_it_needs_no_seabed_and_takes_one_beam() -> None:
    geometry = FanGeometry(math.radians(3.0), math.radians(25.0), 1, 100, 0.2, 5.2)
    mapper = CarvingMapper(MappingSettings(voxel_m=0.2))
    image = np.zeros((100, 1), np.float32)
    image[60:64] = 0.9  # a wall at 3.3 m
    for step in range(72):
        mapper.integrate(Ping(image, geometry), Pose(0, 0, 0, yaw_rad=math.radians(5.0 * step)))
    occupied = mapper.voxels.occupied_m()
    assert len(occupied) > 50
    away = np.linalg.norm(occupied, axis=1)
    assert away.min() > 2.8 and away.max() < 4.2


def test_memory_is_asked_for_before_a_map_is_made() -> None:
    config = scenario_config("tetrapod", [{"mapper": "carving", "mapping": {"voxel_m": 0.002}}])
    with pytest.raises(MemoryLimitError, match="voxel"):
        execute(config)
    assert isinstance(
        World(scenario_config("tetrapod", [{"mapper": "carving"}])).mapper(), CarvingMapper
    )
