"""Maps from above, read back by GDAL and by a loader that follows map_server's rule."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio
import yaml
from PIL import Image

from mapperd import _core
from mapperd.errors import ExportError
from mapperd.export import cells
from mapperd.export.cells import Heights, KnownCells, indices_of
from mapperd.mapping.sonar_map import SonarMap
from tests.support.maps import COARSE, FREE, OCCUPIED, UNSURE, map_of, with_thresholds

Saved = Callable[..., Path]


def elevation(path: Path, x_m: float, y_m: float) -> float | None:
    """What GDAL finds at a place."""
    with rasterio.open(path) as grid:
        value = next(grid.sample([(x_m, y_m)]))[0]
        return None if value == grid.nodata else float(value)


def occupancy(path: Path, x_m: float, y_m: float) -> int:
    """What a map server finds at a place: 100, 0 or -1."""
    facts = yaml.safe_load(path.read_text(encoding="utf-8"))
    picture = np.asarray(Image.open(path.parent / facts["image"]))
    assert (facts["mode"], facts["negate"]) == ("trinary", 0)
    column = int((x_m - facts["origin"][0]) / facts["resolution"])
    row = picture.shape[0] - 1 - int((y_m - facts["origin"][1]) / facts["resolution"])
    shade = (255 - int(picture[row, column])) / 255
    if shade > facts["occupied_thresh"]:
        return 100
    return 0 if shade < facts["free_thresh"] else -1


def test_asc_is_the_highest_occupied_voxel_of_each_column(
    sonar_map: SonarMap, saved: Saved
) -> None:
    path = saved(sonar_map, "harbour.asc")
    with rasterio.open(path) as grid:
        assert (grid.width, grid.height, grid.nodata) == (3, 3, -9999)
        assert tuple(grid.bounds) == (-3.25, 19.75, -2.5, 20.5)
    assert elevation(path, -3.125, 20.375) == -6.125
    assert elevation(path, -2.625, 19.875) == -7.125
    assert elevation(path, -2.875, 20.125) is None


def test_asc_agrees_with_a_loop_over_the_voxels(large_map: SonarMap, saved: Saved) -> None:
    top: dict[tuple[float, float], float] = {}
    for x, y, z in large_map.voxels("occupied").centres_m.tolist():
        top[x, y] = max(z, top.get((x, y), -np.inf))
    path = saved(large_map, "harbour.asc")
    with rasterio.open(path) as grid:
        band = grid.read(1)
        assert (band != grid.nodata).sum() == len(top)
        for (x, y), z in top.items():
            assert band[grid.index(x, y)] == z


@pytest.mark.parametrize("name", ["harbour.asc", "harbour.tif", "harbour.pgm"])
def test_strips_of_a_grid_make_the_file_of_the_whole(
    large_map: SonarMap, saved: Saved, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = saved(large_map, name).read_bytes()
    tops = cells.Tops(large_map, Heights())
    assert tops.window is not None
    rows = tops.window.height
    monkeypatch.setattr(cells, "STRIP_CELLS", 1)
    monkeypatch.setattr("mapperd.export.geotiff.TILE_CELLS", 16)
    monkeypatch.setattr("mapperd.export.formats.ROWS_AT_ONCE", 3)
    strips = list(tops.strips(16))
    assert [len(strip.z) for strip in strips] == [16] * (rows // 16) + [rows % 16] * (rows % 16 > 0)
    assert len(strips) > 1
    if name.endswith(".tif"):
        with (
            rasterio.open(saved(large_map, name)) as grid,
            rasterio.MemoryFile(whole) as before,
            before.open() as first,
        ):
            assert np.array_equal(grid.read(), first.read())
    else:
        assert saved(large_map, name).read_bytes() == whole


def test_asc_of_a_band_of_heights(sonar_map: SonarMap, saved: Saved) -> None:
    path = saved(sonar_map, "harbour.asc", Heights(-8.0, -6.5))
    assert elevation(path, -3.125, 20.375) == -7.875


def test_nav2_reports_occupied_free_and_unknown(sonar_map: SonarMap, saved: Saved) -> None:
    path = saved(sonar_map, "harbour.pgm").with_suffix(".yaml")
    for x, y, _ in OCCUPIED:
        assert occupancy(path, x, y) == 100
    for x, y, _ in FREE[1:]:  # over the first one stands an occupied voxel
        assert occupancy(path, x, y) == 0
    assert occupancy(path, *UNSURE[0][:2]) == -1
    assert occupancy(path, -3.125, 19.875) == -1


def test_nav2_of_a_band_of_heights(sonar_map: SonarMap, saved: Saved) -> None:
    path = saved(sonar_map, "slice.pgm", Heights(-6.0, 0.0)).with_suffix(".yaml")
    assert occupancy(path, -3.125, 20.375) == 0
    with Image.open(path.with_suffix(".pgm")) as picture:
        assert picture.size == (1, 1)


def test_nav2_agrees_with_a_loop_over_the_voxels(large_map: SonarMap, saved: Saved) -> None:
    path = saved(large_map, "harbour.pgm", Heights(-1.0, 1.5)).with_suffix(".yaml")
    expected: dict[tuple[float, float], int] = {}
    for kind, value in (("free", 0), ("occupied", 100)):
        for x, y, z in large_map.voxels(kind).centres_m.tolist():  # type: ignore[arg-type]
            if -1.0 <= z <= 1.5:
                expected[x, y] = max(value, expected.get((x, y), 0))
    assert len(expected) > 500
    for (x, y), value in expected.items():
        assert occupancy(path, x, y) == value


def test_thresholds_of_a_grid_are_those_of_the_map(saved: Saved) -> None:
    wide = map_of(OCCUPIED, FREE, UNSURE, config=with_thresholds(0.5, 0.1))
    path = saved(wide, "harbour.pgm").with_suffix(".yaml")
    assert occupancy(path, *UNSURE[0][:2]) == 100
    assert wide.counts().occupied == len(OCCUPIED) + len(UNSURE)


def test_what_was_never_seen_is_unknown_even_where_little_is_enough(saved: Saved) -> None:
    path = saved(map_of(OCCUPIED, config=with_thresholds(0.4, 0.1)), "harbour.pgm")
    with Image.open(path) as picture:
        assert picture.size == (3, 3)
        assert sorted(picture.tobytes()) == [0, 0] + [205] * 7


@pytest.mark.parametrize("name", ["empty.asc", "empty.pgm"])
def test_nothing_is_no_grid(tmp_path: Path, saved: Saved, name: str) -> None:
    with pytest.raises(ExportError, match=r"nothing is known|no occupied voxel"):
        saved(SonarMap(COARSE), name)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["far.asc", "far.pgm"])
def test_voxels_far_apart_are_refused_before_memory_is_taken(
    tmp_path: Path, saved: Saved, name: str
) -> None:
    with pytest.raises(ExportError, match="too large"):
        saved(map_of([(0.125, 0.125, 0.125), (4e5, 4e5, 0.125)]), name)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("unit", [0.25, 0.5, 0.75])
def test_a_voxel_a_unit_beyond_a_threshold_is_on_its_side(unit: float) -> None:
    """Thresholds lie between two units: the units beside them are apart."""
    threshold = (1000 + unit) * _core.LOG_ODDS_UNIT
    known = KnownCells(Heights(), 0.1, threshold, -threshold)
    units = np.zeros((1, _core.BLOCK_EDGE**3), np.int32)
    units[0, :4] = 1001, 1000, -1001, -1000
    known.add(np.zeros((1, 3), np.int32), units, (units != 0).astype(np.uint16))
    found = known.cells()
    assert found is not None
    assert found.values.ravel().tolist() == [cells.OCCUPIED, cells.UNKNOWN, cells.FREE]


@pytest.mark.parametrize("resolution_m", [0.05, 0.1, 0.07])
def test_centres_that_rounding_left_low_are_in_their_cells(resolution_m: float) -> None:
    index = np.arange(-3000, 3000, dtype=np.float64)
    assert (indices_of((index + 0.5) * resolution_m, resolution_m) == index).all()
