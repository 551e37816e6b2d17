"""Recordings, maps and tables of users and attackers, through the real command."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType, Writer

from insonify.io.maps import save_map
from insonify.mapping.voxels import VoxelMap

Run = Callable[..., str]
RULE = "=" * 80


def mcap(path: Path, definition: str, encoding: str = "ros2msg") -> None:
    """An MCAP of one message, whose schema is what the definition says."""
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start(profile="ros2", library="crafted")
        schema = writer.register_schema("a/msg/B", encoding, definition.encode())
        channel = writer.register_channel("/[/red]x\x1b[31m", "cdr", schema)
        writer.add_message(channel, 10**9, bytes(64), 0)
        writer.finish()  # type: ignore[no-untyped-call]


def chunk(told: int, content: bytes, compression: bytes) -> bytes:
    """An MCAP of one chunk that says to what it unpacks."""

    def record(kind: int, data: bytes) -> bytes:
        return struct.pack("<BQ", kind, len(data)) + data

    head = struct.pack("<QQQI", 0, 1, told, 0) + struct.pack("<I", len(compression)) + compression
    magic = b"\x89MCAP0\r\n"
    header = record(1, struct.pack("<II", 0, 0))
    return magic + header + record(6, head + struct.pack("<Q", len(content)) + content)


@pytest.mark.parametrize(
    ("definition", "encoding"),
    [
        ("string[3000000] x", "ros2msg"),
        (f"c/D[3000000] x\n{RULE}\nMSG: c/D\nfloat64 y", "ros2msg"),
        ("\n".join(f"float64 x{k}" for k in range(200_000)), "ros2msg"),
        ("module a { module msg { const long X = 1 << 300000000; }; };", "ros2idl"),
        ("module a { module msg { const long X = 1 << (300000000); }; };", "ros2idl"),
        ("module a { module msg { struct B { string x[3000000]; }; }; };", "ros2idl"),
        (5000 * "(", "ros2idl"),
        ("float64 x\n" + "# " + 2_000_000 * "x", "ros2msg"),
    ],
    ids=["strings", "messages", "fields", "shift", "shift in brackets", "IDL", "deep", "long"],
)
def test_definitions(run: Run, definition: str, encoding: str) -> None:
    mcap(Path("d.mcap"), definition, encoding)
    assert "d.mcap" in run("info", "d.mcap")


def test_a_topic_is_only_text(run: Run) -> None:
    mcap(Path("d.mcap"), "float64 x")
    assert "[/red]x?[31m" in run("info", "d.mcap")


@pytest.mark.parametrize("told", [1 << 30, 1 << 20, 100, (1 << 63) + 1])
def test_chunks_unpack_to_what_they_say(run: Run, told: int) -> None:
    bomb = zstandard.ZstdCompressor(level=1).compress(bytes(1 << 30))
    Path("c.mcap").write_bytes(chunk(told, bomb, b"zstd"))
    assert "unpack" in run("info", "c.mcap")


def test_a_map_with_an_array_that_nobody_knows(run: Run) -> None:
    """3 GiB that are not looked at, and the same as one that is."""
    voxels = VoxelMap(0.5)
    voxels.allocate(np.zeros((1, 3), np.int32))
    save_map(voxels, Path("m.npz"))
    whole = dict(np.load("m.npz"))
    np.savez_compressed("more.npz", **whole, mystery=np.zeros((1 << 26,), np.uint8))
    run("export", "more.npz", "m.bt", code=0)
    np.savez_compressed("large.npz", **(whole | {"voxel_m": np.array(1e308)}))
    assert "makes no sense" in run("export", "large.npz", "m.vdb")


def test_a_tree_that_unfolds(run: Run) -> None:
    head = b"# Octomap OcTree file\nid OcTree\nsize %d\nres 0.1\ndata\n"
    way = b"".join(b"\0\0\x80\x3f\1" for _ in range(6)) + b"\0\0\x80\x3f\0"
    Path("t.ot").write_bytes(head % 7 + way)
    assert "unfold to 2.1e+06 blocks" in run("export", "t.ot", "t.npz")


def test_decisions_that_count_to_a_million_millions(run: Run) -> None:
    from insonify.errors import RecordingError
    from insonify.io.decisions import load_decisions, save_decisions

    save_decisions(Path("d.npz"), [], [])
    arrays = dict(np.load("d.npz"))
    six, scan = np.zeros((1, 6)), np.array([10**12])
    np.savez("e.npz", **(arrays | {"flown": six, "flown_scan": scan}))
    with pytest.raises(RecordingError, match="more scans than poses"):
        load_decisions(Path("e.npz"))


def test_toml_and_csv(run: Run) -> None:
    Path("deep.toml").write_text("a = " + 100_000 * "[")
    Path("dots.toml").write_text(".".join(["a"] * 100_000) + " = 1")
    Path("number.toml").write_text("seed = " + 5000 * "1")
    Path("bytes.toml").write_bytes(b"\xff\xfe\0a")
    for name in ("deep", "dots", "number", "bytes"):
        told = run("scan", "tetrapod", "--config", f"{name}.toml", "--out", "out")
        assert f"{name}.toml" in told
    Path("path.csv").write_text("x_m,y_m,z_m\n1e308,0,0\n1,1,1\n")
    run("simulate", "tank", "--path", "path.csv", "--out", "out")
    Path("ages.csv").write_text("time_s,x_m,y_m,z_m\n0,0,0,0\n1e12,1,1,1\n")
    assert "pings, more than" in run("simulate", "tank", "--path", "ages.csv", "--out", "out")
    Path("long.csv").write_text("x_m,y_m,z_m\n" + 300_000 * "1" + ",0,0\n")
    run("simulate", "tank", "--path", "long.csv", "--out", "out")
