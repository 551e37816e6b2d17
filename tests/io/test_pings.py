"""Pings, sweeps and routes on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from insonify.errors import RecordingError
from insonify.io.pings import load_ping, save_ping
from insonify.io.routes import Route, read_route
from insonify.scene.experiments import tank
from insonify.sonar import Sonar
from insonify.sonar.devices import SonarDevice
from insonify.types import Pose, PosedPing

DEVICE = SonarDevice(beams=16, bins=64, azimuth_fov_deg=40, range_max_m=8, tilt_deg=12)
POSE = Pose(-3.0, 0.25, -2.0, 0.1, 0.2, 0.3)


def test_a_ping_with_truth_comes_back_as_it_was(tmp_path: Path) -> None:
    sonar, scene = Sonar(DEVICE), tank()
    ping, truth = sonar.ping(scene, POSE, time_s=1.5), sonar.truth(scene, POSE)
    save_ping(tmp_path / "a.npz", PosedPing(ping, POSE), truth)
    back, told = load_ping(tmp_path / "a.npz")
    np.testing.assert_array_equal(back.ping.image, ping.image)
    assert (back.ping.geometry, back.ping.time_s, back.pose) == (ping.geometry, 1.5, POSE)
    assert told is not None and told.labels == truth.labels
    for name in ("label", "elevation_rad", "range_m", "point_m", "first_return", "shadow"):
        np.testing.assert_array_equal(getattr(told, name), getattr(truth, name))
    save_ping(tmp_path / "b.npz", PosedPing(ping, POSE), truth)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_damaged_pings_are_named(tmp_path: Path) -> None:
    path = tmp_path / "ping.npz"
    save_ping(path, PosedPing(Sonar(DEVICE).ping(tank(), POSE), POSE))
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(60):
        broken = bytearray(whole[: rng.integers(len(whole))] if rng.random() < 0.5 else whole)
        for at in rng.integers(0, max(len(broken), 1), 12):
            if at < len(broken):
                broken[at] = rng.integers(256)
        path.write_bytes(broken)
        try:
            load_ping(path)
        except RecordingError as err:
            assert str(path) in str(err)
    with pytest.raises(RecordingError, match="no such file"):
        load_ping(tmp_path / "none.npz")


def test_a_tum_file_gives_the_same_angles_as_scipy(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    turns = Rotation.random(20, rng=rng)
    lines = [
        f"{100 + k / 10} {k} {-k} 3 " + " ".join(f"{value:.12f}" for value in turn.as_quat())
        for k, turn in enumerate(turns)
    ]
    path = tmp_path / "poses.tum"
    path.write_text("# time x y z qx qy qz qw\n" + "\n".join(lines))
    route = read_route(path)
    assert route.timed
    for k, (row, turn) in enumerate(zip(route.rows, turns, strict=True)):
        assert row[:4] == pytest.approx((k / 10, k, -k, 3))
        expected = turn.as_euler("ZYX", degrees=True)[::-1]
        assert row[4:] == pytest.approx(expected, abs=1e-6)


def test_a_csv_file_needs_positions_only(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    path.write_text("x_m,y_m,z_m,yaw_deg\n1,2,-3,90\n\n4,5,-6,-90\n")
    assert read_route(path) == Route(((0, 1, 2, -3, 0, 0, 90), (1, 4, 5, -6, 0, 0, -90)), False)
    path.write_text("time_s,x_m,y_m,z_m\n0,1,2,3\n2.5,1,2,3\n")
    assert read_route(path) == Route(((0, 1, 2, 3, 0, 0, 0), (2.5, 1, 2, 3, 0, 0, 0)), True)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no poses"),
        ("x_m,y_m,z_m\n", "no poses"),
        ("x_m,y_m\n1,2\n", "z_m"),
        ("x_m,y_m,z_m,roll\n1,2,3,4\n", "'roll'"),
        ("x_m,y_m,z_m\n1,2,nan\n", "line 2"),
        ("x_m,y_m,z_m\n1,2,3\n1,2\n", "line 3"),
        ("time_s,x_m,y_m,z_m\n1,1,2,3\n1,1,2,3\n", "1 s does not follow 1 s"),
        ("0 1 2 3 0 0 0 0\n", "quaternion"),
        ("0 1 2 3 0 0 0\n", "7 numbers; a pose is eight"),
        ("a b c d e f g h\n", "no poses"),
        ("0 1 2 3 0 0 0 x\n", "line 1"),
        ("\x00\x01", "no poses"),
    ],
)
def test_bad_routes_name_the_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "poses.txt"
    path.write_text(text)
    with pytest.raises(RecordingError, match=message) as raised:
        read_route(path)
    assert str(path) in str(raised.value)
