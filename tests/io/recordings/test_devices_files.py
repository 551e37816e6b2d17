"""ARIS and Oculus files: made ones in closed form, and real ones against what is known of them."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from benchmarks import samples

from insonify.errors import RecordingError
from insonify.io.recordings import open_recording
from insonify.io.recordings.aris import beam_azimuths_rad
from insonify.io.recordings.recording import Reading, RecordingWarning
from insonify.io.recordings.summary import summarise
from insonify.sonar.devices import SonarDevice

DATA = Path(__file__).resolve().parents[4] / "shared" / "data" / "recordings"
BEARINGS = np.array([-20.0, -13.0, -6.5, 0.0, 6.5, 13.0, 20.0])


def _real(name: str) -> Path:
    if not (DATA / name).is_file():
        pytest.skip(f"{DATA / name} is not there")
    return DATA / name


def _file(folder: Path, name: str, data: bytes) -> Path:
    (folder / name).write_bytes(data)
    return folder / name


def test_aris_ranges_times_and_sides(tmp_path: Path, rng: np.random.Generator) -> None:
    images = np.zeros((3, 40, 48), np.uint8)
    images[1, 7, 0] = 255  # beam 0 is the rightmost
    path = _file(tmp_path, "a.aris", samples.aris(images, speed=1500.0, delay=2000, period=20))
    recording = open_recording(path)
    pings = [recorded.ping for recorded in recording]
    assert recording.count == len(pings) == 3
    geometry = pings[0].geometry
    assert geometry.range_min_m == pytest.approx(1.5)  # 2000 us there and back at 1500 m/s
    assert geometry.bin_m == pytest.approx(0.015)
    assert np.argwhere(pings[1].image > 0).tolist() == [[7, 47]]
    assert np.diff([ping.time_s for ping in pings]) == pytest.approx(0.15)
    assert pings[1].image.max() == 1.0


def test_aris_beams_that_are_not_even_end_near_where_they_looked(tmp_path: Path) -> None:
    true = beam_azimuths_rad(2, 48, False)
    for beam in range(48):
        image = np.zeros((1, 4, 48), np.uint8)
        image[0, :, beam] = 255
        path = _file(tmp_path, "a.aris", samples.aris(image, telephoto=0))
        (recorded,) = open_recording(path)
        columns = np.flatnonzero(recorded.ping.image[0])
        geometry = recorded.ping.geometry
        for column in columns:
            # its centre lies in the beam's own sector
            azimuth = geometry.beam_azimuths_rad[column] + geometry.mount.yaw_rad
            assert np.argmin(abs(true - azimuth)) == beam
    assert true[0] < 0.0 < true[-1]
    assert np.degrees(true[-1]) == pytest.approx(13.5735, abs=0.02)  # the SDK's table
    assert np.degrees(beam_azimuths_rad(1, 128, False)[-1]) == pytest.approx(14.705, abs=0.07)


def test_aris_elevation_and_tilt_come_from_the_device(tmp_path: Path) -> None:
    path = _file(tmp_path, "a.aris", samples.aris(np.zeros((1, 4, 48), np.uint8)))
    device = SonarDevice(name="mine", elevation_fov_deg=3.0, tilt_deg=20.0)
    (recorded,) = open_recording(path, Reading(device))
    assert recorded.ping.geometry.elevation_fov_rad == pytest.approx(math.radians(3.0))
    assert recorded.ping.geometry.tilt_rad == pytest.approx(math.radians(20.0))


def test_a_damaged_aris_gives_what_can_be_read(tmp_path: Path) -> None:
    whole = samples.aris(np.ones((3, 10, 48), np.uint8))
    cut = _file(tmp_path, "cut.aris", whole[:-5])
    with pytest.warns(RecordingWarning, match="cut off in frame 3; the 2 whole ones"):
        assert len(list(open_recording(cut))) == 2
    broken = bytearray(whole)
    broken[1024 + 1024 + 480 + 12] ^= 1  # the second frame's version
    path = _file(tmp_path, "broken.aris", bytes(broken))
    with pytest.warns(RecordingWarning, match=r"frame 2 begins .* the 1 frames before"):
        assert len(list(open_recording(path))) == 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda raw: raw[:500], "not an ARIS recording"),
        (lambda raw: raw[:1024], "no frames"),
        (lambda raw: raw[:2100], "cut off in its first frame"),
        (lambda raw: b"DDF\x04" + raw[4:], "no known format"),
        (lambda raw: raw[: 1024 + 436] + b"\x63" + raw[1024 + 437 :], "ping mode 99"),
        (lambda raw: raw[: 1024 + 468] + b"\xff" * 4 + raw[1024 + 472 :], "samples a beam"),
        (lambda raw: raw[: 1024 + 464] + b"\0" * 4 + raw[1024 + 468 :], "sound speed of 0"),
        (lambda raw: raw[: 1024 + 516] + b"\0" * 4 + raw[1024 + 520 :], "order of the beams"),
        (lambda raw: raw[: 1024 + 484] + b"\x01" + raw[1024 + 485 :], "no beam directions"),
    ],
)
def test_an_unusable_aris_is_one_sentence(
    tmp_path: Path, change: Callable[[bytes], bytes], words: str
) -> None:
    path = _file(tmp_path, "a.aris", change(samples.aris(np.ones((2, 10, 48), np.uint8))))
    with pytest.raises(RecordingError, match=words):
        list(open_recording(path))


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("gain", [False, True])
@pytest.mark.parametrize("kind", ["u1", "u2", "u4"])
def test_oculus_versions_gains_and_depths(
    tmp_path: Path, rng: np.random.Generator, version: int, gain: bool, kind: str
) -> None:
    image = samples.pixels(rng, 9, 7).astype(kind) * (np.iinfo(kind).max // 255)
    other = samples.oculus(image, BEARINGS, version=version, gain=gain)
    skipped = bytearray(other)
    struct.pack_into("<H", skipped, 6, 0x80)  # a message of another kind
    path = _file(tmp_path, "o.raw", other + bytes(skipped) + other)
    pings = [recorded.ping for recorded in open_recording(path)]
    assert len(pings) == 2
    np.testing.assert_allclose(pings[1].image, image / np.iinfo(kind).max, atol=1e-6)
    assert pings[0].geometry.bin_m == pytest.approx(0.01)
    assert pings[0].geometry.range_min_m == 0.0


def test_oculus_column_0_is_port(tmp_path: Path) -> None:
    image = np.zeros((4, 7), np.uint8)
    image[2, 0] = 200
    path = _file(tmp_path, "o.raw", samples.oculus(image, BEARINGS))
    ((recorded),) = list(open_recording(path))
    assert np.argwhere(recorded.ping.image > 0).tolist() == [[2, 0]]
    assert recorded.ping.geometry.beam_azimuths_rad[0] > 0.0  # to the left


def test_a_damaged_oculus_file_gives_its_whole_pings(tmp_path: Path) -> None:
    one = samples.oculus(np.ones((5, 7), np.uint8), BEARINGS)
    path = _file(tmp_path, "o.raw", one + b"noise" + one + one[:-3])
    with pytest.warns(RecordingWarning, match="1 pings left out, bytes skipped at 1 places"):
        assert open_recording(path).count == 2
    bad = bytearray(one)
    struct.pack_into("<H", bad, 106, 60000)  # more rows than bytes
    with pytest.warns(RecordingWarning), pytest.raises(RecordingError, match="no whole Oculus"):
        open_recording(_file(tmp_path, "bad.raw", bytes(bad)))


def test_the_real_aris_recording() -> None:
    summary, middle = summarise(open_recording(_real("sample.aris")))
    (fan,) = summary["fans"]
    assert (summary["pings"], fan["beams"], fan["bins"]) == (6, 48, 2000)
    says = summary["says"]
    assert says["window_start_m"] == pytest.approx(3.33, abs=0.005)
    assert says["window_length_m"] == pytest.approx(20.3, abs=0.005)
    assert says["sound_speed_mps"] == pytest.approx(1435.9, abs=0.05)
    assert says["tilt_deg"] == pytest.approx(-2.25, abs=0.005)
    assert fan["range_min_m"] == pytest.approx(3.297621, abs=1e-5)
    assert fan["range_max_m"] == pytest.approx(23.400688, abs=1e-5)
    assert says["lens"] == "telephoto"
    assert middle is not None and middle.image.shape == (2000, 48)


@pytest.mark.parametrize(
    ("name", "pings"), [("oculus_one_ping_8bit.raw", 1), ("oculus_three_pings_8bit.raw", 3)]
)
def test_the_real_oculus_recordings(name: str, pings: int) -> None:
    summary, _ = summarise(open_recording(_real(name)))
    (fan,) = summary["fans"]
    assert (summary["pings"], fan["beams"], fan["bins"]) == (pings, 256, 703)
    assert fan["bin_m"] == pytest.approx(2.842e-3, abs=1e-6)
    says = summary["says"]
    assert (says["bearing_first_deg"], says["bearing_last_deg"]) == (-30.0, 30.0)
    assert says["sound_speed_mps"] == pytest.approx(1490.66, abs=0.005)
    assert says["frequency_hz"] == pytest.approx(2.099e6, abs=1e3)
