from __future__ import annotations

import numpy as np
import pytest

from insonify.scene.objects import PROCEDURAL_OBJECTS


@pytest.mark.parametrize(
    ("name", "size_m"), [("tetrapod", (4.1, 3.7, 3.3)), ("shipwreck", (6.3, 11.4, 6.9))]
)
def test_objects_are_watertight_and_have_the_papers_size(
    name: str, size_m: tuple[float, float, float]
) -> None:
    mesh = PROCEDURAL_OBJECTS[name]()
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0
    assert mesh.body_count == 1
    np.testing.assert_allclose(mesh.extents, size_m, atol=1e-9)
    assert mesh.bounds[0][2] == pytest.approx(0.0)


def test_the_wrecks_hold_is_open_and_empty() -> None:
    mesh = PROCEDURAL_OBJECTS["shipwreck"]()
    assert not mesh.contains(np.array([[0.3, 0.5, 2.0]]))[0]
    hits = mesh.ray.intersects_location([[0.3, 0.5, 9.0]], [[0.0, 0.0, -1.0]])[0]
    assert hits[:, 2].max() < 1.5  # from above, the first thing met is the hold's floor


@pytest.mark.parametrize("name", sorted(PROCEDURAL_OBJECTS))
def test_every_object_stands_on_its_base_and_holds_what_it_shuts_in(name: str) -> None:
    mesh = PROCEDURAL_OBJECTS[name]()
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0.4
    assert max(mesh.extents) < 12.0
    np.testing.assert_allclose(mesh.bounds.mean(axis=0)[:2], 0.0, atol=1e-9)
    assert mesh.bounds[0][2] == pytest.approx(0.0)


def test_there_is_water_under_pipe_and_arch_and_within_the_trap() -> None:
    for name, point in (
        ("pipe", (0.0, 0.0, 0.3)),
        ("arch", (0, 0, 0.9)),
        ("trap", (0.2, 0.2, 0.6)),
    ):
        mesh = PROCEDURAL_OBJECTS[name]()
        assert not mesh.contains(np.array([point]))[0]
        down = mesh.ray.intersects_location([[*point[:2], 9.0]], [[0.0, 0.0, -1.0]])[0]
        assert name == "trap" or down[:, 2].max() > point[2]  # there is something above it
