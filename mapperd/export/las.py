"""Voxels as an ASPRS LAS 1.4 cloud, plain or packed as LAZ: survey offices read it."""

import contextlib
import itertools
import math
from collections.abc import Callable, Iterator
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from mapperd.errors import ExportError, ExportExtraError, missing_extra
from mapperd.geometry.geodesy import Origin, utm_zone
from mapperd.mapping.queries import VoxelCloud
from mapperd.mapping.sonar_map import Voxels

__all__ = ["STEP_M", "las_cloud", "write_las"]

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
    laspy = _library(packed=packed)
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


def _library(*, packed: bool) -> Any:  # noqa: ANN401 it has no types
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
