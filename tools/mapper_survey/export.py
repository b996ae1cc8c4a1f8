"""Products of a survey: a grid of depths, a cloud and soundings, in one pass over the map."""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from mapper_survey.errors import SurveyError
from mapper_survey.surface import CELL_VOXELS, RULES, Rule, SurfaceCells, surface_of
from mapper_survey.windows import WINDOW_BRICKS, ColumnWindow, Tiling, WindowedMap, tiling_of
from mapperd.config.tree import Config
from mapperd.export.cells import Heights
from mapperd.export.clouds import write_points
from mapperd.export.geotiff import NO_DATA, GridPlace, RasterBand, las_cloud, write_tiles
from mapperd.geometry.geodesy import Origin, local_projection, utm_zone
from mapperd.io import atomic_file, make_folder
from mapperd.mapping.sonar_map import SonarMap, Voxels
from mapperd.store.reader import BRICK_VOXELS

__all__ = [
    "PRODUCTS",
    "ExportOptions",
    "Exported",
    "Progress",
    "check_products",
    "crs_of",
    "export_survey",
    "grid_place",
]


PRODUCTS = {
    "grid": "depth.tif",
    "cloud": "cloud.laz",
    "soundings": "soundings.xyz",
    "positions": "positions.xyz",
}
"""Names of products, and their files."""


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """Options of the products.

    Attributes:
        config: its thresholds decide what is occupied; None uses the defaults.
        cell_voxels: columns of voxels along the edge of a grid's cell.
        rule: how a cell's depth is chosen.
        vertical_uncertainty_m: standard deviation of heights due to navigation and tide.
        altitude_m: height of the map's origin above the datum of depths.
        heights: range of z of the voxels that count, map frame.
        window_bricks: bricks along the edge of the window in memory.
        accuracy: horizontal standard deviation of the poses of each dive, for people: metadata of
            the grid.

    Raises:
        SurveyError: a number is not allowed.
    """

    config: Config | None = None
    cell_voxels: int = 1
    rule: Rule = "shoalest"
    vertical_uncertainty_m: float = 0.0
    altitude_m: float = 0.0
    heights: Heights = field(default_factory=Heights)
    window_bricks: int = WINDOW_BRICKS
    accuracy: Sequence[str] = ()

    def __post_init__(self) -> None:
        allowed = ", ".join(map(str, CELL_VOXELS))
        if self.cell_voxels not in CELL_VOXELS:
            raise SurveyError(f"cell_voxels: {self.cell_voxels} is not allowed; allowed: {allowed}")
        if self.rule not in RULES:
            raise SurveyError(f"rule: {self.rule!r} is not a rule; allowed: {', '.join(RULES)}")
        if not (math.isfinite(self.altitude_m) and 0 <= self.vertical_uncertainty_m < math.inf):
            raise SurveyError(
                "altitude_m must be a number, and vertical_uncertainty_m one from 0 on"
            )


def check_products(products: Sequence[str], *, known: bool) -> None:
    """Check that the products can be made.

    Args:
        products: by their names.
        known: whether the origin of the map on Earth is known.

    Raises:
        SurveyError: an unknown product, or one that needs an origin.
    """
    unknown = [product for product in products if product not in PRODUCTS]
    if unknown or not products:
        asked = ", ".join(unknown) or "nothing"
        raise SurveyError(f"no such product: {asked}; allowed: {', '.join(PRODUCTS)}")
    if "positions" in products and not known:
        raise SurveyError("positions need an origin: the place of the map's zero on Earth")


def crs_of(product: str, origin: Origin | None) -> str:
    """Return the coordinate system of a product's file, for people."""
    if origin is None:
        return "none: the geographic position of the map is unknown"
    if product == "grid":
        return local_projection(origin).name
    if product == "positions":
        return "WGS 84, EPSG:4326, longitude first"
    zone = utm_zone(origin)
    return f"{zone.name}, EPSG:{zone.epsg}"


HORIZONTAL = "HORIZONTAL_STANDARD_DEVIATION"
"""Metadata of the grid: root of the sum of the variances of x and y, of the poses of each dive."""

DEPTH_DIGITS, METRE_DIGITS, DEGREE_DIGITS = 3, 3, 9
"""Digits after the point; a billionth of a degree is 0.1 mm."""

Floats = NDArray[np.float64]
Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class Exported:
    """Result of an export.

    Attributes:
        files: files by product.
        crs: coordinate system of each file, for people.
        voxels: number of occupied voxels.
        cells: number of grid cells with a surface.
    """

    files: dict[str, Path]
    crs: dict[str, str]
    voxels: int
    cells: int


def export_survey(
    store_path: Path,
    out_dir: Path,
    products: Sequence[str] = tuple(PRODUCTS),
    origin: Origin | None = None,
    progress: Progress = lambda _done, _all: None,
    *,
    options: ExportOptions | None = None,
) -> Exported:
    """Write products of a map, each atomically; one window of it is in memory at a time.

    Args:
        store_path: the map's file.
        out_dir: created if missing.
        products: some of `PRODUCTS`; `positions` only with an origin.
        origin: geographic position of the map's origin; None if unknown.
        progress: receives the numbers of finished and of all windows.
        options: None uses the defaults.

    Raises:
        SurveyError: an unknown product, one that needs an origin, or a map without a surface.
        StoreError: the map cannot be read, or bricks of it are damaged.
        ExportError: a file cannot be written, or a library is missing.
    """
    check_products(products, known=origin is not None)
    files = {product: out_dir / PRODUCTS[product] for product in products}
    with WindowedMap(store_path, (options or ExportOptions()).config) as stored:
        if not len(stored.keys):
            raise SurveyError(f"{store_path}: the map is empty: there is nothing to export")
        make_folder(out_dir)
        with ExitStack() as opening:
            open_files = {
                product: opening.enter_context(atomic_file(path)) for product, path in files.items()
            }
            written = _Export(stored, open_files, origin, progress, options or ExportOptions())
            written.write()
            if not written.cells:
                raise SurveyError(f"{store_path}: no voxel of it is occupied: nothing to export")
    crs = {product: crs_of(product, origin) for product in products}
    return Exported(files, crs, written.voxels, written.cells)


class _Export:
    """One pass over the map for all files.

    Attributes:
        voxels, cells: as in `Exported`.
    """

    def __init__(
        self,
        stored: WindowedMap,
        files: dict[str, BinaryIO],
        origin: Origin | None,
        progress: Progress,
        options: ExportOptions,
    ) -> None:
        self._stored = stored
        self._files = files
        self._origin = origin
        self._progress = progress
        self._options = options
        self._tiling = tiling_of(stored.keys, options.window_bricks)
        self._cell_m = stored.resolution_m * options.cell_voxels
        self._add: Callable[[Voxels], None] = lambda _: None
        self.voxels = self.cells = 0

    def write(self) -> None:
        """All files."""
        with ExitStack() as opening:
            if cloud := self._files.get("cloud"):
                box_m = _box_of(self._stored)
                height_m = self._options.altitude_m
                self._add = opening.enter_context(
                    las_cloud(cloud, box_m, self._origin, packed=True, height_m=height_m)
                )
            tiles = self._tiles()
            if grid := self._files.get("grid"):
                place = grid_place(
                    self._tiling, self._stored.resolution_m, self._options.cell_voxels
                )
                edge = self._tiling.edge // self._options.cell_voxels
                accuracy = "; ".join(self._options.accuracy)
                notes = {HORIZONTAL: accuracy} if accuracy else None
                bands = self._bands()
                write_tiles(grid, tiles, place, bands, self._origin, edge=edge, notes=notes)
            for _ in tiles:
                pass

    def _tiles(self) -> Iterator[NDArray[np.float32] | None]:
        total = self._tiling.columns * self._tiling.rows
        for number, window in enumerate(self._tiling, 1):
            part = self._stored.columns(window)
            tile = None if part is None else self._tile(part, window)
            self._progress(number, total)
            yield tile

    def _tile(self, part: SonarMap, window: ColumnWindow) -> NDArray[np.float32] | None:
        options = self._options
        voxels = _within(part.voxels("occupied"), options.heights)
        surface = surface_of(
            voxels,
            part.resolution_m,
            window,
            options.cell_voxels,
            rule=options.rule,
            vertical_uncertainty_m=options.vertical_uncertainty_m,
        )
        if not len(surface.row):
            return None
        self.voxels += len(voxels)
        self.cells += len(surface.row)
        self._add(voxels)
        self._write_soundings(surface, window)
        edge = window.edge // options.cell_voxels
        tile = np.full((edge, edge, 3), NO_DATA, dtype=np.float32)
        depth_m = -(surface.z_m + options.altitude_m)
        tile[surface.row, surface.column] = np.column_stack(
            [depth_m, surface.uncertainty_m, surface.count]
        )
        return tile

    def _write_soundings(self, surface: SurfaceCells, window: ColumnWindow) -> None:
        cells = window.edge // self._options.cell_voxels
        west_m = window.x * self._stored.resolution_m
        south_m = window.y * self._stored.resolution_m
        x_m = west_m + (surface.column + 0.5) * self._cell_m
        y_m = south_m + (cells - surface.row - 0.5) * self._cell_m
        depth_m = -(surface.z_m + self._options.altitude_m)
        places = np.column_stack([x_m, y_m, surface.z_m])
        if soundings := self._files.get("soundings"):
            east_m, north_m = _plane(self._origin, places)
            digits = (METRE_DIGITS, METRE_DIGITS, DEPTH_DIGITS)
            write_points(soundings, np.column_stack([east_m, north_m, depth_m]), digits)
        positions = self._files.get("positions")
        if positions and self._origin is not None:
            latitude, longitude = np.degrees(self._origin.places(places))
            digits = (DEGREE_DIGITS, DEGREE_DIGITS, DEPTH_DIGITS)
            write_points(positions, np.column_stack([longitude, latitude, depth_m]), digits)

    def _bands(self) -> tuple[RasterBand, ...]:
        options = self._options
        return (
            RasterBand(f"depth, positive down, of the {options.rule} voxel of the surface", "m"),
            RasterBand("uncertainty of the depth, one standard deviation", "m"),
            RasterBand("pings that observed the cell's best seen voxel"),
        )


def _within(voxels: Voxels, heights: Heights) -> Voxels:
    z_m = voxels.centres_m[:, 2]
    kept = (z_m >= heights.min_m) & (z_m <= heights.max_m)
    return Voxels(voxels.centres_m[kept], voxels.probability[kept], voxels.count[kept])


def _plane(origin: Origin | None, places_m: Floats) -> tuple[Floats, Floats]:
    """Return east and north of positions, in the projection of the cloud."""
    if origin is None:
        return places_m[:, 0], places_m[:, 1]
    return utm_zone(origin).project(*origin.places(places_m))


def _box_of(stored: WindowedMap) -> Floats:
    """(2, 3) corners of all bricks."""
    edge_m = stored.resolution_m * BRICK_VOXELS
    return np.stack([stored.keys.min(axis=0), stored.keys.max(axis=0) + 1]) * edge_m


def grid_place(tiling: Tiling, resolution_m: float, cell_voxels: int) -> GridPlace:
    """Return the position of a tiling's grid."""
    across = tiling.edge // cell_voxels
    return GridPlace(
        tiling.x * resolution_m,
        tiling.north * resolution_m,
        resolution_m * cell_voxels,
        across * tiling.columns,
        across * tiling.rows,
    )
