"""From a polar image and its bearings, without a sonar's message, to what the map wants to see."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd.config.tree import Sonar
from mapperd.errors import MapError
from mapperd.imaging.ping_image import Echo, beams_in_view, display_units

__all__ = ["echo_of_image", "uniform_bearings"]

DISPLAY_FULL_SCALE = 255.0
MAX_RANGE_M = 10_000.0


def uniform_bearings(beams: int, sonar: Sonar) -> NDArray[np.float64]:
    """Bearings uniform in sine over `sonar.horizontal_fov`, as the sonar spaces its beams.

    Returns:
        (beams,) float64 radians, increasing; positive to starboard.
    """
    edge = math.sin(math.radians(sonar.horizontal_fov) / 2)
    return np.asarray(np.arcsin(np.linspace(-edge, edge, beams)), dtype=np.float64)


def echo_of_image(
    polar_image: ArrayLike, max_range: float, bearings: ArrayLike | None, sonar: Sonar
) -> Echo:
    """Scale an image to 0..255 and leave out beams beyond `sonar.horizontal_fov`.

    Args:
        polar_image: (rows, beams), row 0 nearest, column 0 the most negative bearing; uint8,
            uint16 (scaled from full scale 65535) or float in 0..255.
        max_range: metres, far edge of the last row; row k spans k..k + 1 times max_range / rows.
        bearings: (beams,) radians, strictly increasing, positive to starboard; None for
            `uniform_bearings`.
        sonar: the fan.

    Raises:
        MapError: no image, no range, no fan, or no beam in the field of view.
    """
    image = _intensity(np.asarray(polar_image))
    if not 0 < max_range <= MAX_RANGE_M:
        raise MapError(f"max_range must be above 0 m and at most {MAX_RANGE_M:g} m", "bad_range")
    rows, beams = image.shape
    table = uniform_bearings(beams, sonar) if bearings is None else _table(bearings, beams)
    view = beams_in_view(table, sonar)
    intensity, kept = np.ascontiguousarray(image[:, view]), np.ascontiguousarray(table[view])
    return Echo(intensity, kept, max_range / rows)


def _intensity(image: NDArray[Any]) -> NDArray[np.float32]:
    if image.ndim != 2 or image.size == 0:  # noqa: PLR2004 rows and beams
        raise MapError("an image of rows and beams was expected", "bad_image")
    if image.dtype in (np.uint8, np.uint16):
        return display_units(image, np.iinfo(image.dtype).max)
    if image.dtype.kind != "f":
        raise MapError(f"an image is uint8, uint16 or float, not {image.dtype}", "bad_image")
    if not (np.min(image) >= 0 and np.max(image) <= DISPLAY_FULL_SCALE):  # NaN fails both
        raise MapError("an image of floats must lie within 0..255", "bad_image")
    return image.astype(np.float32)


def _table(bearings: ArrayLike, beams: int) -> NDArray[np.float64]:
    table = np.asarray(bearings, dtype=np.float64)
    if table.shape != (beams,):
        raise MapError("bearings must have one entry for each column", "bad_bearings")
    if not (np.isfinite(table).all() and (np.diff(table) > 0).all()):
        raise MapError("bearings must be finite and rise from port to starboard", "bad_bearings")
    return table
