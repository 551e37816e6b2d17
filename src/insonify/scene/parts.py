"""What a mesh file that is a scene asks for, told from its description before it is built.

glTF and COLLADA place meshes by trees of nodes; a node that is named twice is built twice, so that
a few lines can ask for billions of triangles, or for a tree without an end.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from insonify.errors import MeshError, reading
from insonify.limits import MOST_NODE_DEPTH, MOST_NODES, MOST_TRIANGLES

_GLB_HEAD, _CHUNK_HEAD = struct.Struct("<4sII"), struct.Struct("<II")
_JSON = 0x4E4F534A


def check_gltf(path: Path) -> None:
    """Refuse a glTF or GLB that asks for too much.

    Raises:
        MeshError: It is damaged, its nodes are too many or without an end, or it counts numbers
            that its buffers do not hold.
    """
    with reading(path, "a mesh", MeshError, Exception):
        table = json.loads(_glb_json(path) if path.suffix.lower() == ".glb" else path.read_bytes())
        nodes, views = table.get("nodes", []), table.get("bufferViews", [])
        if len(nodes) > MOST_NODES:
            raise MeshError(f"{path}: it has more than {MOST_NODES:,} nodes; merge some")
        children = {number: node.get("children", []) for number, node in enumerate(nodes)}
        _check_tree(path, children, list(children))
        for accessor in table.get("accessors", []):
            if int(accessor["count"]) > 3 * MOST_TRIANGLES:
                raise MeshError(
                    f"{path}: it counts {accessor['count']} numbers; use a coarser mesh"
                )
            if "bufferView" in accessor:
                held = int(views[accessor["bufferView"]]["byteLength"])
                if int(accessor["count"]) > held:
                    raise MeshError(f"{path}: it counts more numbers than it holds")


def _glb_json(path: Path) -> bytes:
    """The description in a GLB, whose lengths are checked."""
    size = path.stat().st_size
    with path.open("rb") as file:
        magic, _, length = _GLB_HEAD.unpack(file.read(_GLB_HEAD.size))
        if magic != b"glTF" or length > size:
            raise ValueError("its head is none of a GLB")
        left, text = size - _GLB_HEAD.size, b""
        while left >= _CHUNK_HEAD.size:
            length, kind = _CHUNK_HEAD.unpack(file.read(_CHUNK_HEAD.size))
            left -= _CHUNK_HEAD.size
            if length > left:
                raise ValueError("a chunk is longer than the file")
            if kind == _JSON and not text:
                text = file.read(length)
            else:
                file.seek(length, 1)
            left -= length
    return text


def check_collada(path: Path, root: ET.Element) -> None:
    """Refuse a COLLADA file whose nodes are too many, or without an end.

    Raises:
        MeshError: They are.
    """
    children: dict[str, list[str]] = {}
    for number, node in enumerate(one for one in root.iter() if local(one) == "node"):
        node.set("insonify", node.get("id") or f" {number}")
    for node in (one for one in root.iter() if one.get("insonify") is not None):
        below = children.setdefault(node.get("insonify", ""), [])
        for child in node:
            if local(child) == "node":
                below.append(child.get("insonify", ""))
            elif local(child) == "instance_node":
                below.append(child.get("url", "").lstrip("#"))
            elif local(child).startswith("instance_"):
                below.append("")
    _check_tree(path, children, list(children))


def local(element: ET.Element) -> str:
    """An element's name without the prefix of its namespace."""
    return element.tag.rpartition(":")[2]


def _check_tree(path: Path, children: Mapping[Any, Sequence[Any]], roots: Sequence[Any]) -> None:
    """Count what nodes become, each as often as it is named, without building it.

    Raises:
        MeshError: More than `insonify.limits` allows, nested too deep, or in a circle.
    """
    built: dict[Any, tuple[int, int]] = {}
    """How many nodes, and how deep, one becomes."""
    for root in roots:
        open_nodes, waiting = set(), [(root, False)]
        while waiting:
            node, done = waiting.pop()
            below = children.get(node, ())
            if done:
                open_nodes.discard(node)
                parts = [built.get(child, (1, 1)) for child in below]
                count = 1 + sum(one for one, _ in parts)
                depth = 1 + max((deep for _, deep in parts), default=0)
                if count > MOST_NODES or depth > MOST_NODE_DEPTH:
                    raise MeshError(
                        f"{path}: its nodes become more than {MOST_NODES:,}, or are nested more "
                        f"than {MOST_NODE_DEPTH} deep; merge some"
                    )
                built[node] = count, depth
            elif node in open_nodes:
                raise MeshError(f"{path}: its nodes hang on each other in a circle")
            elif node not in built:
                open_nodes.add(node)
                waiting.append((node, True))
                waiting += [(child, False) for child in below if child not in built]
