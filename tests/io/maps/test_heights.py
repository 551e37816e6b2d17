"""Heights against a column worked out by hand, and the GeoTIFF as GDAL reads it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.crs import CRS
from rasterio.warp import transform

from insonify.io.datum import Datum
from insonify.io.maps import save_map
from insonify.io.maps.heights import height_grid
from insonify.mapping.voxels import IN_VIEW, OBSERVED, VoxelMap


def _logit(p: float) -> float:
    return float(np.log(p / (1 - p)))


def _put(voxels: VoxelMap, index: tuple[int, int, int], p: float) -> None:
    block, within = np.divmod(index, 8)
    slot = voxels.allocate(block[None].astype(np.int32))[0]
    voxel = np.ravel_multi_index(tuple(within), (8, 8, 8))
    voxels.log_odds[slot, voxel], voxels.seen[slot, voxel] = _logit(p), IN_VIEW | OBSERVED


@pytest.fixture
def voxels() -> VoxelMap:
    voxels = VoxelMap(0.5)
    for z, p in ((3, 0.2), (1, 0.6), (0, 0.9), (-9, 0.3)):
        _put(voxels, (2, -3, z), p)
    _put(voxels, (4, 1, -20), 0.98)
    _put(voxels, (-7, 5, 30), 0.4)  # free: its column has no height
    return voxels


def test_the_height_is_the_highest_occupied_voxel_and_its_doubt_is_the_columns(
    voxels: VoxelMap,
) -> None:
    grid = height_grid(voxels, Path("m.xyz"))
    assert grid.height_m.shape == (5, 3)
    assert (grid.west_m, grid.north_m) == (1.0, 1.0)
    found = {(int(r), int(c)) for r, c in np.argwhere(np.isfinite(grid.height_m))}
    assert found == {(4, 0), (0, 2)}
    assert grid.height_m[4, 0] == pytest.approx(1.5 * 0.5)
    assert grid.height_m[0, 2] == pytest.approx(-19.5 * 0.5)
    # first to be occupied from above: 0.2, 0.8 x 0.6, 0.8 x 0.4 x 0.9, 0.8 x 0.4 x 0.1 x 0.3
    weights = np.array([0.2, 0.48, 0.288, 0.0096])
    square = (weights * np.array([2, 0, -1, -10]) ** 2).sum() / weights.sum() + 1 / 12
    assert grid.uncertainty_m[4, 0] == pytest.approx(0.5 * np.sqrt(square), rel=1e-5)
    assert grid.uncertainty_m[0, 2] == pytest.approx(0.5 / np.sqrt(12), rel=1e-5)


def test_xyz_lists_the_columns(voxels: VoxelMap, tmp_path: Path) -> None:
    save_map(voxels, tmp_path / "m.xyz")
    rows = np.loadtxt(tmp_path / "m.xyz")
    np.testing.assert_allclose(rows[:, :3], [[2.25, 0.75, -9.75], [1.25, -1.25, 0.75]])
    np.testing.assert_allclose(rows[0, 3], 0.5 / np.sqrt(12), atol=1e-4)


def test_gdal_reads_the_geotiff(voxels: VoxelMap, tmp_path: Path) -> None:
    save_map(voxels, tmp_path / "m.tif", datum=Datum(54.32, 10.13))
    with rasterio.open(tmp_path / "m.tif") as file:
        assert (file.count, file.width, file.height) == (2, 3, 5)
        assert file.descriptions[0] == "height, m"
        assert np.isnan(file.nodata)
        height, spread = file.read()
        row, column = file.index(2.25, 0.75)
        assert height[row, column] == pytest.approx(-9.75)
        assert spread[row, column] == pytest.approx(0.5 / np.sqrt(12))
        wgs84 = CRS.from_epsg(4326)
        (east,), (north,) = transform(file.crs, wgs84, [0.0], [0.0])
        assert (east, north) == pytest.approx((10.13, 54.32), abs=1e-9)
        # a degree of latitude is 111,318 m long there (WGS 84 meridian, by series)
        phi = np.radians(54.32)
        degree_m = 111132.954 - 559.822 * np.cos(2 * phi) + 1.175 * np.cos(4 * phi)
        (_,), (north,) = transform(file.crs, wgs84, [0.0], [1000.0])
        assert (north - 54.32) * degree_m == pytest.approx(1000.0, abs=0.05)


def test_without_a_datum_there_is_no_reference_system(voxels: VoxelMap, tmp_path: Path) -> None:
    save_map(voxels, tmp_path / "m.tif")
    with rasterio.open(tmp_path / "m.tif") as file:
        assert file.crs is None
        assert (file.transform.c, file.transform.f, file.transform.e) == (1.0, 1.0, -0.5)
