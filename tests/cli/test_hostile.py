"""Files of users and attackers, through the real command: one sentence that names the file."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from insonify.cli import main

Run = Callable[..., str]
MODEL = '<sdf version="1.9"><model name="m">{}</model></sdf>'
WORLD = '<sdf version="1.9"><world name="w">{}</world></sdf>'
VISUAL = '<link name="l"><visual name="v"><geometry>{}</geometry></visual></link>'
AT = ("--pose", "0 0 3 0 90 0", "--out", "out")


def png(width: int, height: int, rows: int = 0) -> bytes:
    """A grey picture of a size, with as many rows of zeros as are asked for."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    data = zlib.compress(bytes((width + 1) * rows), 9)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def glb(table: dict[str, object], binary: bytes = b"") -> bytes:
    """A GLB of a description and its numbers."""
    text = json.dumps(table).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<II", len(text), 0x4E4F534A) + text
    body += struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def triangle(nodes: list[dict[str, object]], count: int = 3) -> bytes:
    """A GLB of one triangle placed by nodes."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes()
    return glb(
        {
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": nodes,
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "count": count, "type": "VEC3"}],
            "bufferViews": [{"buffer": 0, "byteLength": 36}], "buffers": [{"byteLength": 36}],
        },
        corners,
    )  # fmt: skip


def collada(nodes: str, scene: str) -> str:
    """A COLLADA file of one triangle placed by nodes."""
    return f"""<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="a" count="9">0 0 0 1 0 0 0 1 0</float_array><technique_common>
<accessor source="#a" count="3" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles>
</mesh></geometry></library_geometries>
<library_nodes>{nodes}</library_nodes>
<library_visual_scenes><visual_scene id="s">{scene}</visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


def test_a_sound_mesh_of_each_kind_is_read(run: Run) -> None:
    """The crafted files below are faulty in one thing alone."""
    Path("a.glb").write_bytes(triangle([{"mesh": 0}]))
    instance = '<instance_geometry url="#g"/>'
    Path("b.dae").write_text(
        collada(f'<node id="n">{instance}</node>', '<node id="r"><instance_node url="#n"/></node>')
    )
    for name in ("a.glb", "b.dae"):
        run("simulate", name, "--pose", "0 0 3 0 90 0", "--out", f"out-{name}", code=0)


def test_names_in_worlds_are_only_text(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    box = VISUAL.format("<box><size>1 1 1</size></box>")
    world = MODEL.format(box).replace('"m"', '"[/b]&#x9b;31m"')
    Path("w.sdf").write_text(world)
    run("simulate", "w.sdf", "--truth", *AT, code=0)
    with pytest.MonkeyPatch.context() as patched, pytest.raises(SystemExit):
        patched.setattr(sys, "argv", ["insonify", "simulate", "w.sdf", "--truth", *AT, "--force"])
        main()
    assert "[/b]?31m" in capsys.readouterr().out
    run("simulate", "w.sdf", *AT[:2], "--set", 'sonar.name="../../x"', code=0)
    assert [path.name for path in Path("insonify-runs").iterdir()] == ["w-..-..-x"]


@pytest.mark.parametrize(
    ("shape", "told"),
    [
        ("<heightmap><uri>bomb.png</uri><size>9 9 9</size></heightmap>", "10000000000 pixels"),
        ("<heightmap><uri>tenth.png</uri><size>9 9 9</size></heightmap>", "10000 x 10000 pixels"),
        ("<sphere><radius>1e308</radius></sphere>", "beyond 1e"),
        ("<capsule><radius>1</radius><length>1e308</length></capsule>", "beyond 1e"),
        ("<mesh><uri>a.glb</uri><scale>1e200 1 1</scale></mesh>", "beyond 1e"),
        ("<mesh><uri>a.glb</uri><scale>1e6 1e6 1</scale></mesh>", "within 1e"),
        (f"<mesh><uri>{'a' * 300}</uri></mesh>", "is not there"),
        (f"<mesh><uri>model://{'a/' * 2500}</uri></mesh>", "is not there"),
        ("<mesh><uri>file://a%00b</uri></mesh>", "is not there"),
        ("<mesh><uri>model://../../etc/passwd</uri></mesh>", "leaves the folders"),
        ("<mesh><uri>model://x/%2e%2e/%2e%2e/a.glb</uri></mesh>", "leaves the folders"),
    ],
)
def test_shapes(run: Run, shape: str, told: str) -> None:
    Path("bomb.png").write_bytes(png(100_000, 100_000))
    Path("tenth.png").write_bytes(png(10_000, 10_000, 10_000))
    Path("a.glb").write_bytes(triangle([{"mesh": 0, "translation": [9, 9, 0]}]))
    Path("w.sdf").write_text(MODEL.format(f"<pose>5e5 0 0 0 0 0</pose>{VISUAL.format(shape)}"))
    assert told in run("simulate", "w.sdf", *AT)


def test_absolute_paths_and_files_by_url_stay(run: Run) -> None:
    Path("deep").mkdir()
    Path("a.glb").write_bytes(triangle([{"mesh": 0}]))
    for number, uri in enumerate((f"file://{Path('a.glb').absolute()}", "../a.glb")):
        shape = f"<mesh><uri>{uri}</uri></mesh>"
        Path("deep/w.sdf").write_text(MODEL.format(VISUAL.format(shape)))
        run("simulate", "deep/w.sdf", *AT[:2], "--out", f"out{number}", code=0)


def _frames(count: int) -> str:
    frames = '<frame name="f0"/>' + "".join(
        f'<frame name="f{k}"><pose relative_to="f{k - 1}">0 0 0 0 0 0</pose></frame>'
        for k in range(1, count)
    )
    box = VISUAL.format("<box><size>1 1 1</size></box>")
    return MODEL.format(
        frames + box.replace("<visual", f'<pose relative_to="f{count - 1}"/><visual')
    )


@pytest.mark.parametrize(
    ("world", "told"),
    [
        (_frames(2000), "more than 1000 frames"),
        (f"<sdf version='1.9'>{'<model>' * 10_000}{'</model>' * 10_000}</sdf>", "nested more than"),
        ("<sdf version='1.9'><model name='m'><link name='l'/></model></sdf>", "no visual geometry"),
        (f"<sdf version='{'1' * 5000}.0'/>", "is not known"),
        (f"<sdf version='1.{'1' * 5000}'/>", "is not known"),
        ("<?xml version='1.0' encoding='nonsense'?><sdf version='1.9'/>", "cannot be read as XML"),
        ("<?xml version='1.0' encoding='utf-7'?><sdf version='1.9'/>", "cannot be read as XML"),
        ("<!DOCTYPE a [<!ENTITY x 'y'>]><sdf version='1.9'>&x;</sdf>", "declares the entity 'x'"),
        (MODEL.format(3000 * VISUAL.format("<sphere><radius>1</radius></sphere>")), "triangles"),
        (MODEL.format("<pose>1e308 0 0 0 0 0</pose>"), "beyond 1e"),
        (MODEL.format("<link name='l'><pose>0 0 0 1e308 0 0</pose></link>"), "beyond 1e"),
    ],
)  # fmt: skip
def test_worlds(run: Run, world: str, told: str) -> None:
    Path("w.sdf").write_text(world)
    assert told in run("simulate", "w.sdf", *AT)


def test_many_frames_and_links_are_placed_once(run: Run) -> None:
    Path("w.sdf").write_text(_frames(900))
    run("simulate", "w.sdf", *AT, code=0)
    links = "".join(
        f'<link name="l{k}"><pose relative_to="l{k - 1}">0 0 0 0 0 0</pose></link>'
        for k in range(1, 900)
    )
    box = VISUAL.format("<box><size>1 1 1</size></box>").replace('"l"', '"l0"')
    Path("l.sdf").write_text(MODEL.format(box + links))
    run("simulate", "l.sdf", *AT[:2], "--out", "links", code=0)


def test_includes_that_multiply_or_go_on(run: Run) -> None:
    for k in range(12):
        include = f"<include><uri>w{k + 1}.sdf</uri></include>"
        Path(f"w{k}.sdf").write_text(
            f"<sdf version='1.9'><world name='w'>{10 * include}</world></sdf>"
        )
    Path("w12.sdf").write_text(MODEL.format(VISUAL.format("<box><size>1 1 1</size></box>")))
    assert "more than 2,000 models to include" in run("simulate", "w0.sdf", *AT)
    assert "more than 2,000 models" in run("sonars", "w0.sdf")
    for k in range(1500):
        Path(f"c{k}.sdf").write_text(WORLD.format(f"<include><uri>c{k + 1}.sdf</uri></include>"))
    assert "more than 32 deep" in run("simulate", "c0.sdf", *AT)


def _chain(count: int) -> list[dict[str, object]]:
    nodes: list[dict[str, object]] = [{"children": [k + 1]} for k in range(count)]
    return [*nodes, {"mesh": 0}]


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (triangle([{"children": [1]}, {"children": [0], "mesh": 0}]), "in a circle"),
        (triangle(_chain(3000)), "nested more than 100"),
        (triangle([{"mesh": 0}] * 200_000), "more than 20,000 nodes"),
        (triangle([{"mesh": 0}], count=10**9), "numbers"),
        (triangle([{"mesh": 0}])[:-40], "cannot be read as a mesh"),
        (b"glTF\2\0\0\0\xff\xff\xff\x7f" + bytes(40), "cannot be read as a mesh"),
        (triangle([{"mesh": 0}]).replace(b"\x00\x00BIN", b"\xff\xffBIN"), "as a mesh"),
        (glb({"asset": {"version": "2.0"}, "accessors": [{"count": 10**12}]}), "numbers"),
        (triangle([{"mesh": 0, "scale": [1e200, 1, 1]}]), "makes no sense"),
    ],
    ids=["circle", "deep", "many", "count", "cut", "long", "chunk", "no view", "scale"],
)
def test_glb(run: Run, content: bytes, told: str) -> None:
    Path("m.glb").write_bytes(content)
    assert told in run("simulate", "m.glb", *AT)


def test_collada_instances_that_multiply(run: Run) -> None:
    below = '<node id="n0"><instance_geometry url="#g"/></node>'
    for k in range(1, 10):
        below += (
            f'<node id="n{k}">{10 * f"<instance_node url={chr(34)}#n{k - 1}{chr(34)}/>"}</node>'
        )
    Path("m.dae").write_text(collada(below, '<node id="r"><instance_node url="#n9"/></node>'))
    assert "become more than 20,000" in run("simulate", "m.dae", *AT)
    around = (
        '<node id="a"><instance_node url="#b"/></node><node id="b"><instance_node url="#a"/></node>'
    )
    Path("c.dae").write_text(collada(around, '<node id="r"><instance_node url="#a"/></node>'))
    assert "in a circle" in run("simulate", "c.dae", *AT)


def test_rasters(run: Run) -> None:
    Path("bomb.png").write_bytes(png(100_000, 100_000))
    Path("grid.asc").write_text("ncols inf\nnrows 2\ncellsize 1\n1 2\n3 4\n")
    head = b"\x93NUMPY\x01\x00\x76\x00{'descr': '<f8', 'fortran_order': False, "
    head += b"'shape': (9999999, 9999999), }"
    Path("claim.npy").write_bytes(head.ljust(127) + b"\n" + bytes(64))
    for name, told in (
        ("bomb.png", "10000000000 pixels"),
        ("grid.asc", "cannot be read as a seabed raster"),
        ("claim.npy", "cannot be read as a seabed raster"),
    ):
        assert told in run("scan", "tetrapod", "--set", f"seabed.raster={name}", "--out", "out")


@pytest.mark.parametrize(
    "words",
    [
        ("simulate", "tank", "--pose", "1e308 0 0 0 0 0", "--out", "out"),
        ("simulate", "tank", "--orbit", "0 0 1e308 1 4 0", "--out", "out"),
        ("simulate", "m.toml.sdf", *AT),
        ("simulate", "tank", "--materials", "m.toml", *AT),
        ("scan", "tetrapod", "--set", "object.x_m=1e308", "--out", "out"),
        ("scan", "tetrapod", "--set", "object.scale=1e200", "--out", "out"),
        ("scan", "tetrapod", "--set", "mapping.voxel_m=1e-300", "--out", "out"),
        ("scan", "tetrapod", "--set", "mapping.voxel_m=1e300", "--out", "out"),
        ("scan", "tetrapod", "--set", "object.reflectance=1e308", "--out", "out"),
        ("fly", "tank", "--waypoints", "0 0 1e308 0; 1 1 1 0", "--out", "out"),
        ("scan", "tetrapod", "--set", "sonar.mount_m=[1e308, 0, 0]", "--out", "out"),
    ],
    ids=lambda words: "-".join(words)[:60],
)
def test_absurd_numbers(run: Run, words: tuple[str, ...]) -> None:
    Path("m.toml").write_text("[sand]\nreflectance = 1.0\nlambert_db = 1e308\n")
    shape = VISUAL.format("<box><size>1 1 1</size></box>")
    more = "<material><insonify:lambert_db>1e308</insonify:lambert_db></material></visual>"
    Path("m.toml.sdf").write_text(MODEL.format(shape.replace("</visual>", more)))
    run(*words)


def test_an_address_space_that_is_too_small_is_a_sentence() -> None:
    """Short of it, what loads the libraries ends in a segmentation fault."""
    for mib in (100, 700, 1500):
        line = f'ulimit -v {mib << 10}; exec "{sys.executable}" -m insonify scenarios'
        done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False)
        assert done.returncode == 2 and done.stdout == ""
        assert done.stderr.startswith("insonify: the address space is limited")
        assert done.stderr.count("\n") == 1


def test_who_stops_reading_is_not_shown_a_trace() -> None:
    words = [sys.executable, "-m", "insonify", "config", "tetrapod"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 141  # as of one that the signal ends, and no failure of ours
