"""Small recordings of every format, made from one scene of numbers: for tests and fuzzing."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
from PIL import Image

from insonify.types import Array

ARIS_BEAMS, ARIS_SAMPLES = 48, 40


def pixels(rng: np.random.Generator, *shape: int) -> Array:
    return rng.integers(0, 256, shape, dtype=np.uint8)


def aris(images: Array, *, system: int = 2, telephoto: int = 1, **changes: float) -> bytes:
    """Frames (N, samples, beams) in the file's order, beam 0 the rightmost."""
    count, samples, beams = images.shape
    mode = {48: 1, 96: 3, 64: 6, 128: 9}[beams]
    head = bytearray(1024)
    struct.pack_into("<4sI", head, 0, b"DDF\x05", count)
    out = bytes(head)
    values = {
        "window_start": 3.33, "window_length": 20.3, "heading": 50.0, "water": 9.0, "tilt": -2.25,
        "rate": 6.5, "speed": 1435.9, "delay": 4593, "period": 14, "reordered": 1,
    } | changes  # fmt: skip
    for number in range(count):
        frame = bytearray(1024)
        struct.pack_into("<IQ4s", frame, 0, number, 1_371_198_079_000_000 + 150_000 * number,
                         b"DDF\x05")  # fmt: skip
        struct.pack_into("<ff", frame, 52, values["window_start"], values["window_length"])
        struct.pack_into("<f", frame, 160, values["heading"])
        struct.pack_into("<f", frame, 224, values["water"])
        struct.pack_into("<f", frame, 248, values["tilt"])
        struct.pack_into("<II", frame, 436, mode, 1)
        struct.pack_into("<IIffI", frame, 452, int(values["period"]), 1, values["rate"],
                         values["speed"], samples)  # fmt: skip
        struct.pack_into("<IIII", frame, 476, int(values["delay"]), telephoto, system, 1098)
        struct.pack_into("<I", frame, 516, int(values["reordered"]))
        out += bytes(frame) + images[number].astype(np.uint8).tobytes()
    return out


def oculus(
    image: Array, bearings_deg: Array, *, version: int = 1, gain: bool = False, ping_id: int = 7
) -> bytes:
    """One message; the image is (ranges, beams), port first."""
    ranges, beams = image.shape
    end = 202 if version == 2 else 122
    offset = end + 2 * beams + 14
    rows = image.astype(f"<u{image.itemsize}").tobytes()
    if gain:
        wide = image.itemsize * beams
        rows = b"".join(
            struct.pack("<I", 400) + rows[i * wide : (i + 1) * wide] for i in range(ranges)
        )
    size = offset + len(rows)
    head = bytearray(offset)
    struct.pack_into("<HHHHHIH", head, 0, 0x4F53, 1, 0, 0x23, 2 if version == 2 else 0,
                     size - 16, 0)  # fmt: skip
    struct.pack_into("<5B4d", head, 16, 2, 0, 25, 127, 0x19, 2.0, 50.0, 1490.0, 0.0)
    at = 89 if version == 2 else 53
    struct.pack_into("<IId", head, at, ping_id, 0, 2.1e6)
    struct.pack_into("<d", head, 145 if version == 2 else 85, 1490.0)
    sizes = 161 if version == 2 else 97
    struct.pack_into("<BdHH", head, sizes, image.itemsize - 1, 0.01, ranges, beams)
    struct.pack_into("<III", head, 190 if version == 2 else 110, offset, len(rows), size)
    head[end : end + 2 * beams] = np.round(100 * bearings_deg).astype("<i2").tobytes()
    return bytes(head) + rows


def image_folder(folder: Path, images: Array, poses: Array, *, kind: str = "png") -> None:
    """Images, rows (N, 8) of poses and a description of the sonar."""
    folder.mkdir()
    for number, image in enumerate(images):
        Image.fromarray(image).save(folder / f"{number:04d}.{kind}")
    np.savetxt(folder / "poses.csv", poses, delimiter=",")
    (folder / "sonar.toml").write_text(
        "azimuth_fov_deg = 40.0\nelevation_fov_deg = 10.0\nrange_max_m = 4.0\ntilt_deg = 15.0\n"
    )


def tum_rows(count: int) -> Array:
    """A straight path, looking to the north: rows of time, position and quaternion."""
    rows = np.zeros((count, 8))
    rows[:, 0] = 100.0 + np.arange(count)
    rows[:, 1] = 0.1 * np.arange(count)
    rows[:, 6:] = np.sqrt(0.5)
    return rows


def oculus_log(messages: list[bytes], *, packed: bool = False, start_s: float = 1.7e9) -> bytes:
    """A log of Oculus Viewer with a message each tenth of a second, another item after each."""
    out = struct.pack("<II16sHH4xqd", 0x11223344, 48, b"Oculus", 1, 0, 0, start_s)
    item = struct.Struct("<IIHH4xdH2xII4x")
    for number, message in enumerate(messages):
        time_s = start_s + 0.1 * number
        raw = struct.pack(">I", len(message)) + zlib.compress(message) if packed else message
        out += item.pack(0xAABBCCDD, 40, 10, 0, time_s, int(packed), len(message), len(raw)) + raw
        out += item.pack(0xAABBCCDD, 40, 500, 0, time_s, 0, 4, 4) + b"view"
    return out


def ping360_log(
    angles_grad: list[int], echoes: Array, *, chunk: int | None = None, utf16: bool = True
) -> bytes:
    """A log of Ping Viewer, a ping each 35 ms; ``chunk`` bytes a record, or one message each."""

    def array(data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + data

    def text(words: str) -> bytes:
        return array(words.encode("utf-16-be" if utf16 else "utf-8"))

    messages = []
    for number, (angle, samples) in enumerate(zip(angles_grad, echoes, strict=True)):
        fields = [1, 1, angle, 100, 444, 750, len(samples), len(samples)]
        kind, layout = 2300, "<BBHHHHHH"
        if number % 2:
            kind, layout = 2301, "<BBHHHHHHBBHH"
            fields[6:6] = [0, 399, 1, 0]
        payload = struct.pack(layout, *fields) + samples.astype(np.uint8).tobytes()
        whole = b"BR" + struct.pack("<HHBB", len(payload), kind, 2, 0) + payload
        messages.append(whole + struct.pack("<H", sum(whole) & 0xFFFF))
    if chunk is not None:
        stream = b"".join(messages)
        messages = [stream[k : k + chunk] for k in range(0, len(stream), chunk)]
    out = text("PingViewer sensor log file") + struct.pack(">i", 1)
    out += b"".join(text(words) for words in ("hash", "date", "tag", "Linux", ""))
    out += struct.pack(">ii", 1, 2)
    for number, data in enumerate(messages):
        ms = 35 * number
        out += text(f"00:{ms // 60000:02}:{ms // 1000 % 60:02}.{ms % 1000:03}") + array(data)
    return out
