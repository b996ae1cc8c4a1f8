"""The sonar's fixed properties: an Oculus M750d in its 750 kHz band."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

MAX_ROWS = 720
"""Rows that an Oculus sends at most; it coarsens the spacing by powers of two to keep to it."""


@dataclass(frozen=True)
class SonarSettings:
    """Geometry and electronics of one sonar in one setting.

    Attributes:
        frequency_hz: acoustic frequency.
        beams: columns of the image; their bearings are uniform in sine.
        half_aperture_rad: bearing of the outermost beams.
        beam_width_rad: azimuth -3 dB full width of a beam at broadside, one way (receive).
        side_lobe_db: level of the azimuth side lobes under the main lobe, positive.
        vertical_width_rad: vertical -3 dB full width, one way; the echo suffers it twice.
        demanded_range_m: range asked for; see `range_m` for what the sonar makes of it.
        base_row_m: finest row spacing.
        source_level_db: dB re 1 µPa at 1 m. Unpublished, so levels are relative.
        array_gain_db: gain of the receiving array against thermal noise.
        noise_excess_db: how far the receiver's noise lies above thermal noise. Chosen so that the
            floor reaches some -36 dB of full scale at the far end, as in public recordings.
        gain_percent: the operator's gain, 0 to 100.
        tvg_spreading_log: a in the time-varied gain a log R + 2 alpha R; 30 is what a public
            recording shows, and what levels an extended surface.
        gamma_byte: pixel = 255 amplitude^(gamma_byte / 255); 0 and 255 mean linear.
    """

    frequency_hz: float = 750e3
    beams: int = 512
    half_aperture_rad: float = math.radians(65.0)
    beam_width_rad: float = math.radians(1.0)
    side_lobe_db: float = 30.0
    vertical_width_rad: float = math.radians(20.0)
    demanded_range_m: float = 10.0
    base_row_m: float = 0.004
    source_level_db: float = 200.0
    array_gain_db: float = 33.0
    noise_excess_db: float = 40.0
    gain_percent: float = 50.0
    tvg_spreading_log: float = 30.0
    gamma_byte: int = 255

    @cached_property
    def range_resolution_m(self) -> float:
        """Row spacing: the base spacing times the smallest power of two that fits `MAX_ROWS`."""
        spacing_m = self.base_row_m
        while self.demanded_range_m / spacing_m > MAX_ROWS:
            spacing_m *= 2.0
        return spacing_m

    @cached_property
    def rows(self) -> int:
        """Range rows of the image."""
        return int(self.demanded_range_m / self.range_resolution_m + 1e-9)

    @property
    def range_m(self) -> float:
        """Far edge of the last row."""
        return self.rows * self.range_resolution_m

    @cached_property
    def row_centres_m(self) -> NDArray[np.float64]:
        """Range of each row's middle, (rows,)."""
        centres: NDArray[np.float64] = np.arange(0.5, self.rows) * self.range_resolution_m
        return centres

    @property
    def sine_pitch(self) -> float:
        """Distance of neighbouring beams in the sine of their bearing."""
        return 2.0 * math.sin(self.half_aperture_rad) / (self.beams - 1)

    def bandwidth_hz(self, speed_of_sound_mps: float) -> float:
        """Bandwidth whose resolution is one row."""
        return speed_of_sound_mps / (2.0 * self.range_resolution_m)
