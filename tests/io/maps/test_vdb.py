"""The VDB file as OpenVDB's own library reads it."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from insonify.io.maps import save_map
from insonify.mapping.voxels import BLOCK, OBSERVED, VoxelMap, probability_from_log_odds

_READ = """
import json, sys, pyopenvdb
grids, meta = pyopenvdb.readAll(sys.argv[1])
points = json.load(sys.stdin)
answer = {}
for grid in grids:
    read = grid.getConstAccessor()
    answer[grid.name] = {
        "active": grid.activeVoxelCount(),
        "values": [read.probeValue(tuple(p)) for p in points],
        "centre": grid.transform.indexToWorld(tuple(points[0])),
        "background": grid.background,
    }
json.dump(answer, sys.stdout)
"""

MakeMap = Callable[..., VoxelMap]


def test_openvdb_reads_every_voxel(tmp_path: Path, make_map: MakeMap) -> None:
    python = Path("/usr/bin/python3")
    code = "import pyopenvdb"
    if not python.exists() or subprocess.run([python, "-c", code], capture_output=True).returncode:
        pytest.skip("needs Debian's python3-openvdb (.ci/run installs it)")
    voxels = make_map(6, blocks=30, reach=600)
    save_map(voxels, tmp_path / "m.vdb")
    slot, voxel = np.nonzero(voxels.seen & OBSERVED)
    index = voxels.coords[slot] * BLOCK
    index = index + np.column_stack(np.unravel_index(voxel, (BLOCK, BLOCK, BLOCK)))
    log_odds = voxels.log_odds[slot, voxel]
    done = subprocess.run(
        [python, "-c", _READ, tmp_path / "m.vdb"],
        input=json.dumps([*index.tolist(), [10**6, 5, 5]]),
        capture_output=True,
        text=True,
        check=True,
    )
    answer = json.loads(done.stdout)
    expected = {"log_odds": log_odds, "probability": probability_from_log_odds(log_odds)}
    assert set(answer) == set(expected)
    for name, values in expected.items():
        grid = answer[name]
        assert grid["active"] == len(index) and grid["background"] == 0.0
        *known, outside = grid["values"]
        assert outside == [0.0, False] and all(active for _, active in known)
        np.testing.assert_allclose([value for value, _ in known], values, rtol=1e-6, atol=1e-30)
        np.testing.assert_allclose(grid["centre"], (index[0] + 0.5) * 0.1)
