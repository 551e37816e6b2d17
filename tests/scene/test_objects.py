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
