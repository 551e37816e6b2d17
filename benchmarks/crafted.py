"""Files made by the rules of their formats, with values that no sound program writes.

Damage (`benchmarks.fuzz`) rarely gets past a reader's first check.  These files do: they are whole,
and what they say is absurd.  Each maker writes its files into the working folder and returns the
words of the command that reads them.
"""

from __future__ import annotations

import json
import random
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap.writer import CompressionType, Writer

Make = Callable[[random.Random], list[str]]
NUMBERS = (
    "0", "-0", "1", "-1", "2.5", "0.1", "100", "1e6", "1e7", "1e200", "1e308", "-1e308", "1e-308",
    "nan", "inf", "-inf", "4294967296", "9223372036854775808", "1" * 5000, "", " ", "0x10", "1,5",
    "1e", "one",
)  # fmt: skip
NAMES = (
    "a", "b", "c", "l", "v", "world", "__model__", "", " ", "[/b]", "[red]", "\u202e", "=1+1",
    "$x$", "../../x", "a" * 300, "b" * 5000, "model://../../etc", "model://a", "file:///etc/passwd",
    "%00", "a.sdf", "m.glb", "p.png", "http://there/x", "sun", "water",
)  # fmt: skip
VIEW = ["--set", "sonar.beams=6", "--set", "sonar.bins=12", "--out", "out"]
SEEN = ["--pose", "0 0 3 0 90 0", *VIEW]
XML = str.maketrans({"&": "&amp;", "<": "&lt;", '"': "&quot;"})


def number(rng: random.Random, sound: float = 0.8) -> str:
    """A number in words, mostly a sensible one."""
    return f"{rng.uniform(-2, 2):.3g}" if rng.random() < sound else rng.choice(NUMBERS)


def numbers(rng: random.Random, count: int) -> str:
    """Some numbers; sometimes one too many or too few."""
    if rng.random() < 0.05:
        count += rng.choice((-1, 1, 1000))
    return " ".join(number(rng, 0.97) for _ in range(count))


def name(rng: random.Random) -> str:
    """A name, mostly a harmless one."""
    return rng.choice(NAMES[:6] if rng.random() < 0.7 else NAMES).translate(XML)


def _sized(tag: str, rng: random.Random, count: int) -> str:
    told = numbers(rng, count)
    return f"<{tag}>{told.replace('-', '') if rng.random() < 0.9 else told}</{tag}>"


def _geometry(rng: random.Random) -> str:
    uri = f"<uri>{name(rng)}</uri>"
    return rng.choice((
        f"<box>{_sized('size', rng, 3)}</box>",
        f"<sphere>{_sized('radius', rng, 1)}</sphere>",
        f"<cylinder>{_sized('radius', rng, 1)}{_sized('length', rng, 1)}</cylinder>",
        f"<capsule>{_sized('radius', rng, 1)}{_sized('length', rng, 1)}</capsule>",
        f"<ellipsoid>{_sized('radii', rng, 3)}</ellipsoid>",
        f"<plane><normal>{numbers(rng, 3)}</normal>{_sized('size', rng, 2)}</plane>",
        f"<mesh>{uri}{_sized('scale', rng, 3)}<submesh><name>{name(rng)}</name></submesh></mesh>",
        f"<heightmap>{uri}{_sized('size', rng, 3)}<pos>{numbers(rng, 3)}</pos></heightmap>",
        f"<{rng.choice('xyz')}/>",
    ))  # fmt: skip


def _pose(rng: random.Random) -> str:
    if rng.random() < 0.4:
        return ""
    frame = f' relative_to="{name(rng)}"' if rng.random() < 0.3 else ""
    return f"<pose{frame}>{numbers(rng, 6)}</pose>"


def _scope(rng: random.Random, depth: int) -> str:
    """What is in a model or a world."""
    parts = []
    for _ in range(rng.randint(0, 4)):
        kind, called = rng.random(), name(rng)
        if kind < 0.55:
            material = rng.choice(("", f"<material><script><name>{name(rng)}</name></script>"
                                   f"<insonify:reflectance>{number(rng)}</insonify:reflectance>"
                                   "</material>"))  # fmt: skip
            shape = f"<geometry>{_geometry(rng)}</geometry>{material}{_pose(rng)}"
            shape = f'<visual name="{name(rng)}">{shape}</visual>'
            times = rng.choice((1, 1, 1, 1, 1, 500)) if rng.random() < 0.1 else 1
            parts.append(f'<link name="{called}">{_pose(rng)}{shape * times}</link>')
        elif kind < 0.7:
            parts.append(f'<frame name="{called}" attached_to="{name(rng)}">{_pose(rng)}</frame>')
        elif kind < 0.85:
            include = f"<include>{_pose(rng)}<uri>{name(rng)}</uri></include>"
            parts.append(include * rng.choice((1, 1, 1, 10)))
        elif depth < rng.choice((3, 3, 3, 300)):
            parts.append(f'<model name="{called}">{_pose(rng)}{_scope(rng, depth + 1)}</model>')
    return "".join(parts)


def sdf(rng: random.Random) -> list[str]:
    """An SDF world, and a model beside it that it may include."""
    for file in ("w.sdf", "a.sdf"):
        version = "1.9" if rng.random() < 0.95 else rng.choice(NUMBERS)
        head = rng.choice((*20 * ("",), '<?xml version="1.0" encoding="utf-16"?>',
                           "<!DOCTYPE x [<!ENTITY y 'z'>]>"))  # fmt: skip
        kind = rng.choice(("world", "model"))
        text = f'{head}<sdf version="{version}"><{kind} name="{name(rng)}">{_scope(rng, 0)}'
        Path(file).write_text(f"{text}</{kind}></sdf>", encoding="utf-8", errors="replace")
    _glb(rng, Path("m.glb"))
    return ["simulate", "w.sdf", *SEEN] if rng.random() < 0.9 else ["sonars", "w.sdf"]


def _count(rng: random.Random, sound: int) -> int:
    return sound if rng.random() < 0.96 else rng.choice((0, -1, 1, 2**31, 2**40, 200_000))


def _glb(rng: random.Random, path: Path) -> None:
    size = rng.choice((1, 3, 40, 3000)) if rng.random() < 0.2 else 3
    nodes: list[dict[str, Any]] = [{"mesh": _count(rng, 0)} for _ in range(size)]
    for node in nodes[: rng.choice((0, 0, 1, 40))]:
        node["children"] = [rng.randrange(size + 1) for _ in range(rng.randint(0, 3))]
        node[rng.choice(("translation", "scale", "x"))] = [rng.uniform(-2, 2), 1e200, 1.0]
    if rng.random() < 0.1:
        nodes = [{"children": [k + 1]} for k in range(size)] + [{"mesh": 0}]
    kind = rng.choice((*9 * (5126,), 5125))
    table = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [_count(rng, 0)]}],
        "nodes": nodes, "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": _count(rng, 0), "componentType": kind,
                       "count": _count(rng, 3), "type": rng.choice((*9 * ("VEC3",), "MAT4"))}],
        "bufferViews": [{"buffer": 0, "byteLength": _count(rng, 36)}],
        "buffers": [{"byteLength": _count(rng, 36)}],
    }  # fmt: skip
    for key in list(table):
        if rng.random() < 0.03:
            table[key] = rng.choice((None, [], {}, "x", 3))
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes()
    text = json.dumps(table).encode()
    text += b" " * (-len(text) % 4)
    lengths = [abs(_count(rng, len(part))) % 2**32 for part in (text, corners)]
    body = struct.pack("<II", lengths[0], 0x4E4F534A) + text
    body += struct.pack("<II", lengths[1], 0x004E4942) + corners
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)


def gltf(rng: random.Random) -> list[str]:
    """A GLB of a triangle and its places."""
    _glb(rng, Path("m.glb"))
    return ["simulate", "m.glb", *SEEN]


def collada(rng: random.Random) -> list[str]:
    """A COLLADA file whose nodes name each other."""
    names = [f"n{k}" for k in range(rng.choice((1, 3, 12)))]
    instance = '<instance_geometry url="#g"/>'

    def node(called: str) -> str:
        inside = "".join(
            f'<instance_node url="#{rng.choice(names)}"/>' for _ in range(rng.choice((0, 0, 1, 10)))
        )
        place = f"<matrix>{numbers(rng, 16)}</matrix>" if rng.random() < 0.3 else ""
        return f'<node id="{called}">{place}{inside}{instance}</node>'

    nodes = "".join(map(node, names))
    corners, unit = numbers(rng, 9), number(rng, 0.9).replace("-", "")
    text = f"""<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="{unit}"/><up_axis>{rng.choice(("Z_UP", "X_UP", "W"))}</up_axis></asset>
<library_geometries><geometry id="g"><mesh><source id="p">
<float_array id="a" count="{_count(rng, 9)}">{corners}</float_array><technique_common>
<accessor source="#a" count="{_count(rng, 3)}" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="{_count(rng, 1)}"><input semantic="VERTEX" source="#v" offset="0"/>
<p>0 1 {_count(rng, 2)}</p></triangles></mesh></geometry></library_geometries>
<library_nodes>{nodes}</library_nodes><library_visual_scenes><visual_scene id="s"><node id="r">
<instance_node url="#{rng.choice(names)}"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""
    Path("m.dae").write_text(text)
    return ["simulate", "m.dae", *SEEN]


def mcap(rng: random.Random) -> list[str]:
    """An MCAP whose definitions, topics and bytes make little sense."""
    kinds = ("float64", "string", "uint8", "c/D", "std_msgs/Header", "bool")

    def length() -> str:
        return rng.choice(("", "", "[]", "[3]", "[<=5]", f"[{_count(rng, 9)}]"))

    rows = rng.choice((1, 3, 20, 3000)) if rng.random() < 0.3 else 3
    text = "\n".join(f"{rng.choice(kinds)}{length()} x{k}" for k in range(rows))
    text += f"\n{'=' * 80}\nMSG: c/D\nstring{length()} y\n"
    encoding = "ros2msg"
    if rng.random() < 0.2:
        encoding = "ros2idl"
        told = f"const long X = 1 << {rng.choice((1, 70, 10**9))}; struct B {{ long x; }};"
        text = f"module a {{ module msg {{ {told} }}; }};"
    with Path("d.mcap").open("wb") as file:
        how = rng.choice((CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4))
        writer = Writer(file, compression=how, enable_crcs=False)
        writer.start(profile="ros2", library="crafted")
        kind = rng.choice(("a/msg/B", "marine_acoustic_msgs/msg/ProjectedSonarImage"))
        schema = writer.register_schema(kind, encoding, text.encode())
        for topic in range(rng.randint(1, 3)):
            channel = writer.register_channel(f"/{topic}{rng.choice(NAMES)}", "cdr", schema)
            size = rng.choice((0, 3, 64, 4096))
            writer.add_message(channel, rng.choice((0, 10**9, 2**63)), rng.randbytes(size), 0)
        writer.finish()  # type: ignore[no-untyped-call]
    if rng.random() < 0.1:
        bomb = zstandard.ZstdCompressor(level=1).compress(bytes(rng.choice((1 << 10, 1 << 28))))
        head = struct.pack("<QQQI", 0, 1, abs(_count(rng, 1 << 10)), 0) + b"\4\0\0\0zstd"
        chunk = head + struct.pack("<Q", len(bomb)) + bomb
        raw = Path("d.mcap").read_bytes()
        Path("d.mcap").write_bytes(raw[:40] + struct.pack("<BQ", 6, len(chunk)) + chunk)
    return ["info", "d.mcap"]


def _export(source: str, rng: random.Random) -> list[str]:
    return ["export", source, f"out{rng.choice(('.npz', '.xyz', '.bt', '.ply'))}"]


def octomap(rng: random.Random) -> list[str]:
    """An OctoMap of a random tree."""
    nodes: list[bytes] = []

    def grow(depth: int) -> None:
        children = (
            0 if depth > rng.choice((1, 2, 5, 12, 17)) or len(nodes) > 400 else rng.randrange(256)
        )
        children &= rng.randrange(256)
        value = struct.pack("<f", rng.choice((0.5, -2.0, 1e30, float("nan"), 3.5)))
        nodes.append(value + bytes([children]))
        for _ in range(children.bit_count()):
            grow(depth + 1)

    grow(0)
    told = _count(rng, len(nodes))
    head = (
        f"# Octomap OcTree file\nid OcTree\nsize {told}\nres {number(rng, 0.8).lstrip('-')}\ndata\n"
    )
    Path("m.ot").write_bytes(head.encode() + b"".join(nodes))
    return _export("m.ot", rng)


def _arrays(rng: random.Random) -> dict[str, Any]:
    blocks = rng.randint(0, 3)
    arrays: dict[str, Any] = {
        "format": np.array("insonify-map"), "version": np.array(1), "voxel_m": np.array(0.1),
        "coords": np.arange(3 * blocks, dtype=np.int32).reshape(blocks, 3),
        "log_odds": np.ones((blocks, 512), np.float32), "seen": np.ones((blocks, 512), np.uint8),
    }  # fmt: skip
    for key in list(arrays):
        if rng.random() < 0.1:
            arrays[key] = rng.choice((
                np.array(1e308), np.array(np.nan), np.array("x"), np.zeros((2, 2)), np.array([]),
                np.full((3, 512), 1e30, np.float32), np.full((1, 3), 2**31 - 1, np.int32),
            ))  # fmt: skip
    if rng.random() < 0.1:
        arrays["mystery"] = np.zeros(1 << 24, np.uint8)
    return arrays


def npz(rng: random.Random) -> list[str]:
    """A map as a NumPy archive."""
    np.savez_compressed("m.npz", **_arrays(rng))
    return _export("m.npz", rng)


def zarr(rng: random.Random) -> list[str]:
    """A map as a Zarr group, its descriptions changed."""
    from insonify.io.maps import save_map
    from insonify.mapping.voxels import VoxelMap

    voxels = VoxelMap(0.1)
    voxels.allocate(np.zeros((1, 3), np.int32))
    save_map(voxels, Path("m.zarr"))
    for file in Path("m.zarr").rglob("zarr.json"):
        table = json.loads(file.read_text())
        for key in list(table):
            if rng.random() < 0.015:
                table[key] = rng.choice((None, [], {}, "x", -1, 10**12, [10**9, 512]))
        file.write_text(json.dumps(table))
    return _export("m.zarr", rng)


def toml(rng: random.Random) -> list[str]:
    """Settings of a scan, printed back."""
    keys = ("seed", "planner", "mapping.voxel_m", "sonar.beams", "sonar.name", "object.scale",
            "object.mesh", "seabed.raster", "survey.waypoints", "vehicle.name", "x", "scenario",
            "mapping.bayes.p_min", "sonar.mount_m", "entropy.termination")  # fmt: skip
    values = (
        *NUMBERS, '"x"', "true", "[]", "{}", "[1, 2, 3]", "[" * 2000, "1979-05-27", '"""',
        "'[/b]'", '"\\u001b[31m"',
    )  # fmt: skip
    rows = [
        f"{rng.choice(keys)} = {number(rng) if rng.random() < 0.5 else rng.choice(values)}"
        for _ in range(rng.choice((1, 1, 2, 4)))
    ]
    if rng.random() < 0.05:
        rows.append(".".join(["a"] * rng.choice((50, 5000))) + " = 1")
    Path("c.toml").write_text("\n".join(rows), encoding="utf-8")
    return ["config", "tetrapod", "--config", "c.toml"]


def csv(rng: random.Random) -> list[str]:
    """A route, as a table or as TUM lines."""
    heads = (
        *5 * ("x_m,y_m,z_m",),
        "time_s,x_m,y_m,z_m,yaw_deg",
        "x_m,y_m",
        "x_m,x_m,z_m",
        "",
        '"x_m,y_m',
    )
    head = rng.choice(heads)
    width = head.count(",") + 1 if head else 8
    rows = [
        rng.choice(",,,,,,; " if head else "      ,").join(number(rng, 0.98) for _ in range(width))
        for _ in range(rng.randint(0, 3))
    ]
    Path("p.csv").write_text("\n".join([*([head] if head else []), *rows]), encoding="utf-8")
    return ["simulate", "tank", "--path", "p.csv", "--set", "sonar.rate_hz=0.02", *VIEW]


MAKERS: dict[str, Make] = {
    "SDF": sdf, "glTF": gltf, "COLLADA": collada, "MCAP": mcap, "OctoMap": octomap, "npz": npz,
    "Zarr": zarr, "TOML": toml, "CSV": csv,
}  # fmt: skip
