"""What made a voxel: against geometry by hand, and the maps that the same pings make."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from insonify.errors import ConfigError, GeometryError, MemoryLimitError, RecordingError
from insonify.io.recordings.recording import Recording
from insonify.mapping.bayes import BayesMapper
from insonify.mapping.carving import CarvingMapper
from insonify.mapping.factory import make_mapper
from insonify.mapping.mapper import Mapper, MappingSettings
from insonify.mapping.store import cell_of
from insonify.mapping.voxels import VoxelMap
from insonify.mission.explanation import Explanation, Played, explain_voxel, voxel_at
from insonify.report.cutouts import draw_glimpses
from insonify.types import FanGeometry, Float32, Ping, Pose, PosedPing

MOUNT = Pose(0.2, -0.1, 0.05, 0.1, 0.3, -0.2)
FAN = FanGeometry(math.radians(60.0), math.radians(20.0), 24, 60, 0.5, 5.0, MOUNT)
SETTINGS = MappingSettings(voxel_m=0.1)
Index = tuple[int, int, int]


def _image(rng: np.random.Generator) -> Float32:
    """Dark but for a band of echoes at one range, in some beams."""
    image = (0.1 * rng.random((FAN.bins, FAN.beams))).astype(np.float32)
    at = rng.integers(25, 50)
    image[at : at + 6, rng.random(FAN.beams) > 0.3] = 0.9
    return image


def _dive(seed: int, count: int, origin_m: tuple[float, float, float] = (0, 0, 0)) -> Recording:
    """Pings from all around, which look inwards."""
    rng = np.random.default_rng(seed)
    pings = []
    for k in range(count):
        around = rng.uniform(0.0, math.tau)
        pose = Pose(
            3.0 * math.cos(around), 3.0 * math.sin(around), rng.uniform(-0.3, 1.2),
            rng.uniform(-0.2, 0.2), rng.uniform(-0.2, 0.2), around + math.pi + rng.normal(0, 0.3),
        )  # fmt: skip
        pings.append(PosedPing(Ping(_image(rng), FAN, 0.5 * k), pose.moved(origin_m)))
    return Recording(Path("dive"), "made", count, True, {}, lambda: iter(pings))


def _mapped(name: str, recording: Recording, origin_m: tuple[float, float, float]) -> Mapper:
    mapper = make_mapper(name, SETTINGS)
    mapper.voxels.origin_m = origin_m
    for posed in recording:
        assert posed.pose is not None
        mapper.integrate(posed.ping, posed.pose.relative_to(origin_m))
    return mapper


def _explained(name: str, recording: Recording, voxel: Index) -> Explanation:
    saved = _mapped(name, recording, (0.0, 0.0, 0.0)).voxels
    played = [Played(recording, (7, recording.count - 7))]
    return explain_voxel(played, make_mapper(name, SETTINGS), SETTINGS, saved, voxel)


def _by_hand(posed: PosedPing, point_m: tuple[float, float, float]) -> tuple[float, float, float]:
    """Range, azimuth and elevation of a point, by scipy's rotations alone."""
    assert posed.pose is not None
    local = np.array(point_m)
    for frame in (posed.pose, MOUNT):
        turn = Rotation.from_euler("ZYX", [frame.yaw_rad, frame.pitch_rad, frame.roll_rad])
        local = turn.inv().apply(local - frame.position_m)
    range_m = float(np.linalg.norm(local))
    return range_m, math.atan2(local[1], local[0]), math.asin(local[2] / range_m)


@pytest.mark.parametrize("name", ["bayes", "carving"])
@pytest.mark.parametrize("voxel", [(0, 0, 0), (-3, 4, -6), (6, -2, -9)])
def test_the_pings_that_reach_a_voxel_are_those_whose_fan_holds_it(name: str, voxel: Index) -> None:
    dive = _dive(1, 40)
    told = _explained(name, dive, voxel)
    assert told.centre_m == pytest.approx([(c + 0.5) * 0.1 for c in voxel])
    reached = {one.number: one.pixels for one in told.glimpses if one.pixels is not None}
    inside = 0
    for number, posed in enumerate(dive, 1):
        range_m, azimuth, elevation = _by_hand(posed, told.centre_m)
        beam = (FAN.azimuth_fov_rad / 2 - azimuth) / FAN.beam_rad
        cell = (range_m - FAN.range_min_m) / FAN.bin_m
        held = 0 <= beam < FAN.beams and 0 <= cell < FAN.bins
        held = held and abs(elevation) < FAN.elevation_fov_rad / 2
        pixels = reached.get(number)
        if held:
            assert pixels is not None and pixels.centred
            assert pixels.beams[0] <= beam + 1e-3 and beam < pixels.beams[1] + 1 + 1e-3
            assert pixels.bins[0] <= cell + 1e-3 and cell < pixels.bins[1] + 1 + 1e-3
            near = (pixels.range_m, pixels.azimuth_rad, pixels.elevation_rad)
            assert near == pytest.approx((range_m, azimuth, elevation))
        else:
            assert pixels is None or not pixels.centred
        if range_m > FAN.range_max_m + 0.1 or abs(azimuth) > FAN.azimuth_fov_rad:
            assert pixels is None
        inside += held
    assert inside > 5


def test_what_pings_showed_adds_up_to_the_papers_map() -> None:
    dive, bayes = _dive(2, 60), SETTINGS.bayes
    odds = [math.log(p / (1 - p)) for p in (bayes.p_free, bayes.p_occupied)]
    least, most = (math.log(p / (1 - p)) for p in (bayes.p_min, bayes.p_max))
    saved = _mapped("bayes", dive, (0.0, 0.0, 0.0)).voxels
    pings, kinds = list(dive), set()
    for voxel in [(0, 0, 0), (1, 3, -4), (-2, 0, 2), (4, -4, -7), (-9, 2, -3)]:
        told = _explained("bayes", dive, voxel)
        assert told.differing == 0 and told.pings == 60
        by_hand = 0.0
        for one in told.glimpses:
            assert one.pixels is not None and one.brightest is not None
            (b0, b1), (c0, c1) = one.pixels.beams, one.pixels.bins
            image = pings[one.number - 1].ping.image
            part = image[c0 : c1 + 1, b0 : b1 + 1] > SETTINGS.pixel_threshold / 255
            before = image[: c1 + 1, b0 : b1 + 1] > SETTINGS.pixel_threshold / 255
            if part.any():
                by_hand, lit, dark = min(by_hand + odds[1], most), 1, 0
            elif not before.any() and one.pixels.whole:
                by_hand, lit, dark = max(by_hand + odds[0], least), 0, 1
            else:
                lit, dark = 0, 0
            assert (one.shown.lit, one.shown.dark, one.shown.parts) == (lit, dark, 1)
            assert one.shown.log_odds == pytest.approx(by_hand, abs=1e-5)
            assert (one.echo_m is None) == (not before[:c0].any())
            kinds.add(one.says.partition(" at ")[0])
        assert told.log_odds == saved.at(voxel)[0]
    assert {"lit: raised", "dark: lowered", "dark: as it was", "hidden by an echo"} <= kinds


@pytest.mark.parametrize("name", ["bayes", "carving"])
def test_watching_a_voxel_changes_nothing(name: str) -> None:
    dive = _dive(3, 25)
    plain, watched = make_mapper(name, SETTINGS), make_mapper(name, SETTINGS)
    assert isinstance(watched, BayesMapper | CarvingMapper)
    for posed in dive:
        assert posed.pose is not None
        plain.integrate(posed.ping, posed.pose)
        shown = watched.explain(posed.ping, posed.pose, (1, 2, -4))
        assert np.float32(shown.log_odds) == np.float32(plain.voxels.at((1, 2, -4))[0])
    assert np.array_equal(plain.voxels.coords, watched.voxels.coords)
    assert np.array_equal(plain.voxels.log_odds, watched.voxels.log_odds)
    assert np.array_equal(plain.voxels.seen, watched.voxels.seen)
    for key, array in plain.save().items():
        assert np.array_equal(array, watched.save()[key]), key


def _inside(mapper: CarvingMapper, voxel: Index) -> Float32:
    """Log-odds of the eight voxels inside one, from what the mapper saves."""
    kept, odds = mapper.save(), np.zeros(8, np.float32)
    for k, part in enumerate(2 * np.array(voxel) + np.argwhere(np.ones((2, 2, 2)))):
        at = np.flatnonzero((kept["fine_coords"] == part // 8).all(axis=1))
        if len(at):
            odds[k] = kept["fine_log_odds"][at[0], cell_of(part)]
    return odds


def test_carving_counts_its_voxels_inside() -> None:
    """Against the votes that the voxels inside are left with; dark ones at a clamp leave none."""
    lit = dark = 0
    for voxel in [(0, 0, 0), (1, 3, -4), (-2, 0, 2), (2, 1, -3)]:
        mapper, before = CarvingMapper(SETTINGS), np.zeros(8, np.float32)
        for posed in _dive(4, 25):
            assert posed.pose is not None
            shown = mapper.explain(posed.ping, posed.pose, voxel)
            after = _inside(mapper, voxel)
            assert shown.parts == 8
            assert shown.lit == (after > before).sum()
            clamped = (after == before) & (before == -6.0)
            freed = (after < before).sum()
            assert freed <= shown.dark <= freed + clamped.sum()
            before, lit, dark = after, lit + shown.lit, dark + shown.dark
    assert lit > 5 and dark > 5


def test_a_map_of_other_pings_is_told(rng: np.random.Generator) -> None:
    saved = _mapped("bayes", _dive(5, 20), (0.0, 0.0, 0.0)).voxels
    played = [Played(_dive(6, 20), (20,))]
    told = explain_voxel(played, BayesMapper(SETTINGS), SETTINGS, saved, (0, 0, -2))
    assert told.differing > 100 and told.replayed != told.log_odds


def test_far_from_the_origin_a_voxel_is_told_in_the_world() -> None:
    far = (500_000.0, 5_600_000.0, 0.0)
    dive = _dive(1, 20, far)
    saved = _mapped("bayes", dive, far).voxels
    voxel = voxel_at(saved, (far[0] - 0.25, far[1] + 0.45, -0.55))
    assert voxel == (-3, 4, -6)
    told = explain_voxel(
        [Played(dive, (20,))], BayesMapper(SETTINGS), SETTINGS, saved, voxel
    )  # fmt: skip
    assert told.differing == 0 and told.glimpses
    assert told.centre_m == pytest.approx((far[0] - 0.25, far[1] + 0.45, -0.55))


def test_states_and_the_surface() -> None:
    def told(log_odds: float, seen: int, marked: bool) -> tuple[str, bool | None]:
        one = Explanation((0, 0, 0), (0, 0, 0), log_odds, seen, marked, 0.0, 0, 0, ())
        return one.state, one.surface

    assert told(0.0, 0, False) == ("unknown", None)
    assert told(0.0, 1, False) == ("undecided", None)
    assert told(2.0, 3, True) == ("occupied", False)
    assert told(-2.0, 7, True) == ("free", True)


class Mute:
    """A mapper that cannot explain."""

    name = "mute"

    def __init__(self, settings: MappingSettings) -> None:
        self._bayes = BayesMapper(settings)
        self.voxels = self._bayes.voxels
        self.integrate, self.finish_scan = self._bayes.integrate, self._bayes.finish_scan
        self.tells, self.save, self.load = self._bayes.tells, self._bayes.save, self._bayes.load


def test_what_cannot_be_explained_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    dive = _dive(1, 10)
    saved = _mapped("bayes", dive, (0.0, 0.0, 0.0)).voxels

    def explain(mapper: Mapper, *scans: int) -> Explanation:
        return explain_voxel([Played(dive, scans)], mapper, SETTINGS, saved, (0, 0, 0))

    with pytest.raises(ConfigError, match=r"'mute' cannot say .*explain\(ping, pose, voxel\)"):
        explain(Mute(SETTINGS), 10)
    with pytest.raises(RecordingError, match="holds 10 pings, and the map was made of 12"):
        explain(BayesMapper(SETTINGS), 6, 6)
    monkeypatch.setattr("insonify.memory.free_bytes", lambda: 1000)
    with pytest.raises(MemoryLimitError, match="to make the map again"):
        explain(BayesMapper(SETTINGS), 10)
    for place in [(math.nan, 0, 0), (0, math.inf, 0)]:
        with pytest.raises(GeometryError, match="three finite numbers"):
            voxel_at(saved, place)
    with pytest.raises(GeometryError, match=r"\(99, 0, 0\) m lies outside the map, .* from \("):
        voxel_at(saved, (99.0, 0.0, 0.0))
    with pytest.raises(GeometryError, match="the map is empty"):
        voxel_at(VoxelMap(0.1), (0.0, 0.0, 0.0))


def test_the_picture_shows_the_pings_that_mattered_most() -> None:
    told = _explained("bayes", _dive(2, 60), (1, 3, -4))
    few = told.telling(3)
    assert len(few) == 3 and [one.number for one in few] == sorted(one.number for one in few)
    least = min(abs(one.change) for one in few)
    assert all(abs(one.change) <= least for one in told.glimpses if one not in few)
    for one in told.telling(99):
        assert one.pixels is not None and one.cutout is not None
        cell, beam = one.pixels.bins[0], one.pixels.beams[0]
        ping = next(p for k, p in enumerate(_dive(2, 60), 1) if k == one.number).ping
        at = one.cutout.image[cell - one.cutout.first_bin, beam - one.cutout.first_beam]
        assert at == ping.image[cell, beam]
    assert draw_glimpses(few, "title") == draw_glimpses(few, "title")
