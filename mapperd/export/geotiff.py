"""The top of the map as a GeoTIFF of two bands: height and how often it was seen."""

from typing import Any, BinaryIO

import numpy as np

from mapperd.errors import ExportError
from mapperd.export.cells import Tops
from mapperd.geodesy import Origin
from mapperd.projection import TransverseMercator, local_projection

__all__ = ["MISSING", "NO_DATA", "write_geotiff"]

MISSING = "tifffile cannot be imported (pip install 'mapperd[geo]')"

NO_DATA = -9999.0

ASCII, SHORT, DOUBLE = 2, 3, 12
"""Types of TIFF."""

PIXEL_SCALE, TIE_POINT, GEO_KEYS, GEO_DOUBLES, GEO_TEXTS = 33550, 33922, 34735, 34736, 34737
GDAL_METADATA, GDAL_NODATA = 42112, 42113
"""Numbers of tags; those of GDAL are what GIS programs know missing cells and bands' names by."""

BANDS = "<GDALMetadata>{}</GDALMetadata>".format(
    "".join(
        f'<Item name="{key}" sample="{band}" role="{role}">{text}</Item>'
        for band, key, role, text in (
            (0, "DESCRIPTION", "description", "height of the highest occupied voxel's centre"),
            (0, "UNITTYPE", "unittype", "m"),
            (1, "DESCRIPTION", "description", "pings that told something about that voxel"),
        )
    )
)


def write_geotiff(
    file: BinaryIO, tops: Tops | None, resolution_m: float, origin: Origin | None
) -> None:
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
    try:
        import tifffile  # noqa: PLC0415 an extra
    except ImportError:
        raise ExportError(MISSING) from None
    if tops is None:
        raise ExportError("no occupied voxel: there is no surface to write")
    window, known = tops.window, tops.rows >= 0
    values = np.full((2, *known.shape), NO_DATA, dtype=np.float32)
    values[0][known] = tops.voxels.centres_m[tops.rows[known], 2]
    values[1][known] = tops.voxels.count[tops.rows[known]]
    west_m, north_m = window.x * resolution_m, (window.y + window.height) * resolution_m
    tags = [
        (PIXEL_SCALE, DOUBLE, 3, (resolution_m, resolution_m, 0.0), True),
        (TIE_POINT, DOUBLE, 6, (0.0, 0.0, 0.0, west_m, north_m, 0.0), True),
        _text(GDAL_METADATA, BANDS),
        _text(GDAL_NODATA, f"{NO_DATA:g}"),
    ]
    if origin is not None:
        tags += _geo_tags(local_projection(origin))
    tifffile.imwrite(
        file,
        values[:, ::-1],
        bigtiff=False,
        photometric="minisblack",
        planarconfig="separate",
        compression="zlib",
        predictor=False,
        metadata=None,
        software="mapperd",
        extratags=tags,
    )


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
