"""The map update against a slow, direct reading of the papers' rule, voxel by voxel."""

from __future__ import annotations

import itertools
import math

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from insonify.frames import directions_from_angles, world_from_sonar
from insonify.mapping.bayes import BayesMapper, count_echoes, log_odds
from insonify.mapping.fan import blocks_in_fan
from insonify.mapping.mapper import MappingSettings
from insonify.mapping.voxels import IN_VIEW, OBSERVED
from insonify.types import Box, FanGeometry, Ping, Pose

SETTINGS = MappingSettings()
L_OCC, L_FREE = log_odds(SETTINGS.bayes.p_occupied), log_odds(SETTINGS.bayes.p_free)


def _geometry(beams: int = 24, bins: int = 60, azimuth: float = 29.0) -> FanGeometry:
    return FanGeometry(
        math.radians(azimuth),
        math.radians(14.0),
        beams,
        bins,
        0.0,
        6.0,
        Pose(0.0, 0.0, 0.0, pitch_rad=math.radians(30.0)),
    )


def _ping(geometry: FanGeometry, seed: int, share: float = 0.02) -> Ping:
    rng = np.random.default_rng(seed)
    bright = rng.random((geometry.bins, geometry.beams)) < share
    bright[: geometry.bins // 2] = False
    return Ping(bright.astype(np.float32), geometry)


def _brute_force(ping: Ping, pose: Pose, centre: np.ndarray, half: float) -> str:
    """What one ping says about the cube around a centre: occupied, free, view or nothing."""
    g = ping.geometry
    transform = world_from_sonar(pose, g.mount)
    x, y, z = p = transform[:3, :3].T @ (centre - transform[:3, 3])
    r, flat = np.linalg.norm(p), math.hypot(x, y)
    if x <= 0 or flat < half:
        return "nothing"
    azimuth = math.atan2(y, x)
    along = p / r
    across = np.array([-y, x, 0.0]) / flat
    upward = np.cross(along, across)
    axes = transform[:3, :3].T  # the cube's edges in the sonar frame, as columns

    def extent(direction: np.ndarray) -> float:
        return half * float(np.abs(direction @ axes).sum())

    level = r * math.sin(g.elevation_fov_rad / 2)
    if abs(z) > level + extent(upward):
        return "nothing"
    column = (g.azimuth_fov_rad / 2 - azimuth) / g.beam_rad
    spread = extent(across) / flat / g.beam_rad
    row, depth = (r - g.range_min_m) / g.bin_m, extent(along) / g.bin_m
    if column + spread < 0 or column - spread >= g.beams:
        return "nothing"
    if row + depth < 0 or row - depth >= g.bins:
        return "nothing"
    in_view = 0 <= column < g.beams and abs(z) <= level and 0 <= row <= g.bins
    covered = list(
        itertools.product(
            range(max(0, math.floor(row - depth)), min(g.bins - 1, math.floor(row + depth)) + 1),
            range(
                max(0, math.floor(column - spread)),
                min(g.beams - 1, math.floor(column + spread)) + 1,
            ),
        )
    )
    bright = ping.image > SETTINGS.pixel_threshold / 255
    if any(bright[cell] for cell in covered):
        return "occupied"
    whole = in_view and row - depth >= 0 and row + depth < g.bins
    first = [
        bright[:, beam].argmax() if bright[:, beam].any() else g.bins for beam in range(g.beams)
    ]
    if whole and all(cell < first[beam] for cell, beam in covered):
        return "free"
    return "view" if in_view else "nothing"


@pytest.mark.parametrize("voxel_m", [0.07, 0.3, 1.0])
@pytest.mark.parametrize("beams", [3, 24])
def test_every_voxel_is_what_the_rule_says(voxel_m: float, beams: int) -> None:
    """Beams wider than a voxel and voxels wider than a beam; a hole would show here."""
    pose = Pose(0.3, -0.2, 3.0, roll_rad=0.05, pitch_rad=-0.1, yaw_rad=0.7)
    ping = _ping(_geometry(beams), seed=beams)
    mapper = BayesMapper(SETTINGS.model_copy(update={"voxel_m": voxel_m}))
    mapper.integrate(ping, pose)
    box = Box((-1.0, -2.0, -2.0), (6.5, 6.0, 4.5))
    window = mapper.voxels.window(box)
    rng = np.random.default_rng(0)
    voxels = np.argwhere(window.seen > 0)
    chosen = rng.choice(len(voxels), min(len(voxels), 1500), replace=False)
    anywhere = rng.integers(0, window.seen.shape, (1500, 3))
    said = {"occupied": 0, "free": 0, "view": 0, "nothing": 0}
    for index in map(tuple, np.vstack([voxels[chosen], anywhere])):
        centre = (np.array(index) + window.first + 0.5) * voxel_m
        verdict = _brute_force(ping, pose, centre, voxel_m / 2)
        said[verdict] += 1
        value, seen = window.log_odds[index], window.seen[index]
        expected = {
            "occupied": (L_OCC, IN_VIEW | OBSERVED),
            "free": (L_FREE, IN_VIEW | OBSERVED),
            "view": (0.0, IN_VIEW),
            "nothing": (0.0, 0),
        }[verdict]
        assert (value, seen) == (pytest.approx(expected[0], abs=1e-6), expected[1]), verdict
    assert said["occupied"] > 0 and said["nothing"] > 0
    assert (said["free"] > 0 and said["view"] > 0) or voxel_m == 1.0


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([0.05, 0.2, 0.6]))
def test_no_echo_is_lost(seed: int, voxel_m: float) -> None:
    """The voxel that holds a point of an echo's elevation arc is occupied, for any point."""
    geometry = _geometry()
    rng = np.random.default_rng(seed)
    cell, beam = int(rng.integers(5, 60)), int(rng.integers(0, 24))
    image = np.zeros((60, 24), np.float32)
    image[cell, beam] = 1.0
    x, y, z, yaw = rng.uniform(-5, 5, 4)
    pose = Pose(float(x), float(y), float(z), yaw_rad=float(yaw))
    mapper = BayesMapper(SETTINGS.model_copy(update={"voxel_m": voxel_m}))
    mapper.integrate(Ping(image, geometry), pose)
    elevation = np.linspace(-0.499, 0.499, 25) * geometry.elevation_fov_rad
    azimuth = np.full(25, geometry.beam_azimuths_rad[beam])
    transform = world_from_sonar(pose, geometry.mount)
    arc = directions_from_angles(azimuth, elevation) * geometry.bin_ranges_m[cell]
    points = arc @ transform[:3, :3].T + transform[:3, 3]
    index = np.floor(points / voxel_m).astype(int)
    for point in index:
        window = mapper.voxels.window(Box.of(point * voxel_m, (point + 1) * voxel_m))
        assert window.occupied.all()


def test_equation_2_is_bayes_rule_in_log_odds() -> None:
    """Posterior by explicit normalisation, eta p(z | m) p(m), against the map's addition."""
    geometry = _geometry()
    image = np.zeros((60, 24), np.float32)
    image[40, :] = 1.0
    mapper = BayesMapper(SETTINGS)
    prior_occupied, prior_free = 0.5, 0.5
    for _ in range(3):
        mapper.integrate(Ping(image, geometry), Pose(0.0, 0.0, 0.0))
        likelihood = SETTINGS.bayes.p_occupied, 1.0 - SETTINGS.bayes.p_occupied
        eta = 1.0 / (likelihood[0] * prior_occupied + likelihood[1] * prior_free)
        prior_occupied *= eta * likelihood[0]
        prior_free *= eta * likelihood[1]
    far = 4.05 * np.array([math.cos(math.radians(30)), 0.0, -math.sin(math.radians(30))])
    index = np.floor(far / 0.1)
    window = mapper.voxels.window(Box.of(index * 0.1, (index + 1) * 0.1))
    assert window.probability.item() == pytest.approx(prior_occupied, rel=1e-6)
    assert prior_occupied == pytest.approx(0.56**3 / (0.56**3 + 0.44**3))


def test_equation_1_voxels_are_independent() -> None:
    """What the map held elsewhere changes nothing about how a voxel is updated."""
    ping = _ping(_geometry(), 1)
    pose = Pose(0.0, 0.0, 3.0)
    fresh, used = BayesMapper(SETTINGS), BayesMapper(SETTINGS)
    blocks = np.stack(np.meshgrid(range(8), range(-4, 4), range(-1, 4)), axis=-1).reshape(-1, 3)
    slots = used.voxels.allocate(blocks.astype(np.int32))
    before = np.random.default_rng(2).normal(0.0, 0.5, (len(slots), 512)).astype(np.float32)
    used.voxels.log_odds[slots] = before
    fresh.integrate(ping, pose)
    used.integrate(ping, pose)
    change = used.voxels.log_odds[slots] - before
    where = fresh.voxels.find(used.voxels.coords[slots])
    alone = np.where((where >= 0)[:, None], fresh.voxels.log_odds[where], 0.0)
    np.testing.assert_allclose(change, alone, atol=1e-6)


def test_evidence_is_clamped_and_unknown_stays_apart_from_undecided() -> None:
    geometry = _geometry()
    mapper = BayesMapper(SETTINGS)
    image = np.zeros((60, 24), np.float32)
    image[30, :] = 1.0
    for _ in range(50):
        mapper.integrate(Ping(image, geometry), Pose(0, 0, 0))
    values = mapper.voxels.log_odds
    assert values.max() == pytest.approx(log_odds(SETTINGS.bayes.p_max), rel=1e-6)
    assert values.min() == pytest.approx(log_odds(SETTINGS.bayes.p_min), rel=1e-6)
    shadow = (mapper.voxels.seen == IN_VIEW) & (values == 0.0)
    unknown = (mapper.voxels.seen == 0) & (values == 0.0)
    assert shadow.any() and unknown.any()


def test_only_pixels_over_the_threshold_count() -> None:
    image = np.array([[76.0, 77.0], [255.0, 0.0], [0.0, 200.0]], np.float32) / np.float32(255)
    counts, first = count_echoes(image, np.float32(76 / 255))
    np.testing.assert_array_equal(first, [1, 0])
    np.testing.assert_array_equal(counts, [[0, 0, 1, 1], [0, 1, 1, 2]])


def test_one_thread_and_two_make_the_same_map() -> None:
    maps = []
    for threads in (1, min(2, numba.get_num_threads())):
        numba.set_num_threads(threads)
        mapper = BayesMapper(SETTINGS)
        for k in range(5):
            mapper.integrate(_ping(_geometry(), k), Pose(0.4 * k, 0.0, 3.0, yaw_rad=0.1 * k))
        maps.append(mapper.voxels.log_odds.tobytes() + mapper.voxels.seen.tobytes())
    assert maps[0] == maps[1]


@pytest.mark.parametrize("azimuth_deg", [3.0, 29.0, 130.0, 179.0])
def test_no_block_of_the_fan_is_missed(azimuth_deg: float, rng: np.random.Generator) -> None:
    geometry = _geometry(azimuth=azimuth_deg)
    transform = world_from_sonar(Pose(1, 2, 3, 0.1, 0.2, 0.3), geometry.mount)
    found = set(map(tuple, blocks_in_fan(transform, geometry, 0.4).tolist()))
    azimuth = rng.uniform(-0.5, 0.5, 20000) * geometry.azimuth_fov_rad
    elevation = rng.uniform(-0.5, 0.5, 20000) * geometry.elevation_fov_rad
    ranges = rng.uniform(0.0, geometry.range_max_m, 20000)
    points = directions_from_angles(azimuth, elevation) * ranges[:, None]
    points = points @ transform[:3, :3].T + transform[:3, 3]
    needed = set(map(tuple, np.floor(points / 0.4).astype(int).tolist()))
    assert needed <= found
    assert len(found) < 4 * len(needed) + 200


@pytest.mark.parametrize(
    "bad", [{"voxel_m": 0.0}, {"p_free": 0.0001}, {"p_occupied": 0.4}, {"pixel_threshold": 256}]
)
def test_impossible_settings_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(ValidationError):
        MappingSettings.model_validate(bad)
