"""Files of survey offices, read back by laspy and GDAL; places are judged by PROJ."""

import math
import sys
from collections.abc import Callable
from pathlib import Path

import laspy
import numpy as np
import pyproj
import pytest
import rasterio

from mapperd.config.layers import Layered
from mapperd.config.live import ConfigStore
from mapperd.daemon.map_folder import MapFolder
from mapperd.errors import ExportError
from mapperd.export.cells import Heights
from mapperd.export.formats import crs_of, write_map
from mapperd.geometry.geodesy import Origin
from mapperd.mapping.sonar_map import SonarMap
from tests.support.maps import COARSE, map_of

Saved = Callable[..., Path]

KIEL = Origin.of_degrees(54.36, 10.16)
BUOY = (54.3634, 10.1712)
"""A place 810 m from the origin, in degrees."""


def buoy_map() -> tuple[SonarMap, tuple[float, float]]:
    """A map of one voxel that holds the place, 12 m down, and degrees of its centre by PROJ."""
    x_m, y_m, _ = KIEL.enu_m(math.radians(BUOY[0]), math.radians(BUOY[1]), -12.0)
    centre = (np.floor(np.array([x_m, y_m, -12.0]) / 0.25) + 0.5) * 0.25
    there = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +inv +proj=topocentric +lat_0=54.36 +lon_0=10.16 +h_0=0 "
        "+ellps=WGS84 +step +inv +proj=cart +ellps=WGS84"
    )
    longitude, latitude, _ = there.transform(centre[0], centre[1], centre[2])
    assert abs(latitude - BUOY[0]) * 111e3 < 0.3
    return map_of([tuple(centre)]), (latitude, longitude)


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_cloud_holds_every_occupied_voxel(large_map: SonarMap, saved: Saved, suffix: str) -> None:
    cloud = laspy.read(saved(large_map, f"harbour{suffix}"))
    voxels = large_map.voxels("occupied")
    assert cloud.header.are_points_compressed == (suffix == ".laz")
    assert np.abs(cloud.xyz - voxels.centres_m).max() < 1e-9
    assert (cloud.probability == voxels.probability).all()
    assert (cloud["count"] == voxels.count).all()
    assert (cloud.intensity == np.rint(voxels.probability * 65535)).all()
    assert cloud.header.parse_crs() is None
    assert (cloud.header.mins, cloud.header.maxs) == (
        pytest.approx(voxels.centres_m.min(axis=0)),
        pytest.approx(voxels.centres_m.max(axis=0)),
    )


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_cloud_lies_where_the_place_is(tmp_path: Path, suffix: str) -> None:
    sonar_map, (latitude, longitude) = buoy_map()
    write_map(sonar_map, tmp_path / f"buoy{suffix}", origin=KIEL)
    cloud = laspy.read(tmp_path / f"buoy{suffix}")
    system = cloud.header.parse_crs()
    assert system.to_epsg() == 32632
    to_system = pyproj.Transformer.from_crs(4326, system, always_xy=True)
    expected = to_system.transform(longitude, latitude)
    assert np.abs(cloud.xyz[0, :2] - expected).max() < 1e-4
    assert cloud.z[0] == pytest.approx(-11.875)


def test_grid_lies_where_the_place_is(tmp_path: Path) -> None:
    sonar_map, (latitude, longitude) = buoy_map()
    write_map(sonar_map, tmp_path / "buoy.tif", origin=KIEL)
    with rasterio.open(tmp_path / "buoy.tif") as grid:
        to_system = pyproj.Transformer.from_crs(4326, grid.crs.to_wkt(), always_xy=True)
        middle = grid.xy(0, 0)
        assert (grid.width, grid.height) == (1, 1)
        assert np.abs(np.subtract(middle, to_system.transform(longitude, latitude))).max() < 2e-3
        assert next(grid.sample([middle]))[0] == -11.875


def test_grid_has_the_cells_of_the_ascii_grid(large_map: SonarMap, saved: Saved) -> None:
    heights = Heights(-1.0, 1.5)
    text, picture = saved(large_map, "harbour.asc", heights), None
    with rasterio.open(text) as grid:
        expected, transform = grid.read(1), grid.transform
    text.unlink()
    picture = saved(large_map, "harbour.tif", heights)
    voxels = large_map.voxels("occupied")
    seen = {tuple(row): n for row, n in zip(voxels.centres_m, voxels.count, strict=True)}
    with rasterio.open(picture) as grid:
        assert (grid.crs, grid.nodata, grid.transform) == (None, -9999, transform)
        assert grid.units == ("m", None)
        height, count = grid.read()
        assert (height == expected).all()
        known = height != -9999
        assert (count[~known] == -9999).all()
        for row, column in np.argwhere(known):
            assert count[row, column] == seen[*grid.xy(row, column), height[row, column]]


def test_count_of_a_cell_is_that_of_its_top(tmp_path: Path) -> None:
    sonar_map = map_of([(0.1, 0.1, -2.1), (0.1, 0.1, -1.1), (0.6, 0.1, -1.1)])
    for _ in range(4):  # seen five times
        sonar_map.core.observe(
            np.array([[0.125, 0.125, -1.125]]), np.array([200.0]), np.array([True])
        )
    write_map(sonar_map, tmp_path / "a.tif")
    with rasterio.open(tmp_path / "a.tif") as grid:
        assert grid.read(2).tolist() == [[5.0, -9999.0, 1.0]]


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_nothing_is_a_cloud_without_points(saved: Saved, suffix: str) -> None:
    assert len(laspy.read(saved(SonarMap(COARSE), f"empty{suffix}")).points) == 0


def test_nothing_is_no_grid(saved: Saved) -> None:
    with pytest.raises(ExportError, match="no occupied voxel"):
        saved(SonarMap(COARSE), "empty.tif")


def test_map_that_a_cloud_cannot_hold_is_refused(saved: Saved) -> None:
    with pytest.raises(ExportError, match="429 km"):
        saved(map_of([(0.1, 0.1, 0.1), (430_000.1, 0.1, 0.1)]), "wide.las")


@pytest.mark.parametrize(
    ("name", "library", "extra"), [("a.laz", "laspy", "las"), ("a.tif", "tifffile", "geo")]
)
def test_library_that_is_missing_is_reported_by_its_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, library: str, extra: str
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ExportError, match=rf"`{extra}`: .*pip install '{library}"):
        write_map(buoy_map()[0], tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_packer_that_is_missing_is_reported_by_its_extra(
    sonar_map: SonarMap, saved: Saved, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(laspy.LazBackend, "is_available", lambda _: False)
    saved(sonar_map, "a.las").unlink()
    with pytest.raises(ExportError, match=r"`las`: .*pip install 'laspy\[lazrs\]"):
        saved(sonar_map, "a.laz")


@pytest.mark.parametrize(
    ("name", "origin", "crs"),
    [
        ("a.laz", KIEL, "WGS 84 / UTM zone 32N, EPSG:32632"),
        ("a.tif", KIEL, "WGS 84 / mapperd local 54.3600000 10.1600000"),
        ("a.las", None, "none: the geographic position of the map is unknown"),
        ("a.ply", KIEL, None),
    ],
)
def test_saving_reports_the_system(
    sonar_map: SonarMap, tmp_path: Path, name: str, origin: Origin | None, crs: str | None
) -> None:
    assert crs_of(Path(name), origin) == crs
    done = MapFolder(tmp_path, ConfigStore(Layered())).save(name, lambda: sonar_map, origin)
    assert done.get("crs") == crs
