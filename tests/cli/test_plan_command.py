"""Plans that people fly: the way there keeps clear of what is mapped."""

from __future__ import annotations

import csv
import json
import math
import socket
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from benchmarks.autopilot import autopilot
from hypothesis import given, settings
from hypothesis import strategies as st

from insonify.cli.plans import way_there
from insonify.errors import GeometryError
from insonify.io.maps import load_map, save_map
from insonify.mapping.store import cell_of
from insonify.mapping.voxels import VoxelMap
from insonify.types import Pose, ScanPath

FROM = "-9 0 -2 0"
ASKED = ["--sonar", "park-2025", "--region", "-3 -3 -6 9 3 1", "--set", "entropy.termination=0"]


def _walled(folder: Path, width_m: float, height_m: float = 4.0) -> Path:
    """A map of a free box with a wall across x = -3 and undecided voxels east of it."""
    voxels = VoxelMap(0.25)
    blocks = [(x, y, z) for x in range(-6, 5) for y in range(-3, 3) for z in range(-4, 2)]
    slots = voxels.allocate(np.array(blocks, np.int32))
    voxels.log_odds[slots] = -2.0
    voxels.seen[slots] = 5
    within = np.indices((8, 8, 8)).reshape(3, -1).T
    order = np.argsort(cell_of(within))  # as voxels lie in a block
    centres = (8 * np.array(blocks)[:, None] + within[order] + 0.5) * 0.25
    wall = np.abs(centres[..., 0] + 3.0) < 0.3
    wall &= np.abs(centres[..., 1]) < width_m / 2
    wall &= np.abs(centres[..., 2] + 2.0) < height_m / 2
    voxels.log_odds[slots] = np.where(wall, 3.0, voxels.log_odds[slots])
    unknown = np.linalg.norm(centres - np.array([4.0, 0.0, -4.0]), axis=-1) < 1.5
    voxels.log_odds[slots] = np.where(unknown, 0.0, voxels.log_odds[slots])
    save_map(voxels, folder / "map.npz")
    return folder / "map.npz"


def _plan(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "insonify", "plan", "map.npz", "--from", FROM, *ASKED, *arguments],
        cwd=cwd, capture_output=True, text=True, check=False,
    )  # fmt: skip


def _least_m(rows: list[dict[str, str]], file: Path) -> float:
    """Least distance of a flown path to an occupied voxel's corner, by points along it."""
    corners = [np.array(FROM.split(), float)[:3]]
    corners += [np.array([float(row[name]) for name in ("x_m", "y_m", "z_m")]) for row in rows]
    points = np.concatenate([np.linspace(a, b, 400) for a, b in pairwise(corners)])
    occupied = load_map(file).occupied_m()
    apart = np.linalg.norm(points[:, None] - occupied[None], axis=2).min()
    return float(apart) - 0.25 * math.sqrt(3.0) / 2


def test_the_way_there_leads_round_a_wall(tmp_path: Path) -> None:
    file = _walled(tmp_path, width_m=6.0)
    done = _plan("--out", "p", "--json", "--picture", "p.png", "--speed", "0.4", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    rows = list(csv.DictReader((tmp_path / "p/path.csv").read_text().splitlines()))
    assert document["detour"] and document["waypoints"] == len(rows) > 2
    assert document["speed_mps"] == 0.4 and document["pings"] == 40
    straight_m = math.dist(document["start"][:3], [float(word) for word in FROM.split()[:3]])
    assert document["transit_m"] > straight_m + 0.3
    assert _least_m(rows, file) >= 0.4
    assert document["clearance_m"] == pytest.approx(_least_m(rows, file), abs=0.01)
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")


def test_a_straight_way_and_scan_are_two_waypoints(tmp_path: Path) -> None:
    _walled(tmp_path, width_m=0.0)
    done = _plan("--out", "p", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert (document["detour"], document["waypoints"]) == (False, 2)


def test_figures_are_told_in_words_and_units(tmp_path: Path) -> None:
    _walled(tmp_path, width_m=6.0)
    done = _plan("--out", "p", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    for words in ("yaw 0 degrees (compass 90)", "round what is mapped", "40 pings", "0.5 m/s"):
        assert words in done.stdout
    assert "[" not in done.stdout and "_m" not in done.stdout


@settings(max_examples=500, deadline=None)
@given(
    occupied=st.lists(
        st.tuples(*(st.integers(-14, 14) for _ in range(2)), st.integers(-3, 3)), max_size=40
    ),
    ends=st.tuples(*(st.tuples(*(st.floats(-4.0, 4.0) for _ in range(2))) for _ in range(3))),
    clearance_m=st.floats(0.1, 1.5),
)
def test_no_way_comes_nearer_than_the_clearance(
    occupied: list[tuple[int, int, int]], ends: tuple[tuple[float, float], ...], clearance_m: float
) -> None:
    """Whatever is mapped, a way keeps off it, by points along it, or there is none."""
    voxels = VoxelMap(0.25)
    cells = np.array(occupied, np.int64).reshape(-1, 3)
    slots = voxels.allocate((cells // 8).astype(np.int32))
    voxels.log_odds[slots, cell_of(cells)] = 2.0
    pose, start, end = (Pose(x, y, 0.1) for x, y in ends)
    try:
        way = way_there(voxels, pose, ScanPath((start, end)), clearance_m)
    except GeometryError:
        return
    corners = np.array([one.position_m for one in (pose, *way, end)])
    points = np.concatenate([np.linspace(a, b, 200) for a, b in pairwise(corners)])
    centres = (cells + 0.5) * 0.25
    apart = np.linalg.norm(points[:, None] - centres, axis=2).min(initial=np.inf)
    assert apart - 0.25 * math.sqrt(3.0) / 2 >= clearance_m - 1e-9
    assert way[-1] == start


def test_a_plan_of_its_own_name_and_one_that_nobody_takes(tmp_path: Path) -> None:
    _walled(tmp_path, width_m=6.0)
    refused = _plan("--out", "next.plan", cwd=tmp_path)
    assert refused.returncode == 2 and "--datum" in refused.stderr
    done = _plan("--out", "next.plan", "--datum", "41.5 -71.3", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    schema = json.loads(
        (Path(__file__).parents[1] / "io/qgroundcontrol_plan.schema.json").read_text()
    )
    plan = json.loads((tmp_path / "next.plan").read_text())
    jsonschema.validate(plan, schema)
    mission = plan["mission"]
    assert [item["command"] for item in mission["items"]][:2] == [178, 16]
    assert json.loads(done.stdout)["files"] == ["next.plan"]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        address = f"udp:127.0.0.1:{taken.getsockname()[1]}"
        lost = _plan("--datum", "41.5 -71.3", "--upload", address, cwd=tmp_path)
    assert lost.returncode == 2 and "Traceback" not in lost.stderr and address in lost.stderr


def test_an_autopilot_is_given_the_plan_and_none_that_comes_too_near(tmp_path: Path) -> None:
    pytest.importorskip("pymavlink")
    _walled(tmp_path, width_m=6.0)
    with autopilot() as pilot:
        words = ["--datum", "41.5 -71.3", "--upload", f"udp:127.0.0.1:{pilot.port}"]
        near = _plan(*words, "--clearance", "20", "--out", "near", cwd=tmp_path)
        assert near.returncode == 2 and "20 m is the least" in near.stderr
        assert not pilot.counts and not (tmp_path / "near").exists()
        done = _plan(*words, "--out", "p", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["uploaded_to"].endswith("system 7")
    items = json.loads((tmp_path / "p/path.plan").read_text())["mission"]["items"]
    assert set(pilot.counts) == {len(items) + 1} and len(pilot.items) == len(items) + 1  # home too
    assert [one.command for one in pilot.items[1:]] == [item["command"] for item in items]
