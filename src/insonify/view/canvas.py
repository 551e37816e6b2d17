"""A viser scene that is told only what is new."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from insonify.types import Array, Float32, Pose
from insonify.view import shapes
from insonify.view.cubes import Cubes, grid_keys

CHUNK_BITS = 5
"""Cubes are sent in chunks of 32 a side: what a ping changes lies in few of them."""
_PIECE = 256
"""Lines are sent by so many segments: a path grows at its end."""
_UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0], np.float32)


class Canvas:
    """Draws into a scene by name; what is there already, and the same, is not sent again.

    Attributes:
        scene: viser's.
        sent_bytes: Arrays that were sent so far.
    """

    def __init__(self, scene: Any) -> None:
        """Nothing is drawn yet."""
        self.scene = scene
        self.sent_bytes = 0
        self._shown: dict[str, tuple[Array, ...]] = {}
        self._parts: dict[str, set[str]] = {}
        self._meshes: dict[str, Any] = {}

    def lines(
        self, name: str, segments: Float32, colours: Array | tuple[int, int, int], width: float
    ) -> None:
        """Line segments (N, 2, 3) in one colour, or one (N, 3) for each."""
        whole = np.broadcast_to(np.asarray(colours, np.uint8), (len(segments), 3))
        parts = {}
        for start in range(0, len(segments), _PIECE):
            piece = slice(start, start + _PIECE)
            parts[f"{name}/{start}"] = (segments[piece], whole[piece])
        self._drop(name, set(parts))
        for part, (ends, tints) in parts.items():
            if self._is_new(part, ends, tints):
                self.scene.add_line_segments(
                    part, ends, np.repeat(tints[:, None, :], 2, axis=1), thickness=width,
                    thickness_units="screen",
                )  # fmt: skip

    def points(
        self, name: str, centres_m: Float32, colours: Array | tuple[int, int, int], size_m: float
    ) -> None:
        """Dots (N, 3) in one colour, or one (N, 3) for each."""
        if not len(centres_m):
            self.remove(name)
            return
        tints = np.broadcast_to(np.asarray(colours, np.uint8), (len(centres_m), 3))
        if self._is_new(name, centres_m, tints, np.array(size_m)):
            self.scene.add_point_cloud(
                name, centres_m, np.ascontiguousarray(tints), point_size=size_m,
                precision="float32",
            )  # fmt: skip

    def cubes(self, name: str, cubes: Cubes, colours: Array) -> None:
        """Cubes with a colour (N, 3) each."""
        parts = {f"{name}/{cubes.times}_{key}": chosen for key, chosen in _chunks(cubes.index)}
        self._drop(name, set(parts))
        centres = cubes.centres_m
        for part, chosen in parts.items():
            self._chunk(part, centres[chosen], colours[chosen], cubes.edge_m)

    def labels(self, name: str, told: list[tuple[str, Pose]], anchor: str) -> None:
        """Words at places, which are at the anchor of each."""
        parts = {f"{name}/{k}": word for k, word in enumerate(told)}
        self._drop(name, set(parts))
        for part, (text, pose) in parts.items():
            place = np.array(pose.position_m)
            if self._is_new(part, place, np.frombuffer(text.encode(), np.uint8)):
                self.scene.add_label(
                    part, text, position=place, font_screen_scale=0.8, anchor=anchor
                )

    def remove(self, name: str) -> None:
        """Take away what was drawn under a name."""
        self._drop(name, set())
        if self._shown.pop(name, None) is not None:
            self.scene.remove_by_name(name)

    def _chunk(self, name: str, centres_m: Float32, colours: Array, edge_m: float) -> None:
        """Some cubes; one whose cubes are where they were is sent colours alone."""
        before = self._shown.get(name)
        if not self._is_new(name, centres_m, colours):
            return
        mesh = self._meshes.get(name)
        if mesh is None or before is None:
            self._meshes[name] = self.scene.add_batched_meshes_simple(
                name,
                shapes.CUBE_CORNERS * np.float32(edge_m),
                shapes.CUBE_FACES,
                batched_wxyzs=np.tile(_UPRIGHT, (len(centres_m), 1)),
                batched_positions=centres_m,
                batched_colors=colours,
                flat_shading=True,
                cast_shadow=False,
                receive_shadow=False,
                lod="off",
            )
            return
        if not np.array_equal(before[0], centres_m):
            if len(before[0]) != len(centres_m):
                mesh.batched_wxyzs = np.tile(_UPRIGHT, (len(centres_m), 1))
            mesh.batched_positions = centres_m
        else:
            self.sent_bytes -= centres_m.nbytes
        mesh.batched_colors = colours

    def _is_new(self, name: str, *arrays: Array) -> bool:
        """Whether something else is drawn under a name now; it is remembered."""
        before = self._shown.get(name)
        if before is not None and all(map(np.array_equal, before, arrays)):
            return False
        self._shown[name] = tuple(array.copy() for array in arrays)
        self.sent_bytes += sum(array.nbytes for array in arrays)
        return True

    def _drop(self, name: str, kept: set[str]) -> None:
        """Take away the parts of a name that are no more."""
        for part in self._parts.get(name, set()) - kept:
            self._shown.pop(part, None)
            self._meshes.pop(part, None)
            self.scene.remove_by_name(part)
        self._parts[name] = kept


def _chunks(index: Array) -> Iterator[tuple[str, Array]]:
    """Which cubes (N, 3) lie in one chunk: its name, and their numbers."""
    if not len(index):
        return
    keys = grid_keys(index >> CHUNK_BITS)
    order = np.argsort(keys, kind="stable")
    sorted_keys = keys[order]
    bounds = np.flatnonzero(np.diff(sorted_keys)) + 1
    for chosen in np.split(order, bounds):
        yield str(keys[chosen[0]]), chosen
