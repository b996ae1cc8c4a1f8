"""From a ping, or a polar image with its bearings, to the image that the map uses.

Intensities are the raw samples as sent, with the sonar's own time-varied gain in them, because
the threshold is what the operator sees on the sonar's display. They are scaled to 0..255;
16 and 32 bit samples keep their fractions.

`corrected_ranges` is for pings that were made with a wrong speed of sound. A sonar measures times
and multiplies them by a speed of sound; with a wrong one all ranges are wrong by the same factor.
Times stay: those of the echoes, too.

`FanShape` draws a polar image as a fan, for people.
"""

import math
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd.config.device import WaterConfig
from mapperd.config.tree import SonarConfig
from mapperd.errors import MapError
from oculus_driver.ping import Ping
from oculus_driver.sound_speed import SALINITY_LIMITS_PPT, TEMPERATURE_LIMITS_C, speed_of_sound_mps

__all__ = [
    "COLOURS",
    "FanShape",
    "PingImage",
    "beams_in_view",
    "corrected_ranges",
    "display_units",
    "fan_edges",
    "fan_half_width",
    "ping_image_of",
    "ping_image_of_array",
    "true_speed_mps",
    "uniform_bearings",
]

EDGE_RAD = math.radians(0.01)
"""Resolution of the sonar's bearing table: a beam on the edge of the fan belongs to it."""

DISPLAY_FULL_SCALE = 255

EXACT_BYTES = 2
"""Samples of up to this many bytes are exact in float32."""


@dataclass(frozen=True, slots=True, eq=False)
class PingImage:
    """The part of a ping that is mapped; arrays are read-only.

    Attributes:
        intensity: (rows, beams) float32, 0..255, row 0 nearest, most negative bearing first.
        bearings_rad: (beams,) float64, strictly increasing, positive to starboard.
        range_resolution_m: thickness of a row.
        gamma_byte: the sonar applied the exponent gamma/255 to the image; 0 and 255 mean none.
    """

    intensity: NDArray[np.float32]
    bearings_rad: NDArray[np.float64]
    range_resolution_m: float
    gamma_byte: int = 255

    @property
    def max_range_m(self) -> float:
        """Far edge of the last row."""
        return len(self.intensity) * self.range_resolution_m


def ping_image_of(ping: Ping, sonar: SonarConfig) -> PingImage:
    """Scale the image and leave out beams beyond `sonar.horizontal_fov`.

    Raises:
        MapError: the bearings are no fan, or none of them lies in the field of view.
    """
    bearings = ping.bearings_rad
    if "bad_bearings" in ping.warnings:
        raise MapError("bearings do not rise from port to starboard", "bad_bearings")
    view = beams_in_view(bearings, sonar)
    intensity = display_units(ping.image[:, view], ping.full_scale)
    kept = np.ascontiguousarray(bearings[view])
    intensity.setflags(write=False)
    kept.setflags(write=False)
    return PingImage(intensity, kept, ping.range_resolution_m, ping.gamma)


def beams_in_view(bearings_rad: NDArray[np.float64], sonar: SonarConfig) -> slice:
    """The beams, of increasing bearings, within `sonar.horizontal_fov`.

    Raises:
        MapError: none of them lies in it.
    """
    half_rad = math.radians(sonar.horizontal_fov) / 2 + EDGE_RAD
    first, last = np.searchsorted(bearings_rad, [-half_rad, half_rad])
    if first == last:
        raise MapError("no beam lies within sonar.horizontal_fov", "outside_fov")
    return slice(int(first), int(last))


def display_units(samples: NDArray[np.unsignedinteger], full_scale: int) -> NDArray[np.float32]:
    """Samples as 0..255; a division, so that multiples of the step come out whole."""
    if full_scale == DISPLAY_FULL_SCALE:
        return np.ascontiguousarray(samples, dtype=np.float32)
    wide = np.float32 if samples.itemsize <= EXACT_BYTES else np.float64
    intensity = np.divide(samples, wide(full_scale / DISPLAY_FULL_SCALE), dtype=wide)
    return np.ascontiguousarray(intensity, dtype=np.float32)


MAX_RANGE_M = 10_000.0


def uniform_bearings(beams: int, sonar: SonarConfig) -> NDArray[np.float64]:
    """Bearings uniform in sine over `sonar.horizontal_fov`, as the sonar spaces its beams.

    Returns:
        (beams,) float64 radians, increasing; positive to starboard.
    """
    edge = math.sin(math.radians(sonar.horizontal_fov) / 2)
    return np.asarray(np.arcsin(np.linspace(-edge, edge, beams)), dtype=np.float64)


def ping_image_of_array(
    polar_image: ArrayLike, max_range: float, bearings: ArrayLike | None, sonar: SonarConfig
) -> PingImage:
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
    return PingImage(intensity, kept, max_range / rows)


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


HALVINGS = 40
"""Of 40 °C: the temperature is exact to 1e-10 °C."""


def corrected_ranges(ping: Ping, water: WaterConfig) -> Ping:
    """Return a ping whose ranges hold for the speed of sound of this water.

    Args:
        ping: as the sonar sent it.
        water: the true water; without `correct_ranges` the ping is returned unchanged.
    """
    if not water.correct_ranges:
        return ping
    used_mps = ping.credible_speed_of_sound_mps
    true_mps = true_speed_mps(water, used_mps, ping.salinity_ppt)
    if true_mps == used_mps:
        return ping
    return replace(
        ping,
        range_resolution_m=ping.range_resolution_m * (true_mps / used_mps),
        speed_of_sound_mps=true_mps,
    )


def true_speed_mps(water: WaterConfig, used_mps: float, used_ppt: float) -> float:
    """Return the speed of sound in the water, m/s.

    It is the measured one, or computed from the measured temperature, or, from the salinity alone,
    at the temperature at which the sonar's speed holds for the sonar's salinity. Where no
    temperature between 0 and 40 °C explains the sonar's speed, the nearer end is used.

    Args:
        water: the true water.
        used_mps: speed of sound used by the sonar.
        used_ppt: salinity used by the sonar; other values than 0 to 40 change nothing.
    """
    if water.speed_of_sound:
        return water.speed_of_sound
    if water.temperature:
        return speed_of_sound_mps(water.temperature, water.salinity)
    low_ppt, high_ppt = SALINITY_LIMITS_PPT
    if not low_ppt <= used_ppt <= high_ppt or used_ppt == water.salinity:
        return used_mps
    temperature_c = _temperature_c(used_mps, used_ppt)
    factor = speed_of_sound_mps(temperature_c, water.salinity) / speed_of_sound_mps(
        temperature_c, used_ppt
    )
    return used_mps * factor


def _temperature_c(speed_mps: float, salinity_ppt: float) -> float:
    """Return the temperature of a speed of sound, which rises with it from 0 to 40 °C."""
    low_c, high_c = TEMPERATURE_LIMITS_C
    for _ in range(HALVINGS):
        middle_c = (low_c + high_c) / 2
        if speed_of_sound_mps(middle_c, salinity_ppt) < speed_mps:
            low_c = middle_c
        else:
            high_c = middle_c
    return (low_c + high_c) / 2


GAMMA = 0.6
_LEVELS = 3.0 * (np.arange(256) / 255) ** GAMMA
COLOURS: Final = (np.clip(_LEVELS[:, None] - np.arange(3), 0.0, 1.0) * 255).astype(np.uint8)
"""Colours of the samples 0 to 255, (256, 3): black, red, yellow, white."""


class FanShape:
    """Converts polar images to fan images; caches the lookup table of one shape."""

    def __init__(self) -> None:
        self._shape: tuple[int, int, bytes] | None = None
        self._source = np.zeros((0, 0), np.intp)

    def fan_image(
        self, bearings_rad: NDArray[np.float64], pixels: NDArray[np.uint8]
    ) -> NDArray[np.uint8]:
        """Return the image seen from above: sonar at the bottom centre, port left, black outside.

        Args:
            bearings_rad: (beams,), positive to starboard.
            pixels: (rows, beams).
        """
        rows, beams = pixels.shape
        shape = (rows, beams, bearings_rad.tobytes())
        if shape != self._shape:
            self._source = _source(bearings_rad, rows)
            self._shape = shape
        # All indices are valid, and "clip" saves the check.
        return np.append(pixels.ravel(), np.uint8(0)).take(self._source, mode="clip")


def _source(bearings: NDArray[np.float64], rows: int) -> NDArray[np.intp]:
    """Index of the polar value of each pixel; one past the last is outside."""
    beams = len(bearings)
    low, high = fan_edges(bearings)
    half_width = fan_half_width(bearings, rows)
    across = np.arange(-half_width, half_width) + 0.5
    ahead = (np.arange(rows) + 0.5)[::-1, None]
    row = np.floor(np.hypot(across, ahead)).astype(np.intp)
    bearing = np.arctan2(across, ahead)
    between = (bearings[1:] + bearings[:-1]) / 2
    beam = np.searchsorted(between, bearing)
    seen = (row < rows) & (bearing >= low) & (bearing <= high)
    return np.where(seen, row * beams + beam, rows * beams)


def fan_edges(bearings: NDArray[np.float64]) -> tuple[float, float]:
    """Bearings of a fan image's edges: half a beam spacing beyond the outer beams, (beams,)."""
    if len(bearings) == 1:
        return float(bearings[0]) - 0.01, float(bearings[0]) + 0.01
    low = bearings[0] - (bearings[1] - bearings[0]) / 2
    high = bearings[-1] + (bearings[-1] - bearings[-2]) / 2
    return float(low), float(high)


def fan_half_width(bearings: NDArray[np.float64], rows: int) -> int:
    """Half the width of a fan image, pixels; its height is the number of rows."""
    widest = min(max(map(abs, fan_edges(bearings))), math.pi / 2)
    return max(math.ceil(rows * math.sin(widest)), 1)
