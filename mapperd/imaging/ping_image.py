"""From a ping to what the map wants to see of it.

Intensities are the raw samples as sent, with the sonar's own time-varied gain in them, because
the threshold is what the operator sees on the sonar's display. They are scaled to 0..255;
16 and 32 bit samples keep their fractions.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import Sonar
from mapperd.errors import MapError
from oculus_driver.ping import Ping

__all__ = ["Echo", "beams_in_view", "display_units", "echo_of"]

EDGE_RAD = math.radians(0.01)
"""Resolution of the sonar's bearing table: a beam on the edge of the fan belongs to it."""

EXACT_BYTES = 2
"""Samples of up to this many bytes are exact in float32."""


@dataclass(frozen=True, slots=True, eq=False)
class Echo:
    """The part of a ping that is mapped; arrays are read-only.

    Attributes:
        intensity: (rows, beams) float32, 0..255, row 0 nearest, most negative bearing first.
        bearings_rad: (beams,) float64, strictly increasing, positive to starboard.
        range_resolution_m: thickness of a row.
    """

    intensity: NDArray[np.float32]
    bearings_rad: NDArray[np.float64]
    range_resolution_m: float

    @property
    def max_range_m(self) -> float:
        """Far edge of the last row."""
        return len(self.intensity) * self.range_resolution_m


def echo_of(ping: Ping, sonar: Sonar) -> Echo:
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
    return Echo(intensity, kept, ping.range_resolution_m)


def beams_in_view(bearings_rad: NDArray[np.float64], sonar: Sonar) -> slice:
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
    wide = np.float32 if samples.itemsize <= EXACT_BYTES else np.float64
    intensity = np.divide(samples, wide(full_scale / 255), dtype=wide)
    return np.ascontiguousarray(intensity, dtype=np.float32)
