"""What is drawn again is sent again only where it has changed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from insonify.types import Array, Pose
from insonify.view.canvas import Canvas
from insonify.view.cubes import Cubes


class Mesh:
    """A batched mesh as it arrives in a browser."""

    def __init__(self, positions: Array, colours: Array, wxyzs: Array) -> None:
        self.batched_positions, self.batched_colors = positions, colours
        self.batched_wxyzs = wxyzs


class Scene:
    """Keeps what it is told, as a browser would, and counts it."""

    def __init__(self) -> None:
        self.nodes: dict[str, Any] = {}
        self.told = 0

    def add_batched_meshes_simple(self, name: str, *shape: Array, **given: Any) -> Mesh:
        self.told += 1
        self.nodes[name] = Mesh(
            given["batched_positions"], given["batched_colors"], given["batched_wxyzs"]
        )
        return self.nodes[name]  # type: ignore[no-any-return]

    def add_line_segments(self, name: str, ends: Array, colours: Array, **look: Any) -> None:
        self.told += 1
        self.nodes[name] = (ends, colours)

    def add_label(self, name: str, text: str, **look: Any) -> None:
        self.told += 1
        self.nodes[name] = text

    def remove_by_name(self, name: str) -> None:
        del self.nodes[name]

    def cubes(self) -> dict[tuple[float, ...], tuple[int, ...]]:
        """The colour of every cube that is shown."""
        found = {}
        for mesh in self.nodes.values():
            assert len(mesh.batched_wxyzs) == len(mesh.batched_positions)
            for place, colour in zip(mesh.batched_positions, mesh.batched_colors, strict=True):
                found[tuple(place)] = tuple(colour)
        return found


def _cubes(index: Array) -> Cubes:
    return Cubes(index, np.ones(len(index), np.float32), 0.1, 1, len(index))


@pytest.fixture
def cloud(rng: np.random.Generator) -> Array:
    """Some 20,000 cubes over 4 x 4 x 4 chunks, some below zero."""
    return np.unique(rng.integers(-64, 64, (20_000, 3)).astype(np.int32), axis=0)


def test_a_scene_shows_what_was_drawn_last(cloud: Array, rng: np.random.Generator) -> None:
    """Whatever came before: cubes that come, go, and change their colours."""
    scene = Scene()
    canvas = Canvas(scene)
    for share in (1.0, 0.7, 0.0, 0.7, 0.2, 1.0):
        index = cloud[rng.random(len(cloud)) < share]
        colours = rng.integers(0, 4, (len(index), 3)).astype(np.uint8)
        canvas.cubes("/cubes", _cubes(index), colours)
        wanted = {
            tuple(place): tuple(colour)
            for place, colour in zip(_cubes(index).centres_m, colours, strict=True)
        }
        assert scene.cubes() == wanted


def test_only_changed_chunks_are_sent(cloud: Array) -> None:
    scene = Scene()
    canvas = Canvas(scene)
    colours = np.full((len(cloud), 3), 7, np.uint8)
    canvas.cubes("/cubes", _cubes(cloud), colours)
    whole = canvas.sent_bytes
    assert whole == 15 * len(cloud) and scene.told == 64
    canvas.cubes("/cubes", _cubes(cloud), colours)
    assert canvas.sent_bytes == whole
    near = (cloud[:, 0] >> 5 == 1) & (cloud[:, 1] >> 5 == -2) & (cloud[:, 2] >> 5 == 0)
    colours = colours.copy()
    colours[np.flatnonzero(near)[0]] = 9
    canvas.cubes("/cubes", _cubes(cloud), colours)
    assert canvas.sent_bytes - whole == 3 * near.sum()  # its colours alone
    assert scene.told == 64


def test_a_path_is_sent_where_it_grows() -> None:
    scene = Scene()
    canvas = Canvas(scene)
    ends = np.arange(6 * 1000, dtype=np.float32).reshape(1000, 2, 3)
    canvas.lines("/path", ends[:900], (1, 2, 3), 1.0)
    first = scene.told
    canvas.lines("/path", ends[:901], (1, 2, 3), 1.0)
    assert scene.told == first + 1
    canvas.lines("/path", ends[:10], (1, 2, 3), 1.0)
    shown = np.concatenate([lines for lines, _ in scene.nodes.values()])
    np.testing.assert_array_equal(shown, ends[:10])


def test_labels_come_and_go() -> None:
    scene = Scene()
    canvas = Canvas(scene)
    pose = Pose(1.0, 2.0, 3.0)
    canvas.labels("/scans", [("scan 1", pose), ("scan 2", pose)], "top-left")
    canvas.labels("/scans", [("scan 1", pose)], "top-left")
    assert list(scene.nodes.values()) == ["scan 1"] and scene.told == 2
    canvas.remove("/scans")
    assert scene.nodes == {}
