"""The sonar's fixed properties: an Oculus, by default an M750d in its 750 kHz band, or another."""

import math
from dataclasses import dataclass, fields, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oculus_driver.models import M370S, M750D, M1200D, M3000D
from sonar_sim.errors import SceneError

HALF_POWER = 0.8859
"""-3 dB width of an unshaded line in lambda / L."""
MAX_ROWS = 720
"""Rows that an Oculus sends at most; it coarsens the spacing by powers of two to keep to it."""
POSITIVE = {
    "frequency_hz",
    "half_aperture_rad",
    "beam_width_rad",
    "vertical_width_rad",
    "base_row_m",
    "max_range_m",
    "told_speed_mps",
    "pulse_s",
}
"""Settings that are more than 0."""


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
        noise_excess_db: how far the receiver's noise lies above thermal noise. Chosen so that sand
            2 m under a level sonar is seen to 15 m in the 750 kHz band, 6 dB above the noise, as in
            published images. At 2.1 MHz and 1 m a floor is then some 30 dB above the noise; 35 dB
            in a public recording.
        gain_percent: the operator's gain, 0 to 100.
        tvg_spreading_log: a in the time-varied gain a log R + 2 alpha R; 30 is what a public
            recording shows, and what levels an extended surface.
        gamma_byte: pixel = full scale * amplitude^(gamma_byte / 255); 0 and 255 mean linear.
        model, mode: what it calls itself; see `sonar_preset`.
        max_range_m: what may be asked for.
        max_rows: rows that it sends at most; it coarsens their spacing by powers of two.
        bits: of a sample, 8, 16 or 32.
        forced_rows: rows of the image whatever an Oculus would choose; None lets it choose.
        told_speed_mps: speed of sound that the sonar assumes; None is the true one.
        pulse_s: length of the transmitted chirp, for the Doppler shift.
        crosstalk_db: electrical, of a row's mean power into all its beams; None has none.
        ring_down_db: what still rings in the receiver right after the transmission, dB of full
            scale at 50 % of gain; None has none. -31 dB in a public recording, whose floor, noise
            and tail are 27 dB brighter than here at the same gain.
        dynamic_focus: beams are focused at every range; else they widen nearer than `focus_m`.

    Raises:
        SceneError: a number is not finite, or no sonar has it; names the field.
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
    noise_excess_db: float = 18.0
    gain_percent: float = 50.0
    tvg_spreading_log: float = 30.0
    gamma_byte: int = 255
    model: str = "M750d"
    mode: int = 1
    max_range_m: float = 120.0
    max_rows: int = MAX_ROWS
    bits: int = 8
    forced_rows: int | None = None
    told_speed_mps: float | None = None
    pulse_s: float = 1e-3
    crosstalk_db: float | None = -60.0
    ring_down_db: float | None = -58.0
    dynamic_focus: bool = True

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if value is None or isinstance(value, str):
                continue
            if not math.isfinite(value) or (field.name in POSITIVE and value <= 0.0):
                wanted = "finite and more than 0" if field.name in POSITIVE else "finite"
                raise SceneError(f"{field.name} {value:g} is not {wanted}")
        if not 0.1 <= self.demanded_range_m <= self.max_range_m:  # noqa: PLR2004 Oculus' nearest
            raise SceneError(
                f"range {self.demanded_range_m:g} m is not 0.1 to {self.max_range_m:g} m, "
                f"which is what an {self.model} in mode {self.mode} hears"
            )
        if self.bits not in (8, 16, 32):
            raise SceneError(f"{self.bits} bits a sample; an Oculus sends 8, 16 or 32")
        if self.max_rows < 1:
            raise SceneError(f"max_rows {self.max_rows} are no image")
        if self.beams < 2 or (self.forced_rows is not None and self.forced_rows < 1):  # noqa: PLR2004 one beam has no pitch
            raise SceneError(f"{self.beams} beams, {self.forced_rows} rows are no image")
        if self.rows < 1:
            raise SceneError(
                f"demanded_range_m {self.demanded_range_m:g} is less than base_row_m "
                f"{self.base_row_m:g}: the image has no row; raise the range or make rows finer"
            )

    @cached_property
    def range_resolution_m(self) -> float:
        """Row spacing: the base spacing times the smallest power of two that fits `max_rows`.

        It is no longer than the range, so that there is a row.
        """
        if self.forced_rows is not None:
            return self.demanded_range_m / self.forced_rows
        spacing_m = self.base_row_m
        while self.demanded_range_m / spacing_m > max(
            self.max_rows, 2.0 - 1e-9
        ):  # below 2, half is no row
            spacing_m *= 2.0
        return spacing_m

    @cached_property
    def rows(self) -> int:
        """Range rows of the image."""
        if self.forced_rows is not None:
            return self.forced_rows
        return int(self.demanded_range_m / self.range_resolution_m + 1e-9)

    @property
    def on_wire(self) -> bool:
        """Whether it speaks the Oculus protocol, so that it can be served and recorded."""
        return self.model not in OTHERS

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

    def focus_m(self, speed_of_sound_mps: float) -> float:
        """Range L²/lambda from which beams are sharp without focus; L = 0.886 lambda / width."""
        wavelength_m = speed_of_sound_mps / self.frequency_hz
        return wavelength_m * (HALF_POWER / (2.0 * math.sin(self.beam_width_rad / 2.0))) ** 2

    def bandwidth_hz(self, speed_of_sound_mps: float) -> float:
        """Bandwidth whose resolution is one row."""
        return speed_of_sound_mps / (2.0 * self.range_resolution_m)


def sonar_preset(model: str = "M750d", mode: int = 1, **changes: Any) -> SonarSettings:  # noqa: ANN401 any field
    """One of the sonars that can be had, in one of its modes.

    Frequencies, ranges and angles of Oculus sonars are those of the driver
    (docs/reference/models.md), those of others in `OTHERS`.

    Args:
        model: M370s, M750d, M1200d or M3000d; or one of `OTHERS`, which are simulated and not
            spoken on the wire.
        mode: 1 is wide and looks far, 2 is narrow and sharp; the M370s and others have mode 1 only.
        changes: fields that shall differ.

    Raises:
        SceneError: there is no such sonar or mode, or a change cannot be.
    """
    if model in OTHERS and mode == 1:
        return replace(OTHERS[model], **changes)
    try:
        band = _BANDS[model, mode]
    except KeyError:
        known = [f"{name} mode {number}" for name, number in _BANDS]
        known += [f"{name} mode 1" for name in OTHERS]
        scanned = "; a Ping360 is a sonar_sim.ScanningSonar" if model == "Ping360" else ""
        text = f"no {model} with mode {mode}; there are {', '.join(known)}{scanned}"
        raise SceneError(text) from None
    frequency_hz = band.frequency_hz or 0.0
    standard = SonarSettings(
        frequency_hz=frequency_hz,
        half_aperture_rad=math.radians((band.aperture_deg or UNKNOWN_APERTURE_DEG) / 2.0),
        beam_width_rad=math.radians(band.resolution_deg or UNKNOWN_BEAM_DEG),
        vertical_width_rad=math.radians((band.elevation_deg or UNKNOWN_ELEVATION_DEG)[0]),
        demanded_range_m=min(SonarSettings.demanded_range_m, band.max_range_m),
        base_row_m=_BASE_ROW_M[frequency_hz],
        model=model,
        mode=mode,
        max_range_m=band.max_range_m,
    )
    return replace(standard, **changes)


def _other(model: str, frequency_hz: float, beams: int, aperture_deg: float) -> SonarSettings:
    """A multibeam sonar with beams of 1° x 20°, as all of them have."""
    tritech = model.startswith("Gemini")
    return SonarSettings(
        model=model,
        frequency_hz=frequency_hz,
        beams=beams,
        half_aperture_rad=math.radians(aperture_deg / 2.0),
        base_row_m=0.008 if tritech else 0.0254,
        max_range_m=120.0 if tritech else 100.0,
        max_rows=4096,
    )


OTHERS: MappingProxyType[str, SonarSettings] = MappingProxyType(
    {
        one.model: one
        for one in (
            _other("Gemini 720is", 720e3, 512, 120.0),
            _other("P900-45", 900e3, 256, 45.0),
            _other("P900-90", 900e3, 512, 90.0),
            _other("P900-130", 900e3, 768, 130.0),
        )
    }
)
"""Sonars of other makers by name: simulated, but not spoken on the wire.

Gemini 720is: Tritech manual 0703-SOM-00002, 2.1: 720 kHz, 120°, 512 beams of 1.0° (0.25° effective)
x 20°, 0.2 to 120 m, range resolution 8 mm. P900: Teledyne BlueView's data sheet of the series:
900 kHz, 256, 512 or 768 beams of 1° x 20°, 0.18° apart, to 100 m, range resolution 25.4 mm.
Levels, noise, gain and side lobes are unpublished and stay those of an Oculus; bearings are uniform
in sine.
"""

UNKNOWN_APERTURE_DEG, UNKNOWN_BEAM_DEG, UNKNOWN_ELEVATION_DEG = 130.0, 2.0, (20.0,)
"""Unpublished values of the M370s: the swath of the M750d, the beam of an array of its length."""
_BASE_ROW_M = {375e3: 0.008, 750e3: 0.004, 1.2e6: 0.0025, 2.1e6: 0.0025, 3.0e6: 0.002}
"""Finest row by frequency: 4 mm and 2.5 mm by the M750d's data sheet, the others by their like."""
_BANDS = {
    (family.name, number): band
    for family in (M370S, M750D, M1200D, M3000D)
    for number, band in enumerate(family.modes, start=1)
}
