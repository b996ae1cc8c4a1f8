"""Files of survey offices: grids as GeoTIFF, voxels as ASPRS LAS 1.4 clouds, plain or LAZ."""

import contextlib
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, BinaryIO
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from mapperd.errors import ExportError, ExportExtraError, missing_extra
from mapperd.export.cells import NO_TOP, Tops
from mapperd.geometry.geodesy import Origin, TransverseMercator, local_projection, utm_zone
from mapperd.mapping.queries import VoxelCloud
from mapperd.mapping.sonar_map import Voxels

__all__ = [
    "NO_DATA",
    "STEP_M",
    "GridPlace",
    "RasterBand",
    "las_cloud",
    "write_geotiff",
    "write_las",
    "write_tiles",
]

NO_DATA = -9999.0

ASCII, SHORT, DOUBLE = 2, 3, 12
"""Types of TIFF."""

PIXEL_SCALE, TIE_POINT, GEO_KEYS, GEO_DOUBLES, GEO_TEXTS = 33550, 33922, 34735, 34736, 34737
GDAL_METADATA, GDAL_NODATA = 42112, 42113
"""Numbers of tags; those of GDAL are what GIS programs know missing cells and bands' names by."""

HOW = {
    "photometric": "minisblack",
    "compression": "zlib",
    "predictor": False,
    "metadata": None,
    "software": "mapperd",
}
"""What all our files have of TIFF."""

TILE_CELLS = 256
"""Cells along an edge of a tile of a map's grid."""

MAX_BYTES = 4_000_000_000
"""Of cells in a plain TIFF, packed or not: places in it have 32 bits."""

Floats32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class RasterBand:
    """One number a cell.

    Attributes:
        description: in ASCII, without the signs that XML keeps for itself.
        unit: of it; empty for a plain number.
    """

    description: str
    unit: str = ""


@dataclass(frozen=True, slots=True)
class GridPlace:
    """Where a grid lies in the map's frame: metres of its edges, and its size in cells."""

    west_m: float
    north_m: float
    cell_m: float
    width: int
    height: int


TOPS = (
    RasterBand("height of the highest occupied voxel's centre", "m"),
    RasterBand("pings that observed that voxel"),
)


def write_geotiff(file: BinaryIO, tops: Tops, resolution_m: float, origin: Origin | None) -> None:
    """Write float32 heights (z up, metres, not depths) and counts, north on top.

    The cells are columns of voxels, the same as those of `.asc`.

    Args:
        file: where to.
        tops: highest occupied voxels.
        resolution_m: edge of a cell.
        origin: with it the file has a projection whose zero it is; without, none.

    Raises:
        ExportError: the library is not there, or there is nothing to write.
    """
    window = tops.window
    if window is None:
        raise ExportError("no occupied voxel: there is no surface to write")
    place = GridPlace(
        window.x * resolution_m,
        (window.y + window.height) * resolution_m,
        resolution_m,
        window.width,
        window.height,
    )
    write_tiles(file, _tiles(tops, resolution_m), place, TOPS, origin, edge=TILE_CELLS)


def _tiles(tops: Tops, resolution_m: float) -> Iterator[Floats32 | None]:
    """Yield tiles (edge, edge, 2) of heights and counts as `write_tiles` takes them."""
    for strip in tops.strips(TILE_CELLS):
        height, width = strip.z.shape
        for row, column in itertools.product(
            range(0, height, TILE_CELLS), range(0, width, TILE_CELLS)
        ):
            at = slice(row, row + TILE_CELLS), slice(column, column + TILE_CELLS)
            z, count = strip.z[at], strip.count[at]
            known = z != NO_TOP
            tile = np.full((TILE_CELLS, TILE_CELLS, len(TOPS)), NO_DATA, dtype=np.float32)
            inside = tile[: z.shape[0], : z.shape[1]]
            inside[known, 0] = (z[known] + 0.5) * resolution_m
            inside[known, 1] = count[known]
            yield tile if known.any() else None


def write_tiles(
    file: BinaryIO,
    tiles: Iterator[Floats32 | None],
    place: GridPlace,
    bands: Sequence[RasterBand],
    origin: Origin | None,
    *,
    edge: int,
    notes: Mapping[str, str] | None = None,
) -> None:
    """Write a grid of any size, a tile in memory at a time.

    Args:
        file: where to; it can seek.
        tiles: (edge, edge, bands) float32 each, row 0 in the north, `NO_DATA` where nothing is
            known; those of the northernmost row first, from west to east. None where a tile holds
            nothing: it takes no room in the file. What lies beyond the grid's edges is left out.
        place: of the whole grid.
        bands: what the numbers are.
        origin: with it the file has a projection whose zero it is; without, none.
        edge: of a tile in cells, a multiple of 16.
        notes: metadata of the whole file, by name.

    Raises:
        ExportError: the library is not there.
    """
    empty = np.full((edge, edge, len(bands)), NO_DATA, dtype=np.float32)
    _library()(
        file,
        _with_a_first(tiles, empty),
        shape=(place.height, place.width, len(bands)),
        dtype=np.float32,
        tile=(edge, edge),
        bigtiff=place.height * place.width * len(bands) * 4 > MAX_BYTES,
        planarconfig="contig",
        maxworkers=1,  # else it asks for tiles that wait for others to be packed
        **HOW,
        extratags=_tags(place, bands, origin, notes or {}),
    )


def _with_a_first(tiles: Iterator[Floats32 | None], empty: Floats32) -> Iterator[Floats32 | None]:
    """The library derives the tile type from the first tile, which is never None."""
    for first in tiles:
        yield empty if first is None else first
        yield from tiles


def _library() -> Callable[..., object]:
    try:
        import tifffile  # noqa: PLC0415 an extra
    except ImportError:
        raise ExportExtraError(missing_extra("tifffile", "geo")) from None
    write: Callable[..., object] = tifffile.imwrite
    return write


def _tags(
    place: GridPlace, bands: Sequence[RasterBand], origin: Origin | None, notes: Mapping[str, str]
) -> list[Any]:
    items = "".join(f'<Item name="{escape(k)}">{escape(v)}</Item>' for k, v in notes.items())
    items += "".join(
        f'<Item name="{key}" sample="{number}" role="{role}">{text}</Item>'
        for number, band in enumerate(bands)
        for key, role, text in (
            ("DESCRIPTION", "description", band.description),
            ("UNITTYPE", "unittype", band.unit),
        )
        if text
    )
    tags = [
        (PIXEL_SCALE, DOUBLE, 3, (place.cell_m, place.cell_m, 0.0), True),
        (TIE_POINT, DOUBLE, 6, (0.0, 0.0, 0.0, place.west_m, place.north_m, 0.0), True),
        _text(GDAL_METADATA, f"<GDALMetadata>{items}</GDALMetadata>"),
        _text(GDAL_NODATA, f"{NO_DATA:g}"),
    ]
    return tags if origin is None else tags + _geo_tags(local_projection(origin))


def _geo_tags(projection: TransverseMercator) -> list[Any]:
    """A projection of our own, by the keys of OGC GeoTIFF 1.1."""
    name = f"{projection.name}|"
    doubles = (
        projection.longitude_deg,
        projection.latitude_deg,
        projection.east_m,
        projection.north_m,
        projection.scale,
    )
    keys = [
        (1024, 0, 1, 1),  # model: projected
        (1025, 0, 1, 1),  # a pixel is an area
        (2048, 0, 1, 4326),  # WGS 84
        (2054, 0, 1, 9102),  # degrees
        (3072, 0, 1, 32767),  # a projected system that has no code
        (3073, GEO_TEXTS, len(name), 0),
        (3074, 0, 1, 32767),
        (3075, 0, 1, 1),  # transverse Mercator
        (3076, 0, 1, 9001),  # metres
        *((key, GEO_DOUBLES, 1, at) for at, key in enumerate((3080, 3081, 3082, 3083, 3092))),
    ]
    directory = [1, 1, 0, len(keys), *(number for key in keys for number in key)]
    return [
        (GEO_KEYS, SHORT, len(directory), directory, True),
        (GEO_DOUBLES, DOUBLE, len(doubles), doubles, True),
        _text(GEO_TEXTS, name),
    ]


def _text(tag: int, text: str) -> tuple[int, int, int, bytes, bool]:
    data = text.encode("ascii") + b"\0"
    return tag, ASCII, len(data), data, True


STEP_M = 0.0001
"""Coordinates are whole numbers of these."""

MAX_STEPS = 2**31 - 1

POINT_FORMAT = 6
"""The plainest of version 1.4, which knows well-known text."""

INTENSITY_AT_1 = 65535

Floats = NDArray[np.float64]


def write_las(file: BinaryIO, voxels: VoxelCloud, origin: Origin | None, *, packed: bool) -> None:
    """Write voxel centres with `intensity` (the probability, 65535 is 1), probability and count.

    Args:
        file: where to.
        voxels: occupied ones.
        origin: with it the coordinates are in its UTM zone and the file names it; without,
            the map's, and the file names no system. Heights are the map's z either way.
        packed: as LAZ.

    Raises:
        ExportError: the library is not there, or the map is too wide for the format.
    """
    with las_cloud(file, voxels.box_m, origin, packed=packed) as add:
        for some in voxels.batches():
            add(some)


@contextlib.contextmanager
def las_cloud(
    file: BinaryIO, box_m: Floats, origin: Origin | None, *, packed: bool, height_m: float = 0.0
) -> Iterator[Callable[[Voxels], None]]:
    """Begin such a file and give what adds voxels to it, a part in memory at a time.

    Args:
        file: where to; it can seek.
        box_m: (2, 3) lowest and highest corner of all voxels' centres, map frame.
        origin: as of `write_las`.
        packed: as of `write_las`.
        height_m: of the map's zero; z in the file is so much higher than in the map.

    Raises:
        ExportError: the library is not there, or the map is too wide for the format.
    """
    laspy = _las_library(packed=packed)
    header = laspy.LasHeader(version="1.4", point_format=POINT_FORMAT)
    header.generating_software = "mapperd"
    header.add_extra_dims(
        [laspy.ExtraBytesParams("probability", "float32"), laspy.ExtraBytesParams("count", "u2")]
    )
    zone = None if origin is None else utm_zone(origin)
    if zone is not None:
        header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(zone.wkt))
    header.global_encoding.wkt = True
    header.scales = np.full(3, STEP_M)

    def placed(centres_m: Floats) -> Floats:
        heights_m = centres_m[:, 2] + height_m
        if origin is None or zone is None:
            return np.column_stack([centres_m[:, :2], heights_m])
        east_m, north_m = zone.project(*origin.places(centres_m))
        return np.column_stack([east_m, north_m, heights_m])

    header.offsets = _middle(placed(_corners(box_m)))
    backend = laspy.LazBackend.Lazrs  # one thread: the other cores map
    with laspy.open(
        file, mode="w", header=header, do_compress=packed, laz_backend=backend, closefd=False
    ) as writer:

        def add(voxels: Voxels) -> None:
            points = laspy.ScaleAwarePointRecord.zeros(len(voxels), header=header)
            points.x, points.y, points.z = placed(voxels.centres_m).T
            points.intensity = np.rint(voxels.probability * INTENSITY_AT_1)
            points.return_number[:] = points.number_of_returns[:] = 1
            points.probability = voxels.probability
            points.count = voxels.count
            writer.write_points(points)

        yield add


def _las_library(*, packed: bool) -> Any:  # noqa: ANN401 it has no types
    try:
        import laspy  # noqa: PLC0415 an extra
    except ImportError:
        raise ExportExtraError(missing_extra("laspy", "las")) from None
    if packed and not laspy.LazBackend.Lazrs.is_available():
        raise ExportExtraError(missing_extra("lazrs", "las"))
    return laspy


def _corners(box_m: Floats) -> Floats:
    """All eight (8, 3): turned against the map, none of the first two need be an extreme."""
    return np.array(list(itertools.product(*box_m.T)))


def _middle(corners_m: Floats) -> Floats:
    """Whole metres in the middle of all points.

    Raises:
        ExportError: some are too far from it.
    """
    low, high = corners_m.min(axis=0), corners_m.max(axis=0)
    middle_m = np.floor((low + high) / 2)
    if (high - middle_m).max() > MAX_STEPS * STEP_M:
        side_km = math.floor(2 * MAX_STEPS * STEP_M / 1000)
        raise ExportError(f"the map is too wide for LAS: at most {side_km} km")
    return np.asarray(middle_m)
