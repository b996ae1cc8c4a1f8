"""Voxels as an ASPRS LAS 1.4 cloud, plain or packed as LAZ: survey offices read it."""

import math
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from mapperd.errors import ExportError
from mapperd.geodesy import Origin
from mapperd.mapping import Voxels
from mapperd.projection import utm_zone

__all__ = ["MISSING", "STEP_M", "write_las"]

MISSING = "laspy, or its lazrs, cannot be imported (pip install 'mapperd[las]')"

STEP_M = 0.0001
"""Coordinates are whole numbers of these."""

MOST_STEPS = 2**31 - 1

POINT_FORMAT = 6
"""The plainest of version 1.4, which knows well-known text."""

INTENSITY_AT_1 = 65535

Floats = NDArray[np.float64]


def write_las(file: BinaryIO, voxels: Voxels, origin: Origin | None, *, packed: bool) -> None:
    """Write voxel centres with `intensity` (the probability, 65535 is 1), probability and count.

    Args:
        file: where to.
        voxels: occupied ones.
        origin: with it the coordinates are those of its UTM zone and the file says so; without,
            the map's, and the file names no system. Heights are the map's z either way.
        packed: as LAZ.

    Raises:
        ExportError: the library is not there, or the map is too wide for the format.
    """
    try:
        import laspy  # noqa: PLC0415 an extra
    except ImportError:
        raise ExportError(MISSING) from None
    backend = laspy.LazBackend.Lazrs  # one thread: the other cores map
    if packed and not backend.is_available():
        raise ExportError(MISSING)
    header = laspy.LasHeader(version="1.4", point_format=POINT_FORMAT)
    header.generating_software = "mapperd"
    header.add_extra_dims(
        [laspy.ExtraBytesParams("probability", "float32"), laspy.ExtraBytesParams("count", "u2")]
    )
    centres_m = voxels.centres_m
    if origin is not None:
        zone = utm_zone(origin)
        east_m, north_m = zone.project(*origin.places(centres_m))
        centres_m = np.stack([east_m, north_m, centres_m[:, 2]], axis=1)
        header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(zone.wkt))
    header.global_encoding.wkt = True
    header.scales = np.full(3, STEP_M)
    header.offsets = _middle(centres_m)
    points = laspy.ScaleAwarePointRecord.zeros(len(voxels), header=header)
    points.x, points.y, points.z = centres_m.T
    points.intensity = np.rint(voxels.probability * INTENSITY_AT_1)
    points.return_number[:] = points.number_of_returns[:] = 1
    points.probability = voxels.probability
    points.count = voxels.count
    with laspy.open(
        file, mode="w", header=header, do_compress=packed, laz_backend=backend, closefd=False
    ) as writer:
        writer.write_points(points)


def _middle(centres_m: Floats) -> Floats:
    """Whole metres in the middle of all points.

    Raises:
        ExportError: some are too far from it.
    """
    if not len(centres_m):
        return np.zeros(3)
    low, high = centres_m.min(axis=0), centres_m.max(axis=0)
    middle_m = np.floor((low + high) / 2)
    if (high - middle_m).max() > MOST_STEPS * STEP_M:
        side_km = math.floor(2 * MOST_STEPS * STEP_M / 1000)
        raise ExportError(f"the map is too wide for LAS: at most {side_km} km")
    return np.asarray(middle_m)
