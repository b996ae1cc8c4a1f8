"""Files of maps that are larger than memory: written part by part, read back by others."""

from collections.abc import Iterator
from pathlib import Path

import laspy
import numpy as np
import pyproj
import pytest
import rasterio
from numpy.typing import NDArray

from mapperd.export.geotiff import NO_DATA, GridPlace, RasterBand, las_cloud, write_las, write_tiles
from mapperd.geometry.geodesy import Origin
from mapperd.mapping.sonar_map import SonarMap, Voxels

KIEL = Origin.of_degrees(54.36, 10.16)
EDGE = 16
BANDS = (RasterBand("depth of the shoalest voxel", "m"), RasterBand("pings"))
PLACE = GridPlace(west_m=-8.0, north_m=4.0, cell_m=0.5, width=40, height=20)


def numbers() -> NDArray[np.float32]:
    """A grid (rows, columns, bands) that ends inside its last tiles."""
    grid = np.random.default_rng(3).normal(size=(2 * EDGE, 3 * EDGE, 2)).astype(np.float32)
    grid[:EDGE, EDGE : 2 * EDGE] = NO_DATA
    return grid


def tiles_of(grid: NDArray[np.float32]) -> Iterator[NDArray[np.float32] | None]:
    for row in range(0, len(grid), EDGE):
        for column in range(0, grid.shape[1], EDGE):
            tile = grid[row : row + EDGE, column : column + EDGE]
            yield None if (tile == NO_DATA).all() else np.ascontiguousarray(tile)


def part(voxels: Voxels, chosen: slice) -> Voxels:
    return Voxels(voxels.centres_m[chosen], voxels.probability[chosen], voxels.count[chosen])


@pytest.mark.parametrize("origin", [KIEL, None])
def test_tiles_are_one_grid(tmp_path: Path, origin: Origin | None) -> None:
    grid = numbers()
    with (tmp_path / "a.tif").open("wb") as file:
        write_tiles(file, tiles_of(grid), PLACE, BANDS, origin, edge=EDGE)
    with rasterio.open(tmp_path / "a.tif") as read:
        assert (read.width, read.height, read.nodata) == (40, 20, NO_DATA)
        assert (read.bounds.left, read.bounds.top) == (-8.0, 4.0)
        assert (read.res, read.block_shapes[0]) == ((0.5, 0.5), (EDGE, EDGE))
        assert read.descriptions == ("depth of the shoalest voxel", "pings")
        assert read.units == ("m", None)
        assert (read.read().transpose(1, 2, 0) == grid[:20, :40]).all()
        if origin is None:
            assert read.crs is None
        else:
            there = pyproj.Transformer.from_crs(read.crs.to_wkt(), 4326, always_xy=True)
            assert there.transform(0.0, 0.0) == pytest.approx((10.16, 54.36), abs=1e-9)


def test_tile_that_holds_nothing_takes_no_room(tmp_path: Path) -> None:
    sizes = []
    for rows in (2, 200):
        place = GridPlace(0.0, 0.0, 1.0, EDGE, EDGE * rows)
        with (tmp_path / "a.tif").open("w+b") as file:
            write_tiles(file, iter([None] * rows), place, BANDS, None, edge=EDGE)
            sizes.append(file.tell())
    assert sizes[1] - sizes[0] < 198 * 20


@pytest.mark.parametrize("origin", [KIEL, None])
def test_cloud_in_parts_is_the_cloud(
    large_map: SonarMap, tmp_path: Path, origin: Origin | None
) -> None:
    voxels = large_map.voxels("occupied")
    box_m = np.stack([voxels.centres_m.min(axis=0), voxels.centres_m.max(axis=0)])
    with (tmp_path / "whole.laz").open("w+b") as file:
        write_las(file, voxels, origin, packed=True)
    with (
        (tmp_path / "parts.laz").open("w+b") as file,
        las_cloud(file, box_m, origin, packed=True, height_m=2.5) as add,
    ):
        for begin in range(0, len(voxels), 300):
            add(part(voxels, slice(begin, begin + 300)))
    whole, parts = laspy.read(tmp_path / "whole.laz"), laspy.read(tmp_path / "parts.laz")
    assert np.abs(parts.xyz - whole.xyz - (0.0, 0.0, 2.5)).max() < 1e-9
    assert (parts.probability == whole.probability).all()
    assert (parts["count"] == whole["count"]).all()
    assert parts.header.parse_crs() == whole.header.parse_crs()
    assert parts.header.mins == pytest.approx(parts.xyz.min(axis=0))
