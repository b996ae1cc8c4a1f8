"""Products of a survey's map, read back by GDAL, laspy and numpy; places are judged by PROJ."""

import math
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pyproj
import pytest
import rasterio
from mapper_survey.errors import SurveyError
from mapper_survey.export import Exported, ExportOptions, export_survey
from mapper_survey.windows import WindowedMap
from numpy.typing import NDArray

from mapperd.errors import StoreError
from mapperd.export.cells import Heights
from mapperd.geometry.geodesy import Origin
from mapperd.mapping.sonar_map import SonarMap, Voxels
from mapperd.store.database import open_writer
from tests.tools.mapper_survey.maps import RESOLUTION_M, map_of, seabed, store_of

KIEL = Origin.of_degrees(54.36, 10.16)
BUOY = (54.3634, 10.1712)
"""A place 810 m from the origin, in degrees."""


@pytest.fixture(scope="module")
def bottom() -> SonarMap:
    return seabed(np.random.default_rng(11))


@pytest.fixture(scope="module")
def stored(bottom: SonarMap, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return store_of(tmp_path_factory.mktemp("survey") / "map.db", bottom)


def export(
    stored: Path, out: Path, *products: str, origin: Origin | None = None, **how: Any
) -> Exported:
    return export_survey(stored, out, products, origin, options=ExportOptions(**how))


def expected_cells(voxels: Voxels, edge: int, rule: str) -> dict[tuple[int, int], list[float]]:
    """Depth, uncertainty and count of each cell, the slow way."""
    index = np.rint(voxels.centres_m / RESOLUTION_M - 0.5).astype(int)
    columns: dict[tuple[int, int], dict[int, int]] = {}
    for number, (x, y, z) in enumerate(index.tolist()):
        columns.setdefault((x, y), {})[z] = number
    cells: dict[tuple[int, int], list[int]] = {}
    for (x, y), voxels_at in columns.items():
        z = max(voxels_at)
        while z in voxels_at:
            cells.setdefault((x // edge, y // edge), []).append(voxels_at[z])
            z -= 1
    found = {}
    for cell, numbers in cells.items():
        z_m = voxels.centres_m[numbers, 2]
        taken_m = np.max(z_m) if rule == "shoalest" else np.median(z_m)
        scatter = np.average((z_m - taken_m) ** 2, weights=voxels.probability[numbers])
        uncertainty_m = math.sqrt(RESOLUTION_M**2 / 12 + scatter)
        found[cell] = [-taken_m, uncertainty_m, int(voxels.count[numbers].max())]
    return found


@pytest.mark.slow
@pytest.mark.parametrize(("edge", "rule"), [(1, "shoalest"), (1, "median"), (4, "median")])
def test_grid_is_what_the_columns_hold(
    bottom: SonarMap, stored: Path, tmp_path: Path, edge: int, rule: str
) -> None:
    expected = expected_cells(bottom.voxels("occupied"), edge, rule)
    done = export(stored, tmp_path, "grid", cell_voxels=edge, rule=rule)
    with rasterio.open(done.files["grid"]) as grid:
        assert grid.crs is None
        assert grid.nodata == -9999
        assert rule in grid.descriptions[0]
        assert "positive down" in grid.descriptions[0]
        assert grid.units == ("m", "m", None)
        assert grid.res == pytest.approx((edge * RESOLUTION_M, edge * RESOLUTION_M))
        values = grid.read()
        rows, columns = np.nonzero(values[0] != -9999)
        middles = np.array(grid.xy(rows, columns)).T / grid.res[0]
    cells = [tuple(cell) for cell in np.floor(middles).astype(int).tolist()]
    assert done.cells == len(cells)
    assert set(cells) == expected.keys()
    wanted = np.array([expected[cell] for cell in cells])
    assert np.abs(values[:, rows, columns].T - wanted).max() < 1e-5
    assert ((values == -9999).all(axis=0) == (values == -9999).any(axis=0)).all()


def test_given_uncertainty_and_altitude_are_in_it(stored: Path, tmp_path: Path) -> None:
    plain = export(stored, tmp_path / "a", "grid")
    raised = export(stored, tmp_path / "b", "grid", vertical_uncertainty_m=0.3, altitude_m=-2.5)
    with rasterio.open(plain.files["grid"]) as a, rasterio.open(raised.files["grid"]) as b:
        before, after = a.read(masked=True), b.read(masked=True)
    assert np.ma.allclose(after[0], before[0] + 2.5, atol=1e-5)
    assert np.ma.allclose(after[1] ** 2, before[1] ** 2 + 0.09, atol=1e-6)


def test_only_heights_that_are_asked_for_count(stored: Path, tmp_path: Path) -> None:
    done = export(stored, tmp_path, "grid", "cloud", heights=Heights(-np.inf, 0.0))
    with rasterio.open(done.files["grid"]) as grid:
        assert grid.read(1, masked=True).min() > 5.0
    assert laspy.read(done.files["cloud"]).z.max() < -5.0


@pytest.mark.parametrize("bricks", [1, 2])
def test_pieces_of_any_size_give_the_same(stored: Path, tmp_path: Path, bricks: int) -> None:
    products = ("grid", "cloud", "soundings", "positions")
    one = export(stored, tmp_path / "a", *products, origin=KIEL, cell_voxels=4, window_bricks=4)
    many = export(
        stored, tmp_path / "b", *products, origin=KIEL, cell_voxels=4, window_bricks=bricks
    )
    with rasterio.open(one.files["grid"]) as a, rasterio.open(many.files["grid"]) as b:
        assert b.block_shapes[0] == (16 * bricks, 16 * bricks)
        window = rasterio.windows.from_bounds(*b.bounds, transform=a.transform)
        whole = a.read()
        assert (a.read(window=window) == b.read()).all()
        assert (whole[0] != -9999).sum() == (b.read(1) != -9999).sum() == one.cells
    for product in ("soundings", "positions"):
        lines = [sorted(done.files[product].read_text().split("\n")) for done in (one, many)]
        assert lines[0] == lines[1]
        assert len(lines[0]) == one.cells + 1
    clouds = [np.sort(laspy.read(done.files["cloud"]).points.array) for done in (one, many)]
    assert (clouds[0] == clouds[1]).all()


def test_cloud_holds_every_occupied_voxel(bottom: SonarMap, stored: Path, tmp_path: Path) -> None:
    done = export(stored, tmp_path, "cloud", altitude_m=1.5)
    cloud, voxels = laspy.read(done.files["cloud"]), bottom.voxels("occupied")
    assert cloud.header.are_points_compressed
    assert cloud.header.parse_crs() is None
    assert len(cloud.points) == done.voxels == len(voxels)
    order = [np.lexsort(np.rint(xyz * 1e4).T) for xyz in (cloud.xyz, voxels.centres_m)]
    there = voxels.centres_m[order[1]] + (0.0, 0.0, 1.5)
    assert np.abs(cloud.xyz[order[0]] - there).max() < 1e-6
    assert (cloud.probability[order[0]] == voxels.probability[order[1]]).all()


def test_products_lie_where_the_place_is(tmp_path: Path) -> None:
    x_m, y_m, _ = KIEL.enu_m(math.radians(BUOY[0]), math.radians(BUOY[1]), -12.0)
    index = np.floor(np.array([[x_m, y_m, -12.0]]) / RESOLUTION_M).astype(np.int64)
    stored = store_of(tmp_path / "map.db", map_of(index))
    products = ("grid", "cloud", "soundings", "positions")
    done = export(stored, tmp_path, *products, origin=KIEL)
    there = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +inv +proj=topocentric +lat_0=54.36 +lon_0=10.16 +h_0=0 "
        "+ellps=WGS84 +step +inv +proj=cart +ellps=WGS84"
    )
    longitude, latitude, _ = there.transform(*((index[0] + 0.5) * RESOLUTION_M))
    to_utm = pyproj.Transformer.from_crs(4326, 32632, always_xy=True)
    plane = to_utm.transform(longitude, latitude)
    cloud = laspy.read(done.files["cloud"])
    assert cloud.header.parse_crs().to_epsg() == 32632
    assert np.abs(cloud.xyz[0] - (*plane, -11.95)).max() < 1e-3
    assert np.abs(np.loadtxt(done.files["soundings"]) - (*plane, 11.95)).max() < 1e-3
    position = np.loadtxt(done.files["positions"])
    assert position == pytest.approx((longitude, latitude, 11.95), abs=2e-9)
    with rasterio.open(done.files["grid"]) as grid:
        to_grid = pyproj.Transformer.from_crs(4326, grid.crs.to_wkt(), always_xy=True)
        place = to_grid.transform(longitude, latitude)
        assert next(grid.sample([place]))[0] == pytest.approx(11.95)
        assert (grid.read(1) != -9999).sum() == 1
    assert done.crs["soundings"] == "WGS 84 / UTM zone 32N, EPSG:32632"


def test_memory_holds_one_window(
    bottom: SonarMap, stored: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sizes, part = [], WindowedMap.part

    def watched(self: WindowedMap, *box: Any) -> SonarMap:
        found = part(self, *box)
        sizes.append(found.core.block_count)
        return found

    monkeypatch.setattr(WindowedMap, "part", watched)
    reported: list[tuple[int, int]] = []
    export_survey(
        stored,
        tmp_path,
        ["grid", "cloud"],
        None,
        lambda *at: reported.append(at),
        options=ExportOptions(window_bricks=1),
    )
    assert sum(sizes) == bottom.core.block_count
    assert max(sizes) < bottom.core.block_count / 8
    assert reported == [(number, reported[0][1]) for number in range(1, reported[0][1] + 1)]


def test_damaged_map_is_refused_and_files_stay(stored: Path, tmp_path: Path) -> None:
    path = tmp_path / "map.db"
    path.write_bytes(stored.read_bytes())
    connection = open_writer(path)
    connection.execute("UPDATE brick SET crc = crc + 1 WHERE x = (SELECT max(x) FROM brick)")
    connection.close()
    (tmp_path / "depth.tif").write_bytes(b"as before")
    with pytest.raises(StoreError, match="damaged"):
        export(path, tmp_path, "grid")
    assert (tmp_path / "depth.tif").read_bytes() == b"as before"
    assert not list(tmp_path.glob(".*"))


NOTHING: NDArray[np.int64] = np.empty((0, 3), dtype=np.int64)


@pytest.mark.parametrize("free", [NOTHING, np.array([[1, 2, 3]])])
def test_map_without_a_surface_is_refused(tmp_path: Path, free: NDArray[np.int64]) -> None:
    stored = store_of(tmp_path / "map.db", map_of(NOTHING, free=free))
    with pytest.raises(SurveyError, match=r"map\.db"):
        export(stored, tmp_path, "grid", "cloud")
    assert not [path for path in tmp_path.iterdir() if not path.name.startswith("map.db")]


@pytest.mark.parametrize(
    ("products", "origin", "stated"),
    [
        (["chart"], KIEL, "no such product: chart; allowed: grid, cloud, soundings, positions"),
        ([], KIEL, "no such product: nothing"),
        (["positions"], None, "positions need an origin"),
    ],
)
def test_wrong_wishes_are_named(
    stored: Path, tmp_path: Path, products: list[str], origin: Origin | None, stated: str
) -> None:
    with pytest.raises(SurveyError, match=stated):
        export_survey(stored, tmp_path / "out", products, origin)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("how", "stated"),
    [
        ({"cell_voxels": 3}, "allowed: 1, 2, 4, 8, 16"),
        ({"rule": "mean"}, "allowed: shoalest, median"),
        ({"vertical_uncertainty_m": -1.0}, "vertical_uncertainty_m"),
        ({"altitude_m": math.nan}, "altitude_m"),
    ],
)
def test_wrong_options_are_named(how: dict[str, Any], stated: str) -> None:
    with pytest.raises(SurveyError, match=stated):
        ExportOptions(**how)
