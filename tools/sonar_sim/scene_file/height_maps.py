"""Floors of measured heights: tables, and GeoTIFF."""

import math
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from oculus_driver.errors import missing_extra
from sonar_sim.errors import SceneError
from sonar_sim.scene.vehicle import metres_per_degree
from sonar_sim.scene_file import schema

Floats = NDArray[np.float64]
HeightOf = Callable[[Floats, Floats], Floats]
"""Height of the floor, z up, at x and y; NaN where there is none."""
GEOTIFF = {".tif", ".tiff"}


def measured_height(
    field: schema.HeightField, terrain: schema.TerrainSection, folder: Path
) -> HeightOf:
    """The height between the points of a file.

    Args:
        field: the height field's section of the scene's file.
        terrain: the terrain's section, whose spans a table fills.
        folder: where its files are.

    Raises:
        SceneError: the file is missing or of another format, or has too few points.
    """
    path = folder / field.file
    if path.suffix.lower() in GEOTIFF:
        y_m, x_m, heights = _geotiff(path, field.origin)
        beyond: float | None = math.nan
    else:
        if field.origin is not None:
            raise SceneError(f"{path}: only a GeoTIFF has an origin")
        heights = _table(path)
        y_m, x_m = (
            np.linspace(*span, count)
            for span, count in zip((terrain.y_m, terrain.x_m), heights.shape, strict=True)
        )
        beyond = None  # the last cells go on
    heights_m = heights * field.scale + field.offset_m
    between = RegularGridInterpolator((y_m, x_m), heights_m, bounds_error=False, fill_value=beyond)
    return lambda x_m, y_m: np.asarray(between((y_m, x_m)), dtype=np.float64)


def _table(path: Path) -> Floats:
    try:
        if path.suffix == ".npy":
            table = np.load(path, allow_pickle=False)
        elif path.suffix == ".csv":
            with warnings.catch_warnings(action="error"):  # an empty file is no table
                table = np.loadtxt(path, delimiter=",", ndmin=2)
        else:
            raise SceneError(f"{path}: heights are read from .npy, .csv, .tif and .tiff")
        heights = np.asarray(table, dtype=np.float64)
    except (OSError, ValueError, TypeError, EOFError, UserWarning) as error:
        raise SceneError(f"{path}: no table of heights: {error}") from error
    if heights.ndim != 2 or min(heights.shape) < 2 or not np.isfinite(heights).all():  # noqa: PLR2004 a table
        raise SceneError(f"{path}: heights must be a table of at least 2 x 2 finite numbers")
    return heights


MAX_POINTS = 50_000_000


def _geotiff(path: Path, origin: tuple[float, float] | None) -> tuple[Floats, Floats, Floats]:
    """Read the first band of a GeoTIFF.

    Returns:
        y and x of its cells' centres in the map, both rising, (M,) and (N,), and their values,
        (M, N), NaN where there are none.
    """
    if not path.is_file():
        raise SceneError(f"{path}: there is no such file")
    try:
        import rasterio  # noqa: PLC0415 of the extra `worlds`
        from rasterio.errors import NotGeoreferencedWarning, RasterioError  # noqa: PLC0415
    except ModuleNotFoundError as error:
        raise SceneError(f"{path}: {missing_extra('rasterio', 'worlds')}") from error
    try:
        with (
            warnings.catch_warnings(action="ignore", category=NotGeoreferencedWarning),
            rasterio.open(path, driver="GTiff") as raster,  # other formats name further files
        ):
            if raster.width * raster.height > MAX_POINTS:
                raise SceneError(
                    f"{path}: {raster.width} x {raster.height} points; cut it or coarsen it first"
                )
            place, geographic = (
                raster.transform,
                raster.crs is not None and raster.crs.is_geographic,
            )
            is_projected = raster.crs is not None and raster.crs.is_projected
            unit_m = raster.crs.linear_units_factor[1] if is_projected else 1.0
            values = raster.read(1, masked=True).astype(np.float64).filled(np.nan)
            values = values * raster.scales[0] + raster.offsets[0]
    except RasterioError as error:
        raise SceneError(f"{path}: not a GeoTIFF: {error}") from error
    if place.is_identity:
        raise SceneError(
            f"{path}: it does not say where it lies: georeference it, or save it as .npy"
        )
    values[~np.isfinite(values)] = np.nan
    rows, columns = values.shape
    if min(rows, columns) < 2 or np.isnan(values).all():  # noqa: PLR2004 a table
        raise SceneError(f"{path}: heights must be a table of at least 2 x 2 numbers")
    if place.b or place.d or place.a <= 0.0 or place.e == 0.0:
        raise SceneError(f"{path}: its rows do not run east: warp it to north up first")
    east = place.c + (np.arange(columns) + 0.5) * place.a
    north = place.f + (np.arange(rows) + 0.5) * place.e
    east_0, north_0 = origin or (float(east.mean()), float(north.mean()))
    if geographic:
        per_north_m, per_east_m = metres_per_degree(north_0)
        east, north = (east - east_0) * per_east_m, (north - north_0) * per_north_m
    else:
        east, north = (east - east_0) * unit_m, (north - north_0) * unit_m
    if place.e < 0.0:  # north up, as nearly all
        north, values = north[::-1], values[::-1]
    return north, east, values
