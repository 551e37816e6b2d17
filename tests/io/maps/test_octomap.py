"""OctoMap's files as OctoMap itself reads them: its Python binding and Debian's octomap-tools."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import octomap
import pytest

from insonify.io.maps import load_map, save_map
from insonify.mapping.voxels import BLOCK, IN_VIEW, OBSERVED, VoxelMap
from insonify.types import Array

MakeMap = Callable[..., VoxelMap]


def _observed(voxels: VoxelMap) -> tuple[Array, Array]:
    """Centres (N, 3) and log-odds of the observed voxels."""
    slot, voxel = np.nonzero(voxels.seen & OBSERVED)
    within = np.column_stack(np.unravel_index(voxel, (BLOCK, BLOCK, BLOCK)))
    centres = (voxels.coords[slot] * BLOCK + within + 0.5) * voxels.voxel_m
    return centres, voxels.log_odds[slot, voxel]


def _by_octomap(path: Path) -> octomap.OcTree:
    if path.suffix == ".ot":
        return octomap.OcTree.read(str(path).encode())
    tree = octomap.OcTree(1.0)
    assert tree.readBinary(str(path).encode())
    return tree


@pytest.mark.parametrize("suffix", [".bt", ".ot"])
@pytest.mark.parametrize("seed", [1, 2])
def test_octomap_finds_every_voxel_where_we_have_it(
    suffix: str,
    seed: int,
    tmp_path: Path,
    make_map: MakeMap,
) -> None:
    voxels = make_map(seed, voxel_m=0.25)
    save_map(voxels, tmp_path / f"m{suffix}")
    tree = _by_octomap(tmp_path / f"m{suffix}")
    assert tree.getResolution() == 0.25
    centres, log_odds = _observed(voxels)
    for centre, value in list(zip(centres, log_odds, strict=True))[::7]:
        node = tree.search(centre)
        assert tree.isNodeOccupied(node) == (value > 0)
        if suffix == ".ot":
            assert node.getLogOdds() == pytest.approx(value, abs=1e-30)
        key = tree.coordToKey(centre)
        np.testing.assert_allclose(tree.keyToCoord(key), centre, atol=1e-9)
    leaves = sum(round(leaf.getSize() / 0.25) ** 3 for leaf in tree.begin_leafs())
    assert leaves == len(centres)


def test_a_file_of_octomaps_own_is_read_with_its_pruned_leaves(tmp_path: Path) -> None:
    tree = octomap.OcTree(0.5)
    rng = np.random.default_rng(3)
    cube = (np.stack(np.meshgrid(*[np.arange(-16, 16)] * 3), axis=-1).reshape(-1, 3) + 0.5) * 0.5
    loose = rng.uniform(-30, 30, (200, 3))
    for point in cube:
        tree.updateNode(point, False)
    for point in loose:
        tree.updateNode(point, True)
    tree.updateInnerOccupancy()
    assert tree.write(str(tmp_path / "m.ot").encode())
    tree.toMaxLikelihood()
    assert tree.writeBinary(str(tmp_path / "m.bt").encode())
    for name in ("m.ot", "m.bt"):
        voxels = load_map(tmp_path / name)
        centres, log_odds = _observed(voxels)
        volume = sum(round(leaf.getSize() / 0.5) ** 3 for leaf in tree.begin_leafs())
        assert len(centres) == volume
        for centre, value in list(zip(centres, log_odds, strict=True))[::11]:
            assert tree.isNodeOccupied(tree.search(centre)) == (value > 0)
        assert set(np.unique(voxels.seen)) == {0, IN_VIEW | OBSERVED}


def test_inner_nodes_are_octomaps(tmp_path: Path, make_map: MakeMap) -> None:
    voxels = make_map(8, blocks=8, reach=3)
    save_map(voxels, tmp_path / "ours.ot")
    tree = _by_octomap(tmp_path / "ours.ot")
    tree.updateInnerOccupancy()
    assert tree.write(str(tmp_path / "theirs.ot").encode())
    ours, theirs = ((tmp_path / f"{who}.ot").read_bytes() for who in ("ours", "theirs"))
    assert ours.split(b"\ndata\n")[1] == theirs.split(b"\ndata\n")[1]


def _program(name: str) -> str:
    found = shutil.which(name)
    if found is None:
        pytest.skip(f"needs {name} of Debian's octomap-tools (.ci/run installs it)")
    return found


def test_debians_octomap_writes_the_same_nodes(tmp_path: Path, make_map: MakeMap) -> None:
    voxels = make_map(9)
    ours, theirs = tmp_path / "ours.bt", tmp_path / "theirs.bt"
    save_map(voxels, ours)
    save_map(voxels, tmp_path / "ours.ot")
    subprocess.run(
        [_program("convert_octree"), tmp_path / "ours.ot", theirs], check=True, capture_output=True
    )
    ends = [path.read_bytes().split(b"\ndata\n")[1] for path in (ours, theirs)]
    assert ends[0] == ends[1]
    back = tmp_path / "back.ot"
    subprocess.run(
        [_program("convert_octree"), tmp_path / "ours.ot", back], check=True, capture_output=True
    )
    ends = [path.read_bytes().split(b"\ndata\n")[1] for path in (tmp_path / "ours.ot", back)]
    assert ends[0] == ends[1]


def test_debians_octomap_shows_the_occupied_voxels(tmp_path: Path) -> None:
    voxels = VoxelMap(0.5)
    voxels.allocate(np.array([[-1, 0, 2]], np.int32))
    voxels.seen[0, [0, 77, 300]] = IN_VIEW | OBSERVED
    voxels.log_odds[0, [0, 77, 300]] = 1.0, 2.0, -1.0
    save_map(voxels, tmp_path / "m.bt")
    subprocess.run([_program("bt2vrml"), tmp_path / "m.bt"], check=True, capture_output=True)
    text = (tmp_path / "m.bt.wrl").read_text()
    shown = {tuple(map(float, part.split()[:3])) for part in text.split("translation")[1:]}
    assert shown == {tuple(centre) for centre in voxels.occupied_m().round(6).tolist()}
