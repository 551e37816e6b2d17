"""Maps from recordings: the same as the mapper's own, and what is refused."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks import samples
from typer.testing import CliRunner

from insonify.cli import app
from insonify.errors import ConfigError, MemoryLimitError, RecordingError
from insonify.io.maps import save_map
from insonify.io.recordings import open_recording
from insonify.io.recordings.arrays import save_arrays
from insonify.io.recordings.recording import Reading, Recording, RecordingWarning
from insonify.mapping.bayes import BayesMapper
from insonify.mapping.mapper import MappingSettings
from insonify.mapping.voxels import VoxelMap
from insonify.mission.remap import echo_threshold, map_recordings
from insonify.mission.run import execute
from insonify.mission.setup import scenario_config
from insonify.planning.once import clearance_m, plan_next, turns_of
from insonify.report.map_html import write_map_report
from insonify.results.map import MapConfig, load_mapper, save_remap
from insonify.types import Box, FanGeometry, Ping, Pose, PosedPing, ScanPath

STARBOARD_FIRST = Reading(beams="starboard-to-port")

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "recordings"
FAN = FanGeometry(math.radians(40.0), math.radians(10.0), 8, 16, 0.2, 2.0)


def _pings(rng: np.random.Generator, count: int = 5) -> list[PosedPing]:
    images = (rng.random((count, 16, 8)) > 0.9).astype(np.float32)
    return [
        PosedPing(Ping(image, FAN, float(k)), Pose(0.0, 0.1 * k, -2.0, 0.0, 0.1, 0.2))
        for k, image in enumerate(images)
    ]


def _recording(pings: list[PosedPing]) -> Recording:
    return Recording(Path("made"), "made", len(pings), True, {}, lambda: iter(pings))


def test_a_replay_is_the_mappers_own_map(rng: np.random.Generator) -> None:
    pings = _pings(rng)
    settings = MappingSettings(voxel_m=0.05)
    replay = map_recordings([_recording(pings[:2]), _recording(pings[2:])], settings)
    mapper = BayesMapper(settings)
    for recorded in pings:
        assert recorded.pose is not None
        mapper.integrate(recorded.ping, recorded.pose)
    np.testing.assert_array_equal(replay.mapper.voxels.coords, mapper.voxels.coords)
    np.testing.assert_array_equal(replay.mapper.voxels.log_odds, mapper.voxels.log_odds)
    result = replay.result().to_json()
    assert result["pings"] == 5 and [s["mapped"] for s in result["recordings"]] == [2, 3]
    assert result["path_m"] == pytest.approx(0.4)
    assert result["occupied_voxels"] == result["region"]["occupied"] > 0


def test_pings_without_a_pose_are_left_out_and_told(rng: np.random.Generator) -> None:
    pings = _pings(rng)
    pings[1] = PosedPing(pings[1].ping)
    with pytest.warns(RecordingWarning, match="1 of 5 pings have no pose"):
        assert (
            map_recordings([_recording(pings)], MappingSettings()).result().to_json()["pings"] == 4
        )
    with pytest.raises(RecordingError, match=r"none of its 5 pings has a pose.*--poses"):
        map_recordings([_recording([PosedPing(p.ping) for p in pings])], MappingSettings())


def test_poses_of_another_time_are_told_from_none(tmp_path: Path) -> None:
    pings = [PosedPing(Ping(np.zeros((16, 8), np.float32), FAN, 50.0 + k)) for k in range(2)]
    save_arrays(tmp_path / "r.npz", pings)
    np.savetxt(tmp_path / "p.tum", samples.tum_rows(3))  # from 100 s on
    reading = Reading(poses=tmp_path / "p.tum")
    with pytest.raises(RecordingError, match=r"within the time of its poses.*--clock-offset"):
        map_recordings([open_recording(tmp_path / "r.npz", reading)], MappingSettings())
    late = Reading(poses=tmp_path / "p.tum", clock_offset_s=50.0)
    with pytest.warns(RecordingWarning, match="nothing is occupied"):
        replay = map_recordings([open_recording(tmp_path / "r.npz", late)], MappingSettings())
    assert replay.result().to_json()["pings"] == 2


def test_what_would_not_fit_is_refused_before_it_is_mapped(rng: np.random.Generator) -> None:
    with pytest.raises(MemoryLimitError, match="--voxel"):
        map_recordings([_recording(_pings(rng))], MappingSettings(voxel_m=1e-4))


def test_a_region_however_large_is_counted_and_drawn(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    pings = _pings(rng)
    small, huge = (
        map_recordings([_recording(pings)], MappingSettings(), Box((-e,) * 3, (e,) * 3))
        for e in (8.0, 5e5)
    )
    near, far = small.result().region, huge.result().region
    assert (far["in_view"], far["occupied"]) == (near["in_view"], near["occupied"])
    assert far["voxels"] == 10_000_000**3
    unseen = far["voxels"] - near["voxels"]  # of one bit each
    assert far["entropy_bits"] == pytest.approx(near["entropy_bits"] + unseen, rel=1e-15)
    window = huge.mapper.voxels.overview(huge.region)
    assert window.occupied.sum() > 0 and window.log_odds.size < 150_000_000
    save_remap(huge, tmp_path, MapConfig())
    assert not (tmp_path / "entropy.npz").exists() and (tmp_path / "report.html").is_file()
    assert (tmp_path / "map.npz").is_file()


def test_the_report_of_an_empty_sea(tmp_path: Path, rng: np.random.Generator) -> None:
    silent = [PosedPing(Ping(np.zeros((16, 8), np.float32), FAN), Pose(0.0, 0.0, -1.0))]
    save_arrays(tmp_path / "r.npz", silent)
    with pytest.warns(RecordingWarning, match="nothing is occupied: the brightest pixel is 0 of"):
        replay = map_recordings([open_recording(tmp_path / "r.npz")], MappingSettings())
    write_map_report(replay, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 3 + 3 + 6
    assert page.count("data:image/webp;base64,") == 1
    assert "http" not in page


def test_the_turtle_stands_out() -> None:
    """Seen along the sonar's elevation, its outline is a body with a head, not a blur."""
    path = DATA / "holoocean_turtle.npz"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    settings = MappingSettings(voxel_m=0.02, pixel_threshold=12)
    replay = map_recordings([open_recording(path, STARBOARD_FIRST)], settings)
    window = replay.mapper.voxels.window(replay.region)
    outline = np.asarray(window.occupied.any(axis=1))
    x, z = (np.unique(index) * 0.02 for index in np.nonzero(outline))
    assert 1.3 < np.ptp(x) < 1.7 and 0.9 < np.ptp(z) < 1.3
    # a slanted shape: it fills little of its box, and x tells z
    assert outline.sum() * 0.02**2 / (np.ptp(x) * np.ptp(z)) < 0.4
    assert np.asarray(np.corrcoef(np.argwhere(outline).T))[0, 1] > 0.85
    # along the elevation it is smeared over the arc of 12 degrees and the baseline, no more
    y = np.flatnonzero(window.occupied.any(axis=(0, 2))) * 0.02
    assert 0.6 < np.ptp(y) < 1.1


def test_the_next_scan_from_a_saved_map_is_the_missions_own(tmp_path: Path) -> None:
    coarse = {"mapping": {"voxel_m": 0.25}, "survey": {"waypoints": 6}}
    run = execute(scenario_config("tetrapod", [coarse, {"entropy": {"max_scans": 2}}]))
    first = execute(scenario_config("tetrapod", [coarse, {"entropy": {"max_scans": 1}}]))
    save_map(first.mapper.voxels, tmp_path / "map.npz")
    area, config = run.world.area, run.config
    decision = plan_next(
        load_mapper(tmp_path / "map.npz"),
        config.sonar.geometry,
        area.region,
        Pose(5.0, 5.0, area.z_m),
        config.entropy,
        config.survey.waypoints,
    )
    assert decision.path == run.paths[1]


def test_clearance_is_to_the_nearest_occupied_voxel() -> None:
    voxels = VoxelMap(1.0)
    slots = voxels.allocate(np.array([[0, 0, 0]], np.int32))
    voxels.log_odds[slots[0], 0] = 1.0  # centred at (0.5, 0.5, 0.5)
    path = ScanPath((Pose(-5.0, 4.5, 0.5), Pose(5.0, 4.5, 0.5)))
    distance = clearance_m(voxels, (Pose(-5.0, 9.0, 0.5), *path.waypoints))
    assert distance == pytest.approx(4.0 - math.sqrt(3.0) / 2)
    assert clearance_m(VoxelMap(1.0), (Pose(0, 0, 0), *path.waypoints)) == math.inf


def test_waypoints_are_where_a_way_or_its_heading_turns() -> None:
    straight = [Pose(0.25 * k, 0.5 * k, -3.0, yaw_rad=0.3) for k in range(9)]
    assert turns_of(straight) == (straight[0], straight[-1])
    corner = [*straight, Pose(2.0, 9.0, -3.0, yaw_rad=0.3)]
    assert turns_of(corner) == (straight[0], straight[-1], corner[-1])
    turning = [*straight[:4], *(replace(pose, yaw_rad=0.4) for pose in straight[4:])]
    assert turns_of(turning) == (turning[0], turning[3], turning[4], turning[-1])
    back = [straight[0], straight[4], straight[2]]
    assert turns_of(back) == tuple(back)
    assert turns_of(straight[:1]) == (straight[0],)


def _spot(dtype: str, loudest: float, path: Path) -> Path:
    """A bright spot of 3 x 3 pixels at 5 m in ten pings."""
    images = np.zeros((10, 100, 60))
    images[:, 49:52, 29:32] = loudest
    np.savez(
        path, images=images.astype(dtype), range_min_m=0.1, range_max_m=10.0, azimuth_deg=60.0,
        elevation_deg=20.0, columns="port_to_starboard", mount=np.zeros(6),
        pose_body=np.tile([0.0, 0.0, -5.0, 0.0, 0.0, 0.0], (10, 1)),
    )  # fmt: skip
    return path


@pytest.mark.parametrize(
    ("dtype", "loudest"), [("uint8", 255), ("float32", 255), ("uint16", 4095), ("float64", 60)]
)
def test_the_full_scale_of_pixels_is_asked_for(dtype: str, loudest: float, tmp_path: Path) -> None:
    """The same map by every type, if the full scale is said; else a refusal or a warning."""

    def occupied(path: Path, full_scale: float | None) -> int:
        recording = open_recording(path, Reading(full_scale=full_scale))
        return map_recordings([recording], MappingSettings()).result().occupied_voxels

    right = occupied(_spot("float32", 1.0, tmp_path / "r.npz"), None)
    assert right > 20
    path = _spot(dtype, loudest, tmp_path / "s.npz")
    assert occupied(path, float(loudest)) == right
    if dtype == "uint8":
        assert occupied(path, None) == right
    elif dtype == "uint16":
        with pytest.warns(RecordingWarning, match=r"go up to 4095 only, so .* 12 bits.*--scale"):
            assert occupied(path, None) == right
    else:
        with pytest.raises(RecordingError, match=rf"s\.npz.*up to {loudest}, above.*--scale"):
            occupied(path, None)


@pytest.mark.parametrize("kind", ["int8", "int16", "uint32", "int64"])
def test_whole_pixels_of_any_type(kind: str, tmp_path: Path) -> None:
    remap = map_recordings(
        [open_recording(_spot("uint8", 255, tmp_path / "a.npz"))], MappingSettings()
    )
    loudest = int(np.iinfo(kind).max) if kind in {"int8", "int16"} else (1 << 24) - 1
    path = _spot(kind, loudest, tmp_path / "b.npz")
    recording = open_recording(path)
    assert ("24 bits" in str(recording.facts["doubts"])) == (kind in {"uint32", "int64"})
    reading = Reading(full_scale=float(loudest))
    same = map_recordings([open_recording(path, reading)], MappingSettings())
    assert same.result().occupied_voxels == remap.result().occupied_voxels > 20


@pytest.mark.filterwarnings("ignore::insonify.io.recordings.recording.RecordingWarning")
def test_what_the_user_says_of_an_archive_overrules_it(tmp_path: Path) -> None:
    """Columns, mount and the axes of poses."""
    images = np.zeros((3, 100, 60), np.uint8)
    images[:, 49:52, 4:7] = 255  # a tenth of the fan in
    path = tmp_path / "a.npz"
    np.savez(
        path, images=images, range_min_m=0.0, range_max_m=10.0, azimuth_deg=60.0,
        elevation_deg=2.0, columns="port_to_starboard", mount=np.zeros(6),
        pose_body=np.tile([1.0, 2.0, 5.0, 0.0, 0.0, 0.0], (3, 1)),
    )  # fmt: skip

    def spot(**said: object) -> list[float]:
        remap = map_recordings([open_recording(path, Reading(**said))], MappingSettings())  # type: ignore[arg-type]
        return [float(c) for c in remap.mapper.voxels.occupied_m().mean(axis=0)]

    side, ahead = 5.05 * math.sin(math.radians(24.5)), 5.05 * math.cos(math.radians(24.5))
    with pytest.warns(RecordingWarning, match="5 to 5 m above 0"):
        assert spot() == pytest.approx([1.0 + ahead, 2.0 + side, 5.0], abs=0.15)
    with pytest.warns(RecordingWarning, match="above the water"):
        right = spot(beams="starboard-to-port")
    assert right == pytest.approx([1.0 + ahead, 2.0 - side, 5.0], abs=0.15)
    # north 1, east 2, 5 m deep, looking north
    assert spot(convention="ned") == pytest.approx([2.0 - side, 1.0 + ahead, -5.0], abs=0.15)
    over = Pose(0.0, 0.0, -10.0, math.pi, 0.0, 0.0)
    assert spot(mount=over) == pytest.approx([1.0 + ahead, 2.0 - side, -5.0], abs=0.15)


def test_the_threshold_of_a_recordings_own_noise(tmp_path: Path) -> None:
    """Above the noise of the loudest recording, and recorded in the result."""
    rng = np.random.default_rng(0)
    paths = []
    for name, sigma in (("a", 4.0), ("b", 8.0)):
        images = rng.rayleigh(sigma, (6, 80, 40)).clip(0, 255)
        images[:, 50:54, 20:24] = 250
        paths.append(tmp_path / f"{name}.npz")
        np.savez(
            paths[-1], images=images.astype(np.uint8), range_min_m=0.0, range_max_m=8.0,
            azimuth_deg=40.0, elevation_deg=10.0, columns="port_to_starboard", mount=np.zeros(6),
            pose_body=np.tile([0.0, 0.0, -5.0, 0.0, 0.0, 0.0], (6, 1)),
        )  # fmt: skip
    quiet, loud = (echo_threshold([open_recording(path)]) for path in paths)
    assert 4 * 4.0 < quiet < 8 * 4.0 and 4 * 8.0 < loud < 8 * 8.0
    run = CliRunner().invoke
    out = tmp_path / "m"
    told = run(app, ["map", *map(str, paths), "--threshold", "auto", "--out", str(out), "--json"])
    assert json.loads(told.stdout)["mapping"]["pixel_threshold"] == loud
    assert f"Threshold: {loud} of 255" in told.stderr
    assert f"pixel_threshold = {loud}" in (out / "config.toml").read_text()
    bad = run(app, ["map", str(paths[0]), "--threshold", "loud", "--out", str(tmp_path / "n")])
    assert isinstance(bad.exception, ConfigError) and "whole number" in str(bad.exception)
