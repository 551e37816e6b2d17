"""A run as a recording of the Rerun viewer, read back by Rerun's own library."""

from __future__ import annotations

import io
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from rerun.chunk import RrdReader
from typer.testing import CliRunner

from insonify.cli import app
from insonify.errors import InsonifyError
from insonify.io.maps import load_map, save_map
from insonify.io.maps.colours import probability_colours
from insonify.io.recordings import open_recording
from insonify.io.recordings.arrays import save_arrays
from insonify.mapping.voxels import VoxelMap
from insonify.mission.setup import scenario_config
from insonify.results.scan import load_run, run_scan
from insonify.types import Array, FanGeometry, Ping, Pose, PosedPing

pytestmark = pytest.mark.slow

MakeMap = Callable[..., VoxelMap]
SMALL = {"mapping": {"voxel_m": 0.3}, "survey": {"waypoints": 6}, "planner": "lawnmower"}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rerun") / "run"
    run_scan(scenario_config("tetrapod", [SMALL]), folder)
    return folder


def _export(*words: str) -> str:
    done = CliRunner().invoke(app, ["export", *words], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.output


def _rows(path: Path) -> dict[str, list[dict[str, Any]]]:
    """What is logged, by entity, in the order of the pings."""
    found: dict[str, list[dict[str, Any]]] = {}
    for chunk in RrdReader(str(path)).stream().to_chunks():
        rows = chunk.to_record_batch().to_pylist()
        found.setdefault(chunk.entity_path, []).extend(rows)
    return {
        name: sorted(rows, key=lambda row: row.get("ping") or 0) for name, rows in found.items()
    }


def _boxes(row: dict[str, Any]) -> tuple[Array, Array]:
    return np.array(row["Boxes3D:centers"]), np.array(row["Boxes3D:colors"], np.uint32)


def test_rerun_reads_pings_poses_and_the_map_as_it_grows(run: Path, tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    assert "observed voxels of 0.3 m" in _export(str(run), str(path))
    account, rows = load_run(run), _rows(path)
    pings = list(open_recording(run / "recording.mcap"))
    assert [row["ping"] for row in rows["/sonar"]] == list(range(1, len(pings) + 1))
    for row, posed in zip(rows["/world/vehicle"], pings, strict=True):
        assert posed.pose is not None
        np.testing.assert_allclose(row["Transform3D:translation"][0], posed.pose.position_m,
                                   rtol=1e-6)  # fmt: skip
    (flown,) = rows["/world/flown"][-1]["LineStrips3D:strips"]
    np.testing.assert_allclose(flown, [p.pose.position_m for p in pings if p.pose], rtol=1e-6)
    picture = Image.open(io.BytesIO(bytes(rows["/sonar"][0]["EncodedImage:blob"][0])))
    assert picture.size[0] == 480 and np.asarray(picture).max() > 200
    maps = rows["/world/map"]
    assert len(maps) > len(account.paths)
    centres, colours = _boxes(maps[-1])
    occupied = {tuple(np.round(place, 3)) for place in account.voxels.occupied_m()}
    shown = {tuple(np.round(place, 3)) for place in centres}
    assert shown <= occupied and len(shown) == len(centres)
    voxel_m = account.voxels.voxel_m
    beside = np.concatenate([np.eye(3), -np.eye(3)]) * voxel_m
    buried = {
        place for place in occupied
        if all(tuple(np.round(np.add(place, step), 3)) in occupied for step in beside)
    }  # fmt: skip
    assert shown == occupied - buried
    index = np.floor(centres[0] / voxel_m).astype(int)
    odds, _ = account.voxels.at((int(index[0]), int(index[1]), int(index[2])))
    red, green, blue, alpha = map(int, probability_colours(1 / (1 + np.exp(-np.array([odds]))))[0])
    assert colours[0] == (red << 24) | (green << 16) | (blue << 8) | alpha
    assert len(_boxes(maps[0])[0]) < len(centres)


def test_a_map_by_itself_has_no_pings(
    make_map: MakeMap, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    voxels = make_map(1)
    voxels.origin_m = (4.0e5, 6.0e6, 0.0)
    save_map(voxels, tmp_path / "m.npz")
    _export(str(tmp_path / "m.npz"), str(tmp_path / "m.rrd"))
    rows = _rows(tmp_path / "m.rrd")
    assert "/sonar" not in rows and not caplog.text
    centres, _ = _boxes(rows["/world/map"][0])
    assert 0 < len(centres) <= (voxels.log_odds > 0).sum() and np.abs(centres).max() < 100.0
    assert "(400000, 6000000, 0) m" in str(rows["/about"][0])


def test_pings_that_are_gone_or_have_no_pose_are_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    rng = np.random.default_rng(3)
    fan = FanGeometry(0.7, 0.2, 8, 16, 0.2, 2.0)
    images = (rng.random((4, 16, 8)) > 0.9).astype(np.float32)
    poses = [Pose(0.0, 0.1 * k, -2.0) for k in range(4)]
    save_arrays(
        tmp_path / "dive.npz",
        [PosedPing(Ping(image, fan, 1.7e9 + k), pose)
         for k, (image, pose) in enumerate(zip(images, poses, strict=True))],
    )  # fmt: skip
    folder = tmp_path / "m"
    done = CliRunner().invoke(app, ["map", str(tmp_path / "dive.npz"), "--out", str(folder)])
    assert done.exit_code == 0
    _export(str(folder), str(tmp_path / "a.rrd"))
    rows = _rows(tmp_path / "a.rrd")
    assert len(rows["/sonar"]) == 4 and rows["/sonar"][0]["time"].year == 2023
    assert len(_boxes(rows["/world/map"][-1])[0]) > 0 and load_map(folder).block_count
    (tmp_path / "dive.npz").unlink()
    caplog.clear()
    _export(str(folder), str(tmp_path / "b.rrd"))
    assert "there is no such recording" in caplog.text and "only the map is written" in caplog.text
    assert "/sonar" not in _rows(tmp_path / "b.rrd")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["none", "o.rrd"], "none: there is no such map"),
        (["run", "o.rrd", "--epsg", "32632"], "o.rrd: only a GeoTIFF"),
    ],
)
def test_bad_input(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], told: str
) -> None:
    monkeypatch.chdir(tmp_path)
    source = str(run) if words[0] == "run" else words[0]
    done = CliRunner().invoke(app, ["export", source, *words[1:]])
    assert isinstance(done.exception, InsonifyError)
    with pytest.raises(InsonifyError, match=told):
        raise done.exception
    assert not list(tmp_path.iterdir())


def test_without_rerun_the_sentence_says_how_to_get_it(run: Path, tmp_path: Path) -> None:
    code = (
        "import sys; sys.modules['rerun'] = None\n"
        f"sys.argv = ['insonify', 'export', {str(run)!r}, 'o.rrd']\n"
        "from insonify.cli import main\nmain()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert "rerun" in line and "pip install 'insonify[rerun]'" in line
    assert not list(tmp_path.iterdir())
