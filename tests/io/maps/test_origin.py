"""Maps far from the world's origin: the same voxels, in every format."""

from __future__ import annotations

import json
import math
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
import trimesh
from typer.testing import CliRunner

from insonify.cli import app
from insonify.errors import GeometryError, MapFileError, OutputError
from insonify.io.datum import Datum
from insonify.io.folders import result_file
from insonify.io.maps import LOADED, SAVED, load_map, save_map
from insonify.io.recordings import open_recording
from insonify.mapping.mapper import MappingSettings
from insonify.mapping.voxels import VoxelMap
from insonify.mission.remap import map_recordings
from insonify.types import Array, Box

UTM = (600_000.0, 5_500_000.0, 0.0)
MakeMap = Callable[..., VoxelMap]


def _recording(path: Path, shift_m: tuple[float, float, float]) -> Path:
    """A few pings with a bright spot and a line, from places that are 1/64 m apart."""
    images = np.zeros((8, 100, 60), np.uint8)
    images[:, 49:52, 29:32] = 255
    images[:, 70, 5:50] = 200
    poses = np.array([[k / 64, -k / 32, -5.0 + k / 128, 0.0, 0.1, 0.2] for k in range(8)])
    poses[:, :3] += shift_m
    np.savez(
        path, images=images, range_min_m=0.0, range_max_m=10.0, azimuth_deg=60.0,
        elevation_deg=20.0, columns="port_to_starboard", mount=np.zeros(6), pose_body=poses,
    )  # fmt: skip
    return path


def _mapped(folder: Path, shift_m: tuple[float, float, float], voxel_m: float) -> VoxelMap:
    recording = open_recording(_recording(folder / "r.npz", shift_m))
    return map_recordings([recording], MappingSettings(voxel_m=voxel_m)).mapper.voxels


def _world(voxels: VoxelMap) -> Array:
    return np.sort(voxels.occupied_m(), axis=0) + voxels.origin_m


@pytest.mark.parametrize(
    ("shift_m", "voxel_m"),
    [(UTM, 0.125), ((6e5 + 12.5, 5.5e6 - 37.25, -30.0), 0.0625), ((1e7, -1e7, 0.0), 1 / 64)],
)
def test_the_same_voxels_after_shifting(
    tmp_path: Path, shift_m: tuple[float, float, float], voxel_m: float
) -> None:
    near, far = (_mapped(tmp_path, shift, voxel_m) for shift in ((0.0, 0.0, 0.0), shift_m))
    assert near.origin_m == (0.0, 0.0, 0.0) and far.origin_m != near.origin_m
    assert all(c % far.block_m == 0.0 for c in far.origin_m)
    assert len(near.occupied_m()) > 50
    np.testing.assert_array_equal(_world(far) - shift_m, _world(near))


def test_two_centimetres_at_ten_thousand_kilometres(tmp_path: Path) -> None:
    """Whatever can be read back gives the same bytes of blocks, and the origin to the last bit."""
    far = _mapped(tmp_path, (1e7, -1e7 / 3, 0.0), 0.02)
    for suffix in LOADED:
        save_map(far, tmp_path / f"m{suffix}")
        back = load_map(tmp_path / f"m{suffix}")
        assert back.origin_m == far.origin_m and back.voxel_m == far.voxel_m
        np.testing.assert_array_equal(_world(back), _world(far))
        again = load_map(tmp_path / f"m{suffix}", Box((3.0, -9.0, -9.0), (9.0, 9.0, 9.0)))
        assert again.origin_m == far.origin_m


def _places(voxels: VoxelMap, path: Path) -> Array:
    """Where things are in the world by a file, read by other means than ours."""
    save_map(voxels, path)
    if path.suffix in LOADED:
        return _world(load_map(path))
    if path.suffix == ".ply":
        head, _, data = path.read_bytes().partition(b"end_header\n")
        kinds = {"float": "<f4", "double": "<f8", "uchar": "u1"}
        fields = [line.split()[1:] for line in head.decode().splitlines() if "property" in line]
        points = np.frombuffer(data, [(name, kinds[kind]) for kind, name in fields])
        return np.column_stack([points[axis].astype(np.float64) for axis in "xyz"])
    if path.suffix == ".glb":
        scene = trimesh.load_scene(path)
        (node,) = scene.graph.nodes_geometry
        transform, name = scene.graph[node]
        vertices = np.asarray(scene.geometry[name].vertices, np.float64)
        upright = vertices @ transform[:3, :3].T + transform[:3, 3]
        return np.asarray(upright @ np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]))
    if path.suffix == ".stl":
        beside = path.with_name(path.name + ".origin.json")
        origin = json.loads(beside.read_text())["origin_m"] if beside.is_file() else (0, 0, 0)
        mesh: Any = trimesh.load_mesh(path)
        return np.asarray(mesh.triangles, np.float64).reshape(-1, 3) + origin
    if path.suffix == ".tif":
        with tifffile.TiffFile(path) as file:
            page: Any = file.pages[0]
            west, north = page.tags[33922].value[3:5]
            cell = page.tags[33550].value[0]
            heights = file.asarray()[0]
        rows, columns = np.nonzero(np.isfinite(heights))
        across = west + (columns + 0.5) * cell, north - (rows + 0.5) * cell
        return np.column_stack([*across, heights[rows, columns]])
    assert path.suffix == ".xyz"
    return np.loadtxt(path)[:, :3]


@pytest.mark.parametrize("suffix", [suffix for suffix in SAVED if suffix != ".vdb"])
def test_every_format_tells_the_world(
    tmp_path: Path, suffix: str, caplog: pytest.LogCaptureFixture
) -> None:
    near = _places(_mapped(tmp_path, (0.0, 0.0, 0.0), 0.125), tmp_path / f"near{suffix}")
    far = _places(_mapped(tmp_path, UTM, 0.125), tmp_path / f"far{suffix}")
    assert len(near) > 50
    np.testing.assert_allclose(far - UTM, near, rtol=0, atol=1e-6)
    told = [record.getMessage() for record in caplog.records if "relative to" in record.message]
    assert len(told) == (suffix in {".ot", ".bt", ".stl"})


def test_openvdb_tells_the_world(tmp_path: Path) -> None:
    python = Path("/usr/bin/python3")
    code = "import pyopenvdb"
    if not python.exists() or subprocess.run([python, "-c", code], capture_output=True).returncode:
        pytest.skip("needs Debian's python3-openvdb (.ci/run installs it)")
    far = _mapped(tmp_path, UTM, 0.125)
    save_map(far, tmp_path / "m.vdb")
    code = (
        "import sys, pyopenvdb; grids, _ = pyopenvdb.readAll(sys.argv[1]);"
        "print(*grids[0].transform.indexToWorld((8, 16, -24)))"
    )
    done = subprocess.run(
        [python, "-c", code, tmp_path / "m.vdb"], capture_output=True, text=True, check=True
    )
    told = [float(word) for word in done.stdout.split()]
    index = np.array([8, 16, -24]) + 0.5
    assert told == (index * 0.125 + far.origin_m).tolist()


def test_an_origin_beside_a_file_belongs_to_it(tmp_path: Path, make_map: MakeMap) -> None:
    """It is replaced with the file, refused where it would be lost, and checked."""
    target, beside = tmp_path / "m.bt", tmp_path / "m.bt.origin.json"
    far = make_map(1, blocks=4, reach=3)
    far.origin_m = (1e6, 2e6, 0.0)
    with result_file(target) as scratch:
        save_map(far, scratch)
    assert json.loads(beside.read_text()) == {"origin_m": [1e6, 2e6, 0.0]}
    target.unlink()
    with pytest.raises(OutputError, match="already exists"), result_file(target) as scratch:
        pass
    far.origin_m = (0.0, 0.0, 0.0)
    with result_file(target, force=True) as scratch:
        save_map(far, scratch)
    assert not beside.exists() and load_map(target).origin_m == (0.0, 0.0, 0.0)
    for words in ("{}", '{"origin_m": [1, 2]}', '{"origin_m": [1, 2, NaN]}', "[", '{"origin_m":3}'):
        beside.write_text(words)
        with pytest.raises(MapFileError, match="origin"):
            load_map(target)


def test_geotiff_in_a_system_of_the_register(tmp_path: Path) -> None:
    far = _mapped(tmp_path, UTM, 0.125)
    save_map(far, tmp_path / "m.tif", epsg=32632)
    with tifffile.TiffFile(tmp_path / "m.tif") as file:
        page: Any = file.pages[0]
        assert page.geotiff_tags["ProjectedCSTypeGeoKey"] == 32632
        assert page.tags[33922].value[3] == pytest.approx(600_000.0, abs=20.0)
    with pytest.raises(OutputError, match="--epsg"):
        save_map(far, tmp_path / "d.tif", datum=Datum(50.0, 9.0))


def test_the_commands_speak_of_the_world(tmp_path: Path) -> None:
    """Map, export and plan at UTM coordinates, regions and poses as the user has them."""
    run = CliRunner().invoke
    told = {}
    for name, shift in (("near", (0.0, 0.0, 0.0)), ("far", UTM)):
        recording = _recording(tmp_path / f"{name}.npz", shift)
        x, y, _ = shift
        region = f"{x} {y - 3} -8 {x + 9} {y + 3} -2"
        out = tmp_path / name
        done = run(app, ["map", str(recording), "--voxel", "0.125", "--out", str(out),
                         "--region", region, "--json"])  # fmt: skip
        result = json.loads(done.stdout)
        assert result["region_m"] == [[x, y - 3, -8.0], [x + 9, y + 3, -2.0]]
        assert run(app, ["export", str(out), str(tmp_path / f"{name}.bt")]).exit_code == 0
        done = run(app, ["plan", str(out), "--from", f"{x} {y} -5 0", "--clearance", "0", "--out",
                         str(tmp_path / f"plan-{name}"), "--set", "entropy.termination=0",
                         "--datum", "50 9", "--json"])  # fmt: skip
        told[name] = json.loads(done.stdout)
        told[name]["csv"] = np.genfromtxt(
            tmp_path / f"plan-{name}" / "path.csv", delimiter=",", skip_header=1
        )
    for key in ("from", "start", "cluster_centre_m"):
        moved = np.subtract(told["far"][key][:3], told["near"][key][:3])
        np.testing.assert_allclose(moved, UTM, atol=2e-4)
    assert told["far"]["length_m"] == told["near"]["length_m"]
    moved = told["far"]["csv"] - told["near"]["csv"]
    np.testing.assert_allclose(moved[:, 1:4], np.tile(UTM, (len(moved), 1)), atol=2e-6)
    np.testing.assert_allclose(moved[:, 4:], 0.0, atol=1e-6)  # the datum is the map's origin
    assert math.isfinite(told["far"]["clearance_m"])


def test_places_too_far_apart_for_one_map_are_refused(tmp_path: Path) -> None:
    near = open_recording(_recording(tmp_path / "near.npz", (0.0, 0.0, 0.0)))
    far = open_recording(_recording(tmp_path / "far.npz", (5e5, 6e6, 0.0)))
    with pytest.raises(GeometryError, match=r"far\.npz: a ping lies 6000.* km from where"):
        map_recordings([near, far], MappingSettings())
    apart = open_recording(_recording(tmp_path / "n.npz", (3e4, 0.0, 0.0)))
    box = Box((0.0, -5.0, -9.0), (9.0, 5.0, -1.0))
    both = map_recordings([near, apart], MappingSettings(), box)
    save_map(both.mapper.voxels, tmp_path / "m.npz")
    assert len(load_map(tmp_path / "m.npz").occupied_m()) == both.result().occupied_voxels
