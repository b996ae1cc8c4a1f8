from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from sonar_sim.errors import SceneError
from sonar_sim.scene.scenario import Scenario
from sonar_sim.scene_file import schema
from sonar_sim.scene_file.shapes import floor_of, height_of

Load = Callable[..., Scenario]
GRID = np.meshgrid(np.linspace(0.0, 200.0, 401), np.linspace(0.0, 200.0, 401), indexing="ij")


def terrain(relief: schema.Flat | schema.Procedural | schema.HeightField) -> schema.TerrainSection:
    return schema.TerrainSection(relief=relief, x_m=(-4.0, 4.0), y_m=(-3.0, 3.0), cell_m=0.5)


def rugged(seed: int, **others: float) -> np.ndarray:
    relief = schema.Procedural(depth_m=10.0, relief_m=0.5, seed=seed, **others)  # type: ignore[arg-type]
    return height_of(terrain(relief), Path())(*GRID)


def test_procedural_floor_has_its_relief_and_is_its_seeds() -> None:
    one, again, other = rugged(1), rugged(1), rugged(2)
    assert np.array_equal(one, again)
    assert np.abs(one - other).max() > 0.5
    assert one.mean() == pytest.approx(-10.0, abs=0.1)
    assert one.std() == pytest.approx(0.5, rel=0.1)


def test_waves_are_no_shorter_than_asked_for() -> None:
    height = rugged(1, longest_m=20.0, shortest_m=4.0)
    spectrum = np.abs(np.fft.rfft(height[:, 100] * np.hanning(401)))
    per_m = np.fft.rfftfreq(401, 0.5)
    assert spectrum[per_m > 0.3].max() < 1e-2 * spectrum[1:].max()


@pytest.mark.parametrize("shortest_m", [1e-300, 5e-324, 0.0048])
def test_waves_of_no_length_are_refused(shortest_m: float) -> None:
    with pytest.raises(SceneError, match=r"shortest_m .*0\.00488281 m"):
        rugged(1, longest_m=20.0, shortest_m=shortest_m)
    assert np.isfinite(rugged(1, longest_m=20.0, shortest_m=0.005)).all()


def test_slope_and_ripples_come_on_top() -> None:
    ripples = schema.Ripples(height_m=0.1, length_m=2.0, direction_deg=90.0)
    relief = schema.Procedural(depth_m=10.0, relief_m=0.0, slope=(0.1, 0.0), ripples=ripples)
    height = height_of(terrain(relief), Path())(*GRID)
    assert height[:, 0] == pytest.approx(-10.0 + 0.1 * GRID[0][:, 0])
    assert np.ptp(height[0]) == pytest.approx(0.1, rel=1e-3)
    assert height[0, 4] == pytest.approx(height[0, 8])  # 2 m on along y


def test_floor_fills_its_spans_with_its_cells(load: Load, flat: str) -> None:
    floor = load(flat).scene.surfaces[0]
    assert floor.name == "floor"
    assert floor.vertices_m.min(axis=0).tolist() == [-4.0, -3.0, -5.0]
    assert floor.vertices_m.max(axis=0).tolist() == [4.0, 3.0, -5.0]
    assert len(floor.faces) == 16 * 12 * 2


@pytest.mark.parametrize("ending", ["npy", "csv"])
def test_height_field_is_read_rows_north(tmp_path: Path, ending: str) -> None:
    table = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])  # rows along y, columns along x
    path = tmp_path / f"heights.{ending}"
    if ending == "npy":
        np.save(path, table)
    else:
        np.savetxt(path, table, delimiter=",")
    field = schema.HeightField(file=path.name, scale=0.5, offset_m=-10.0)
    height_m = height_of(terrain(field), tmp_path)
    x_m, y_m = np.array([-4.0, 0.0, 4.0, 4.0, 2.0]), np.array([-3.0, -3.0, -3.0, 3.0, 0.0])
    assert height_m(x_m, y_m) == pytest.approx([-9.5, -9.0, -8.5, -7.0, -8.0])
    assert len(floor_of(terrain(field), height_m).faces) == 16 * 12 * 2


@pytest.mark.parametrize("content", [b"", b"1,2\n3", b"1,nan\n3,4\n", b"1,2,3\n", b"a,b\nc,d\n"])
def test_broken_height_field_is_refused_by_name(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "heights.csv").write_bytes(content)
    with pytest.raises(SceneError, match=r"heights\.csv"):
        height_of(terrain(schema.HeightField(file="heights.csv")), tmp_path)


@pytest.mark.parametrize("name", ["none.npy", "none.csv", "none.tif"])
def test_missing_height_field_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(SceneError, match=r"none\."):
        height_of(terrain(schema.HeightField(file=name)), tmp_path)


def test_terrain_without_area_or_with_too_many_cells_is_refused(load: Load) -> None:
    flat = "relief: {kind: flat, depth_m: 5}"
    with pytest.raises(SceneError, match=r"\$\.terrain: .*no length"):
        load(f"terrain: {{{flat}, x_m: [3, 3], y_m: [0, 1]}}")
    with pytest.raises(SceneError, match=r"\$\.terrain: .*too small"):
        load(f"terrain: {{{flat}, x_m: [0, 1000], y_m: [0, 1000], cell_m: 0.01}}")


def geotiff(
    path: Path, heights: np.ndarray, *, corner: tuple[float, float], **more: object
) -> None:
    """A north-up raster with cells of 2 x 1 units, written by hand: its corner is north-west."""
    tifffile = pytest.importorskip("tifffile")
    tags = [
        (33550, "d", 3, (2.0 * more.get("cell", 1.0), 1.0 * more.get("cell", 1.0), 0.0)),  # type: ignore[operator]
        (33922, "d", 6, (0.0, 0.0, 0.0, *corner, 0.0)),
        (34735, "H", 12, (1, 1, 0, 2, 1024, 0, 1, more.get("kind", 1), 1025, 0, 1, 1)),
        (42113, "s", 0, "-9999"),
    ]
    tifffile.imwrite(path, heights.astype(np.float32), extratags=tags, photometric="minisblack")


def test_geotiff_lies_about_its_origin_north_up(tmp_path: Path) -> None:
    rows, columns = np.indices((6, 5))
    heights = -10.0 - 1.0 * rows + 0.1 * columns
    geotiff(tmp_path / "bay.tif", heights, corner=(500_000.0, 6_000_000.0))
    field = schema.HeightField(file="bay.tif", origin=(500_005.0, 5_999_997.0), offset_m=1.0)
    height_m = height_of(terrain(field), tmp_path)
    # The origin lies in the middle of the 5 x 6 cells of 2 x 1 m.
    x_m, y_m = np.array([-4.0, 4.0, 0.0, 4.1]), np.array([2.5, -2.5, 0.0, 0.0])
    assert height_m(x_m, y_m)[:3] == pytest.approx([-9.0, -13.6, -11.3])
    assert np.isnan(height_m(x_m, y_m)[3]), "it ends at its last cells' middles"
    middle = height_of(terrain(schema.HeightField(file="bay.tif")), tmp_path)
    assert middle(x_m[:1], y_m[:1]) == pytest.approx([-10.0])


def test_geotiff_in_feet_is_laid_out_in_metres(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    depths = np.arange(16.0).reshape(1, 4, 4)
    place = rasterio.Affine(10.0, 0.0, 6e6, 0.0, -10.0, 2e6)
    form = {"driver": "GTiff", "count": 1, "height": 4, "width": 4, "dtype": "float32"}
    with rasterio.open(  # California's zone 3, in US survey feet
        tmp_path / "d.tif", "w", crs="EPSG:2227", transform=place, **form
    ) as raster:
        raster.write(depths.astype(np.float32))
    height_m = height_of(terrain(schema.HeightField(file="d.tif", scale=-1.0)), tmp_path)
    end_m = 15.0 * 1200.0 / 3937.0
    corners = height_m(np.array([-end_m, end_m]) * 0.9999, np.array([end_m, -end_m]) * 0.9999)
    assert corners == pytest.approx([0.0, -15.0], abs=5e-3)


def test_stored_numbers_of_a_geotiff_have_its_scale_and_offset(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    stored = np.arange(16, dtype=np.int16).reshape(1, 4, 4)
    form = {"driver": "GTiff", "count": 1, "height": 4, "width": 4, "dtype": "int16"}
    place = rasterio.Affine(1.0, 0.0, 500.0, 0.0, -1.0, 900.0)
    with rasterio.open(tmp_path / "d.tif", "w", transform=place, **form) as raster:
        raster.write(stored)
        raster.scales, raster.offsets = (0.01,), (-20.0,)
    height_m = height_of(terrain(schema.HeightField(file="d.tif")), tmp_path)
    assert height_m(np.array([-1.5]), np.array([1.5])) == pytest.approx([-20.0])
    assert height_m(np.array([1.5]), np.array([-1.5])) == pytest.approx([-19.85])


def test_a_raster_that_lies_nowhere_is_refused(tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    tifffile.imwrite(tmp_path / "d.tif", np.full((4, 4), -5.0, dtype=np.float32))
    with pytest.raises(SceneError, match=r"d\.tif: it does not say where it lies"):
        height_of(terrain(schema.HeightField(file="d.tif")), tmp_path)


def test_a_file_that_only_names_a_raster_is_refused(tmp_path: Path) -> None:
    geotiff(tmp_path / "real.tif", np.full((4, 4), -5.0), corner=(0.0, 0.0))
    (tmp_path / "d.tif").write_text(
        '<VRTDataset rasterXSize="4" rasterYSize="4"><GeoTransform>0, 2, 0, 0, 0, -1'
        '</GeoTransform><VRTRasterBand dataType="Float32" band="1"><SimpleSource>'
        '<SourceFilename relativeToVRT="1">real.tif</SourceFilename><SourceBand>1</SourceBand>'
        "</SimpleSource></VRTRasterBand>"
        "</VRTDataset>"
    )
    with pytest.raises(SceneError, match="not a GeoTIFF"):
        height_of(terrain(schema.HeightField(file="d.tif")), tmp_path)


def test_geotiff_of_depths_in_degrees_is_laid_out_in_metres(tmp_path: Path) -> None:
    depths = np.arange(16.0).reshape(4, 4)
    geotiff(tmp_path / "d.tif", depths, corner=(8.0, 60.0), kind=2, cell=1e-3)
    field = schema.HeightField(file="d.tif", scale=-1.0)
    height_m = height_of(terrain(field), tmp_path)
    # At 60° north a degree of longitude is 55 800 m long, one of latitude 111 412 m (WGS-84).
    x_m, y_m = 1.5 * 2e-3 * 55_800.0, 1.5e-3 * 111_412.0
    corners = height_m(np.array([-x_m, x_m]) * 0.9999, np.array([y_m, -y_m]) * 0.9999)
    assert corners == pytest.approx([0.0, -15.0], abs=2e-3)


def test_where_a_geotiff_has_no_data_is_no_floor(tmp_path: Path, load: Load) -> None:
    heights = np.full((8, 5), -5.0)
    heights[:, 0], heights[0, 1] = -9999.0, np.nan
    geotiff(tmp_path / "bay.tif", heights, corner=(0.0, 0.0))
    text = "terrain: {relief: {kind: height_field, file: bay.tif}, x_m: [-5, 5], y_m: [-4, 4]}"
    (floor,) = load(text).scene.surfaces
    assert np.isfinite(floor.vertices_m).all()
    low, high = floor.vertices_m.min(axis=0), floor.vertices_m.max(axis=0)
    assert [*low, *high] == pytest.approx([-2.0, -3.5, -5.0, 4.0, 3.5, -5.0], abs=0.26)
    with pytest.raises(SceneError, match="no data"):
        load(
            f"{text}\nobjects: [{{name: b, shape: {{kind: box, size_m: [1, 1, 1]}}, "
            "material: rock, position_m: [-4, 0, 0], on_floor: true}]"
        )
    with pytest.raises(SceneError, match=r"\$\.terrain: there are no heights"):
        load(text.replace("[-5, 5]", "[50, 60]"))


@pytest.mark.parametrize("content", [b"", b"II*\0garbage", b"\x89PNG"])
def test_broken_geotiff_is_refused_by_name(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "bay.tif").write_bytes(content)
    with pytest.raises(SceneError, match=r"bay\.tif: not a GeoTIFF"):
        height_of(terrain(schema.HeightField(file="bay.tif")), tmp_path)
