"""``insonify simulate`` as a person would type it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from insonify.errors import RecordingError
from insonify.io.pings import load_ping
from insonify.io.recordings import load_pings, open_recording
from insonify.io.recordings.recording import Reading
from insonify.types import Pose

pytestmark = pytest.mark.slow

DATA = Path(__file__).resolve().parents[3] / "shared/data"
FAST = ["--set", "sonar.beams=32", "--set", "sonar.bins=100", "--set", "sampling.refine=1"]


def _run(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "insonify", *words],
        cwd=cwd,
        capture_output=True,
        text=True,
        check=False,
    )


def test_a_mesh_gives_images_arrays_and_truth(tmp_path: Path) -> None:
    trimesh.creation.box((2.0, 2.0, 2.0)).export(tmp_path / "box.stl")
    words = ["simulate", "box.stl", "--pose", "-5 0 0 0 0 0", "--sonar", "didson", "--truth"]
    done = _run(*words, *FAST, "--out", "out", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["labels"] == ["box"] and result["pings"][0]["pixels"]["box"] > 10
    posed, truth = load_ping(tmp_path / "out/pings/0000.npz")
    assert posed.ping.image.shape == (100, 32) and truth is not None
    first = np.flatnonzero((posed.ping.image > 0.3).any(axis=1))[0]
    near, far = posed.ping.geometry.bin_ranges_m[[first - 1, first + 1]]
    assert near <= 4.0 <= far
    for kind in ("fan", "polar", "truth"):
        with Image.open(tmp_path / f"out/pictures/0000-{kind}.png") as picture:
            assert min(picture.size) > 300
    again = _run(
        "simulate", "--config", "out/config.toml", "--truth", "--out", "again", cwd=tmp_path
    )
    assert again.returncode == 0, again.stderr
    for name in ("pings/0000.npz", "pictures/0000-fan.png"):
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "again" / name).read_bytes()


def test_a_path_of_a_scanning_and_a_side_scan_sonar(tmp_path: Path) -> None:
    (tmp_path / "path.csv").write_text("x_m,y_m,z_m\n-1,0,-2\n1,0,-2\n")
    for sonar, arrays, picture in (
        ("micron-dst", ["0000.npz", "0001.npz"], "0001-deskewed.png"),
        ("sidescan", ["0000-port.npz", "0000-starboard.npz", "0001-port.npz"], "sidescan.png"),
        ("profiler", ["0000.npz", "0001.npz"], "soundings.png"),
    ):
        coarse = ["--set", "sonar.bins=200"]
        coarse += ["--set", "sonar.step_deg=20"] if sonar == "micron-dst" else []
        words = ["simulate", "tank", "--sonar", sonar, "--path", "path.csv", *coarse]
        done = _run(*words, "--out", sonar, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert all((tmp_path / sonar / "pings" / name).is_file() for name in arrays)
        assert (tmp_path / sonar / "pictures" / picture).is_file()
        assert "tank" in done.stdout


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["simulate"], "name a world"),
        (["simulate", "tank"], "--pose"),
        (["simulate", "nowhere.world", "--pose", "0 0 0 0 0 0"], "nowhere.world"),
        (["simulate", "tank", "--pose", "0 0 nan 0 0 0"], "nan"),
        (["simulate", "tank", "--pose", "0 0 0"], "6 finite numbers"),
        (["simulate", "tank", "--pose", "a b c d e f"], "--pose"),
        (["simulate", "tank", "--path", "none.csv"], "none.csv"),
        (["simulate", "tank", "--pose", "0 0 0 0 0 0", "--path", "a"], "not several"),
        (["simulate", "tank", "--orbit", "0 0 -2 2 1.5 0"], "whole COUNT"),
        (["simulate", "fls-tank", "--sonar", "nonesuch"], "nonesuch"),
        (["simulate", "fls-tank", "--model", "magic"], "magic"),
        (["simulate", "fls-tank", "--set", "sonar.range_max_m=0.1"], "range_max_m"),
        (["simulate", "fls-tank", "--materials", "none.toml"], "none.toml"),
        (["simulate", "tank", "--pose", "0 0 -2 0 0 0", "--sonar", "sidescan", "--camera"], "side"),
        (["scan", "tetrapod", "--sonar", "ping360"], "forward-looking"),
    ],
)
def test_bad_input_is_one_sentence_and_leaves_nothing(
    words: list[str], message: str, tmp_path: Path
) -> None:
    done = _run(*words, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert message in done.stderr and "Traceback" not in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_without_opengl_it_says_what_to_do(tmp_path: Path) -> None:
    program = (
        "import sys; sys.modules['moderngl'] = None\n"
        "from insonify.cli import main\n"
        "sys.argv = ['insonify', 'simulate', 'fls-tank', '--renderer', 'opengl']\n"
        "main()"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2 and list(tmp_path.iterdir()) == []
    assert "insonify[opengl]" in done.stderr and "--renderer embree" in done.stderr


@pytest.mark.skipif(not DATA.is_dir(), reason="the data beside the project is not here")
def test_the_sunken_ship_and_the_missing_mesh(tmp_path: Path) -> None:
    world = str(DATA / "worlds/sunken_ship_site.world")
    pose = ["--sonar", "gemini-720i", "--pose", "-12 0 -55 0 15 0"]
    done = _run("simulate", world, *pose, "--truth", "--json", "--out", "ship", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (row,) = json.loads(done.stdout)["pings"]
    assert row["pixels"]["wreck"] > 1000 and row["pixels"]["herkules_seabed"] > 100_000
    assert row["shadow_pixels"] > 20_000
    missing = str(DATA / "worlds/herkules_ship_wreck.world")
    done = _run("simulate", missing, *pose, cwd=tmp_path)
    assert done.returncode == 2 and "herkules.dae" in done.stderr


def test_turns_of_a_scanning_sonar_are_a_recording(tmp_path: Path) -> None:
    """Each ping is a fan of one beam where its head looked."""
    words = ["simulate", "msis-tank", "--out", "s", "--set", "sonar.sector_deg=20", "--mcap"]
    assert _run(*words, cwd=tmp_path).returncode == 0
    done = _run("info", "s", "--picture", "turn.png", "--json", cwd=tmp_path)
    (fan,) = json.loads(done.stdout)["fans"]
    assert fan["mount_turns_deg"][2][0] < -8.0 and fan["mount_turns_deg"][2][1] > 8.0
    with Image.open(tmp_path / "turn.png") as picture:
        assert picture.size[0] > 100
    done = _run("map", "s", "--out", "m", "--voxel", "0.2", "--json", cwd=tmp_path)
    assert json.loads(done.stdout)["occupied_voxels"] > 20
    recording = open_recording(tmp_path / "s")
    turns = [one.ping for one in recording]
    assert len(turns) == recording.count > 5
    heads = [ping.head_rad for ping in turns]
    yaws = [ping.geometry.mount.yaw_rad for ping in turns]
    assert yaws == pytest.approx(heads) and heads[0] > 0.1 > -0.1 > heads[-1]
    same = [one.ping for one in open_recording(tmp_path / "s", Reading(mount=Pose(0, 0, 0)))]
    assert [one.geometry.mount.yaw_rad for one in same] == pytest.approx(yaws)
    for options in ({"beams": "starboard-to-port"}, {"full_scale": 100.0}):
        with pytest.raises(RecordingError, match=r"--(beams|scale)"):
            open_recording(tmp_path / "s", Reading(**options))
    whole = np.load(next((tmp_path / "s/pings").glob("*.npz")))["raw"]
    np.testing.assert_array_equal(np.concatenate([ping.image for ping in turns], 1), whole)
    replayed = [one.ping for one in open_recording(tmp_path / "s/pings.mcap")]
    assert [one.geometry for one in replayed] == [one.geometry for one in turns]
    for topic in (None, "/odometry"):
        with pytest.raises(RecordingError, match="--beams"):
            reading = Reading(beams="starboard-to-port", pose_topic=topic)
            open_recording(tmp_path / "s/pings.mcap", reading)
    # by the standard messages alone
    told = list(open_recording(tmp_path / "s/pings.mcap", Reading(pose_topic="/odometry")))
    assert [one.ping.geometry.mount.yaw_rad for one in told] == pytest.approx(yaws, abs=1e-9)


def test_what_was_simulated_maps_like_a_recording(tmp_path: Path) -> None:
    """A wall 4 m ahead, seen on the way past: occupied voxels lie on it, none before it."""
    wall = trimesh.creation.box((0.2, 8.0, 6.0))
    wall.apply_translation((4.1, 0.0, 0.0))
    wall.export(tmp_path / "wall.stl")
    rows = "".join(f"{k / 10},{0.0},{-1.0 + 0.2 * k},0,0,0,0\n" for k in range(11))
    (tmp_path / "way.csv").write_text("time_s,x_m,y_m,z_m,roll_deg,pitch_deg,yaw_deg\n" + rows)
    words = ["simulate", "wall.stl", "--path", "way.csv", "--out", "s", *FAST]
    words += ["--set", "sonar.range_max_m=8", "--set", "timed=false"]
    done = _run(*words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    told = _run("info", "s", "--json", cwd=tmp_path)
    assert json.loads(told.stdout)["poses"] == 11, told.stderr
    done = _run("map", "s", "--voxel", "0.1", "--out", "m", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    from insonify import load_map

    x = load_map(tmp_path / "m").occupied_m()[:, 0]
    assert len(x) > 100
    assert x.min() > 3.5 and x.max() < 4.3


def test_many_pings_are_one_archive_with_some_pictures(tmp_path: Path) -> None:
    head = "x_m,y_m,z_m,roll_deg,pitch_deg,yaw_deg"
    rows = [f"{0.01 * k},0,-1,0,20,0" for k in range(120)]
    words = ["simulate", "tank", "--sonar", "didson", "--range", "8", *FAST]
    for out, count in (("one", 120), ("each", 6)):
        (tmp_path / "path.csv").write_text("\n".join([head, *rows[:count]]))
        done = _run(*words, "--path", "path.csv", "--out", out, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in (tmp_path / "one").iterdir()) == [
        "config.toml", "pictures", "pings.npz", "result.json",
    ]  # fmt: skip
    assert len(list((tmp_path / "one/pictures").iterdir())) == 20
    assert len(list((tmp_path / "each/pings").iterdir())) == 6
    for one, other in zip(
        load_pings(tmp_path / "one"), load_pings(tmp_path / "each"), strict=False
    ):
        assert one.ping.image.tobytes() == other.ping.image.tobytes()
        assert (one.pose, one.ping.geometry) == (other.pose, other.ping.geometry)
        assert one.ping.time_s == other.ping.time_s
        assert one.ping.geometry.range_max_m == 8.0
    recording = open_recording(tmp_path / "one")
    assert (recording.format, recording.count) == ("result of simulate", 120)
