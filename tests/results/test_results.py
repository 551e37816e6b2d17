"""Results as files: read back as they were, older ones too, without running anything again."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import insonify.mission.run
import insonify.results.scan
from insonify.config.toml import config_to_toml
from insonify.errors import InsonifyError, OutputError, ResultError
from insonify.io.decisions import load_decisions
from insonify.io.recordings.recording import Recording
from insonify.mapping.factory import make_mapper
from insonify.mapping.mapper import MappingSettings
from insonify.mission.explanation import differing
from insonify.mission.remap import map_recordings
from insonify.mission.result import MapResult, ScanResult, TourResult
from insonify.mission.run import Run, execute
from insonify.mission.setup import scenario_config
from insonify.report.html import write_report
from insonify.results.files import load_result
from insonify.results.map import MapConfig, load_mapper, save_remap
from insonify.results.scan import is_scan, load_run, run_scan, save_scan
from insonify.types import FanGeometry, Ping, Pose, PosedPing, StopReason

pytestmark = pytest.mark.slow

SMALL = {"mapping": {"voxel_m": 0.25}, "survey": {"waypoints": 8}}


@pytest.fixture(scope="module")
def scanned(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Path]:
    runs: list[Run] = []
    folder = tmp_path_factory.mktemp("results") / "run"
    run_scan(scenario_config("tetrapod", [SMALL]), folder, watch=lambda run, step: runs.append(run))
    return runs[-1], folder


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Path]:
    runs: list[Run] = []
    folder = tmp_path_factory.mktemp("results") / "flown"
    quick = {"planner": "uniform", "survey": {"baseline_scans": 1, "approach_m": 2.0}}
    config = scenario_config("tetrapod", [SMALL, quick, {"vehicle": {"name": "bluerov2"}}])
    run_scan(config, folder, watch=lambda run, step: runs.append(run))
    return runs[-1], folder


def test_figures_come_back_as_they_were(scanned: tuple[Run, Path], flown: tuple[Run, Path]) -> None:
    for run, folder in (scanned, flown):
        back = load_result(folder)
        assert isinstance(back, ScanResult)
        assert back == run.result()
        assert load_result(folder / "result.json") == back
        text = json.loads((folder / "result.json").read_text())
        assert (text["kind"], text["schema_version"]) == ("scan", 1)
        assert text["stop_reason"] in {reason.value for reason in StopReason}
        assert "." not in text["stop_reason"]  # a name, not a sentence


def test_a_row_is_flat(scanned: tuple[Run, Path]) -> None:
    row = scanned[0].result().to_row()
    assert all(isinstance(value, str | int | float | bool) for value in row.values())
    scores = scanned[0].history[-1].metrics["solid"]["exact"]
    assert row["metrics_solid_exact_f1"] == scores["f1"]
    assert (row["scenario"], row["stop_reason"]) == ("tetrapod", scanned[0].stop_reason.value)


def test_a_run_is_read_back_without_running_it(
    scanned: tuple[Run, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither its planner nor its mesh is asked for."""

    def never(*given: object, **more: object) -> None:
        raise AssertionError("a run was executed")

    monkeypatch.setattr(insonify.mission.run, "execute", never)
    monkeypatch.setattr(insonify.mission.run, "World", never)
    run, folder = scanned
    there, back = run.account(), load_run(folder, with_keyframes=True)
    assert back.paths == there.paths
    assert back.region == there.region and back.result == there.result
    np.testing.assert_array_equal(back.truth.solid, there.truth.solid)
    np.testing.assert_array_equal(back.truth.scored, there.truth.scored)
    assert back.truth.box == there.truth.box
    assert [solid.name for solid in back.solids] == [solid.name for solid in there.solids]
    for ours, theirs in zip(back.solids, there.solids, strict=True):
        np.testing.assert_allclose(ours.vertices, theirs.vertices, atol=1e-5)
        np.testing.assert_array_equal(ours.faces, theirs.faces)
    for mine, other in zip(back.decisions, there.decisions, strict=True):
        assert mine.pings == other.pings
        assert mine.decision.path == other.decision.path
        assert mine.decision.stop == other.decision.stop
        look = other.decision.look
        if look is not None:
            assert mine.decision.look is not None
            np.testing.assert_array_equal(mine.decision.look.h_sum, look.h_sum)
            np.testing.assert_array_equal(
                mine.decision.look.cluster.voxels_m, look.cluster.voxels_m
            )
            assert mine.decision.look.candidates == look.candidates
            assert mine.decision.look.cluster.entropy == look.cluster.entropy
        if other.entropy_bits is not None:
            assert mine.entropy_bits is not None
            np.testing.assert_array_equal(mine.entropy_bits, other.entropy_bits)
    assert len(back.keyframes) == len(there.keyframes) == 3 * len(run.paths)
    for (scan, posed), (number, kept) in zip(back.keyframes, there.keyframes, strict=True):
        assert scan == number and posed.pose == kept.pose
        np.testing.assert_array_equal(posed.ping.image, kept.ping.image)


def test_the_report_of_the_files_is_that_of_the_run(
    scanned: tuple[Run, Path], flown: tuple[Run, Path], tmp_path: Path
) -> None:
    for run, folder in (scanned, flown):
        write_report(load_run(folder, with_keyframes=True), tmp_path / "again.html")
        again = (tmp_path / "again.html").read_text(encoding="utf-8")
        first = (folder / "report.html").read_text(encoding="utf-8")
        if run.flight is None:
            assert again == first
        else:  # its track went through a table of nine digits
            assert len(again) == pytest.approx(len(first), rel=0.01)


def test_a_track_comes_back_to_nine_digits(flown: tuple[Run, Path]) -> None:
    assert flown[0].flight is not None
    there, back = flown[0].flight.track.moments, load_run(flown[1]).moments
    assert len(back) == len(there) > 10
    for mine, other in zip(back, there, strict=True):
        assert mine.true.position_m == pytest.approx(other.true.position_m, rel=1e-7)
        assert mine.estimated.yaw_rad == pytest.approx(other.estimated.yaw_rad, abs=1e-7)
        assert other.covariance is not None and mine.covariance is not None
        np.testing.assert_allclose(mine.covariance, other.covariance, rtol=1e-7, atol=1e-12)


def test_a_figure_file_of_version_0_1_is_read(scanned: tuple[Run, Path], tmp_path: Path) -> None:
    old = json.loads((scanned[1] / "result.json").read_text())
    for key in ("kind", "schema_version", "insonify", "region_m"):
        del old[key]
    old["stop_reason"] = StopReason(old["stop_reason"]).sentence
    (tmp_path / "result.json").write_text(json.dumps(old))
    back = load_result(tmp_path)
    assert isinstance(back, ScanResult)
    assert back.stop_reason is scanned[0].stop_reason and back.region_m is None
    tour = {
        "world": "tank", "vehicle": "bluerov2", "seed": 0, "time_s": 1.0, "path_m": 0.5,
        "stop_reason": StopReason.PLAN_FLOWN.sentence, "pose_error": {}, "pings": {"fls": 3},
    }  # fmt: skip
    (tmp_path / "result.json").write_text(json.dumps(tour))
    flown = load_result(tmp_path)
    assert isinstance(flown, TourResult) and flown.stop_reason is StopReason.PLAN_FLOWN
    mapped = {
        "recordings": [], "pings": 1, "path_m": 0.0, "fans": [], "mapping": {"voxel_m": 0.1},
        "occupied_voxels": 1, "region_m": [[0, 0, 0], [1, 1, 1]], "region": {}, "seconds": {},
    }  # fmt: skip
    (tmp_path / "result.json").write_text(json.dumps(mapped))
    assert isinstance(load_result(tmp_path), MapResult)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "cannot be read as a result"),
        ("[]", "holds no result"),
        ("{}", "does not say what kind"),
        ('{"kind": "scan", "schema_version": 99}', "'scan' of version 99"),
        ('{"schema_version": 1}', "None of version 1"),
        ('{"kind": "dance", "schema_version": 1}', "'dance'"),
        ('{"kind": "scan", "schema_version": 1}', "field required"),
    ],
)
def test_what_is_no_result_is_one_sentence(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "result.json").write_text(text)
    with pytest.raises(ResultError, match=words) as caught:
        load_result(tmp_path)
    assert str(tmp_path) in str(caught.value) and "\n" not in str(caught.value)
    with pytest.raises(ResultError, match="no such result"):
        load_result(tmp_path / "none")


def test_parts_of_an_earlier_result_go_with_it(
    scanned: tuple[Run, Path], flown: tuple[Run, Path], tmp_path: Path
) -> None:
    """A track or a mapper's state that stayed would be read as the new run's."""
    folder = tmp_path / "run"
    shutil.copytree(flown[1], folder)
    (folder / "mapper.npz").write_bytes(b"of another mapper")
    (folder / "notes.txt").write_text("mine")
    run_scan(scenario_config("tetrapod", [SMALL]), folder, force=True)
    assert {path.name for path in folder.iterdir()} == {
        "notes.txt", *(path.name for path in scanned[1].iterdir())
    }  # fmt: skip
    assert load_run(folder).moments == ()
    assert load_mapper(folder).name == "bayes"


def test_a_run_without_a_recording_is_read_back(scanned: tuple[Run, Path], tmp_path: Path) -> None:
    save_scan(scanned[0], tmp_path)
    assert is_scan(tmp_path)
    back = load_run(tmp_path, with_keyframes=True)
    assert back.keyframes == () and len(back.decisions) == len(scanned[0].decisions)


def test_pictures_of_a_scan_that_was_cut_short_are_the_same(tmp_path: Path) -> None:
    runs: list[Run] = []
    asked = iter(range(1, 100))
    run_scan(
        scenario_config("tetrapod", [SMALL]),
        tmp_path / "run",
        watch=lambda run, step: runs.append(run),
        should_stop=lambda: next(asked) >= 13,
    )
    back = load_run(tmp_path / "run", with_keyframes=True).keyframes
    assert [(scan, posed.pose) for scan, posed in back] == [
        (scan, posed.pose) for scan, posed in runs[-1].keyframes
    ]
    assert [scan for scan, _ in back] == [1, 1, 1, 2, 2]


def test_a_map_of_another_mapper_than_its_config_names_is_refused(
    scanned: tuple[Run, Path], tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    shutil.copytree(scanned[1], folder)
    text = (folder / "result.json").read_text()
    (folder / "result.json").write_text(text.replace('"mapper": "bayes"', '"mapper": "carver"'))
    with pytest.raises(ResultError, match="names mapper 'bayes', and the map was made by 'carver'"):
        load_mapper(folder)


@pytest.mark.parametrize("name", ["bayes", "carving"])
def test_the_voxels_of_a_mapper_that_goes_on_follow_later_pings(
    name: str, tmp_path: Path, rng: np.random.Generator
) -> None:
    fan, settings = FanGeometry(0.7, 0.2, 8, 16, 0.2, 2.0), MappingSettings(voxel_m=0.1)
    images = (rng.random((8, 16, 8)) > 0.9).astype(np.float32)
    pings = [
        PosedPing(Ping(image, fan), Pose(2e4 + 0.2 * k, 0.0, -2.0))
        for k, image in enumerate(images)
    ]
    recording = Recording(Path("made"), "made", 5, True, {}, lambda: iter(pings[:5]))
    remap = map_recordings([recording], settings, mapper=make_mapper(name, settings))
    save_remap(remap, tmp_path, MapConfig(mapper=name, mapping=settings))
    again = load_mapper(tmp_path)
    assert again.voxels.origin_m == remap.mapper.voxels.origin_m != (0.0, 0.0, 0.0)
    for posed in pings[5:]:
        assert posed.pose is not None
        for mapper in (remap.mapper, again):
            mapper.integrate(posed.ping, posed.pose.relative_to(again.voxels.origin_m))
    assert differing(again.voxels, remap.mapper.voxels) == 0
    assert again.voxels.block_count == remap.mapper.voxels.block_count


def test_a_scan_that_a_mappers_fault_keeps_from_being_saved_is_not_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def faulty(run: Run, folder: Path, phase: object) -> ScanResult:
        raise ZeroDivisionError

    with monkeypatch.context() as patched, pytest.raises(ZeroDivisionError):
        patched.setattr(insonify.results.scan, "save_scan", faulty)
        run_scan(scenario_config("tetrapod", [SMALL]), tmp_path / "run")
    (kept,) = tmp_path.iterdir()
    assert (kept / "new/recording.mcap").stat().st_size > 100_000
    result, _ = run_scan(scenario_config("tetrapod", [SMALL]), tmp_path / "run")
    assert [path.name for path in tmp_path.iterdir()] == ["run"] and result.scans > 1


def test_a_run_that_lacks_its_decisions_is_refused(
    scanned: tuple[Run, Path], tmp_path: Path
) -> None:
    folder = tmp_path / "old"
    shutil.copytree(scanned[1], folder)
    (folder / "decisions.npz").unlink()
    with pytest.raises(ResultError, match="older version"):
        load_run(folder)


def test_damaged_decisions_and_truth_are_named(scanned: tuple[Run, Path], tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for name in ("decisions.npz", "truth.npz"):
        folder = tmp_path / name
        shutil.copytree(scanned[1], folder)
        whole = (folder / name).read_bytes()
        for _ in range(40):
            broken = bytearray(whole[: rng.integers(len(whole))] if rng.random() < 0.5 else whole)
            for at in rng.integers(0, max(len(broken), 1), 12):
                if at < len(broken):
                    broken[at] = rng.integers(256)
            (folder / name).write_bytes(broken)
            try:
                load_run(folder)
            except InsonifyError as err:
                assert str(folder / name) in str(err)


def test_decisions_of_a_planner_that_flew_nothing(tmp_path: Path) -> None:
    from insonify.io.decisions import save_decisions

    save_decisions(tmp_path / "d.npz", [], [])
    assert load_decisions(tmp_path / "d.npz") == ((), ())


def test_run_scan_is_the_run_and_leaves_nothing_beside_it(
    scanned: tuple[Run, Path], tmp_path: Path
) -> None:
    config = scenario_config("tetrapod", [SMALL])
    result, folder = run_scan(config, tmp_path / "a")
    alone: Any = execute(config).result()
    assert result.model_copy(update={"seconds": {}}) == alone.model_copy(update={"seconds": {}})
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert (folder / "config.toml").read_text() == config_to_toml(config, "scan")
    assert (folder / "map.npz").read_bytes() == (scanned[1] / "map.npz").read_bytes()
    with pytest.raises(OutputError, match="--force"):
        run_scan(config, tmp_path / "a")
