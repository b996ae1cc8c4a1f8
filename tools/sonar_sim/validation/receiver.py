"""Validation of the receiver: beam pattern, bearings, quantiser (V6, V13, V14)."""

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sonar_sim import _core
from sonar_sim.propagation.beam_pattern import azimuth_amplitude, main_lobe_end
from sonar_sim.propagation.physics import Physics
from sonar_sim.receiver.beamformer import beam_former, beam_sines
from sonar_sim.receiver.gain import quantise
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.validation.case import ValidationCheck, ValidationResult
from sonar_sim.validation.setups import Homogeneous
from sonar_sim.validation.statistics import correlation

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SETUPS = (
    ("M1200d 2.1 MHz 256", (0.4, 30.0), 256, 40.0, 0.646),
    ("M750d LF 512", (1.0, 65.0), 512, 30.0, 0.944),
    ("M750d LF 256", (1.0, 65.0), 256, 30.0, 0.795),
    ("M750d HF 512", (0.6, 35.0), 512, 30.0, 0.938),
    ("M750d HF 256", (0.6, 35.0), 256, 30.0, 0.774),
)
"""Name, beam width and half aperture deg, beams, side lobes dB, correlation of power at lag 1 in
mid-fan."""
MARGIN = 12
FINE = SonarSettings(half_aperture_rad=math.radians(7.0))
"""So narrow a fan that 37 beams sample one beam's width."""


def v06_beam_pattern() -> ValidationResult:
    """One target through the beam former, and speckle through neighbouring beams."""
    checks = (*_unshaded(), *_scanned(), *_steered(), *(_neighbours(*s) for s in SETUPS))
    return ValidationResult(
        "V6 beam pattern", "line array theory; a Gaussian beam", checks, _draw_beam_pattern
    )


def _seen(sonar: SonarSettings, side_lobe_db: float, column: int) -> NDArray[np.float64]:
    """Amplitude in every beam of a target of amplitude 1 at a beam's own bearing."""
    physics = Physics(
        beam_width_rad=sonar.beam_width_rad, side_lobe_db=side_lobe_db, sine_bearings=True
    )
    field = np.zeros((1, sonar.beams + 2 * MARGIN), dtype=np.complex64)
    field[0, MARGIN + column] = 1.0
    amplitude: NDArray[np.float64] = np.abs(
        beam_former(sonar, physics, MARGIN).form(field)[0]
    ).astype(np.float64)
    return amplitude


def _crossing(x: NDArray[np.floating], falling: NDArray[np.floating], level: float) -> float:
    """Where a sampled function first falls below a level, between samples."""
    i = int(np.argmax(falling < level))
    part = (falling[i - 1] - level) / (falling[i - 1] - falling[i])
    return float(x[i - 1] + part * (x[i] - x[i - 1]))


def _unshaded() -> tuple[ValidationCheck, ...]:
    """Widths and lobes of a line without shading, in lambda / L."""
    wavelength_over_length = math.sin(FINE.beam_width_rad / 2.0) / 0.44295
    middle = FINE.beams // 2
    seen = _seen(FINE, 13.26, middle)[middle:]
    x = np.arange(len(seen)) * FINE.sine_pitch / wavelength_over_length
    null = int(np.argmax(np.diff(seen) > 0.0))
    lobe = null + int(np.argmax(seen[null : 2 * null]))
    return (
        ValidationCheck(
            "half-power half-width, lambda/L", 0.44295, _crossing(x, seen, 0.5**0.5), 0.002
        ),
        ValidationCheck(
            "two-way half width, lambda/L", 0.31892, _crossing(x, seen**2, 0.5**0.5), 0.002
        ),
        ValidationCheck("first null, lambda/L", 1.0, float(x[null]), 0.03),
        ValidationCheck("first side lobe, dB", -13.261, 20.0 * math.log10(seen[lobe]), 0.02),
        ValidationCheck("side lobe two way, dB", -26.523, 40.0 * math.log10(seen[lobe]), 0.04),
        ValidationCheck("where it is, lambda/L", 1.4303, float(x[lobe]), 0.03),
    )


def _scanned() -> tuple[ValidationCheck, ...]:
    """Worst deviation from the design's pattern down to -30 dB, over the fan and finely."""
    checks = []
    for name, sonar in (("fan of 130 deg", SonarSettings()), ("fine scan", FINE)):
        column = 200
        seen = _seen(sonar, sonar.side_lobe_db, column)
        offsets = (np.arange(sonar.beams, dtype=np.float64) - column) * sonar.sine_pitch
        designed = np.abs(azimuth_amplitude(sonar.beam_width_rad, sonar.side_lobe_db)(offsets))
        loud = designed > 10.0 ** (-30.0 / 20.0)
        worst = np.abs(20.0 * np.log10(seen[loud] / designed[loud])).max()
        checks.append(ValidationCheck(f"{name}: deviation to -30 dB, dB", 0.0, float(worst), 0.1))
    middle = FINE.beams // 2
    seen = _seen(FINE, 30.0, middle)[middle:]
    end = math.ceil(main_lobe_end(FINE.beam_width_rad, 30.0) / FINE.sine_pitch)
    highest_db = 20.0 * math.log10(seen[end:].max())
    checks.append(
        ValidationCheck("shaded for 30 dB: highest side lobe, dB", -30.0, highest_db, 0.1)
    )
    return tuple(checks)


def _steered() -> tuple[ValidationCheck, ...]:
    """Full width on the axis and at 60 degrees, deg; it doubles."""
    sonar = dataclasses.replace(SonarSettings(), beams=4096)
    sines = (np.arange(sonar.beams) - (sonar.beams - 1) / 2.0) * sonar.sine_pitch
    checks = []
    for steer_deg, expected in ((0.0, 1.0), (60.0, 2.0)):
        column = int(np.argmin(np.abs(sines - math.sin(math.radians(steer_deg)))))
        seen = _seen(sonar, 30.0, column)
        right = _crossing(sines[column:], seen[column:], 0.5**0.5)
        left = _crossing(sines[column::-1], seen[column::-1], 0.5**0.5)
        width_deg = math.degrees(math.asin(right) - math.asin(left))
        checks.append(
            ValidationCheck(
                f"width at {steer_deg:g} deg, deg", expected, width_deg, 0.01 * expected
            )
        )
    return tuple(checks)


def _neighbours(
    name: str, sonar_deg: tuple[float, float], beams: int, side_lobe_db: float, expected: float
) -> ValidationCheck:
    """Correlation of power between neighbouring beams of speckle, side lobes and all."""
    width_deg, half_deg = sonar_deg
    sonar = dataclasses.replace(
        SonarSettings(),
        beam_width_rad=math.radians(width_deg),
        beams=beams,
        half_aperture_rad=math.radians(half_deg),
        side_lobe_db=side_lobe_db,
    )
    power = np.square(np.abs(Homogeneous(sonar, 102400 // beams).beams()).astype(np.float64))
    return ValidationCheck(
        f"{name}: neighbours' power", expected, correlation(power[:, 1:], power[:, :-1]), 0.015
    )


def _draw_beam_pattern(axes: "Axes") -> None:
    middle = FINE.beams // 2
    bearing_deg = np.degrees(np.arcsin((np.arange(FINE.beams) - middle) * FINE.sine_pitch))
    for side_lobe_db, label in ((13.26, "unshaded"), (30.0, "shaded for 30 dB")):
        seen = _seen(FINE, side_lobe_db, middle)
        level_db = 20.0 * np.log10(np.maximum(seen, 1e-4))
        axes.plot(bearing_deg, level_db, lw=1.0, label=label)
    axes.axhline(-13.26, color="0.7", lw=0.6)
    axes.set_ylim(-60.0, 2.0)
    axes.set_xlabel("bearing, deg")
    axes.set_ylabel("beam, dB")
    axes.legend(fontsize=6)


TABLES = (
    (256, 30.0, (-30.00, -29.74), 0.11),
    (512, 65.0, (-65.00, -64.52), 0.10),
)
"""Beams, half aperture deg, first two bearings deg, either side of the middle deg."""


def v13_bearings() -> ValidationResult:
    """Ends and middle of two fans, and the equal angles that the law is not."""
    checks = []
    for beams, half_deg, first_deg, middle_deg in TABLES:
        found = bearings_deg(beams, half_deg)
        name = f"{beams} beams, {2 * half_deg:g} deg"
        expected = (*first_deg, -middle_deg, middle_deg)
        got = (*found[:2], *found[beams // 2 - 1 : beams // 2 + 1])
        checks += [
            ValidationCheck(f"{name}: beam {i}, deg", want, float(have), 0.01)
            for i, want, have in zip((0, 1, "-", "+"), expected, got, strict=True)
        ]
    gap = np.abs(bearings_deg(512, 65.0) - bearings_deg(512, 65.0, sine=False)).max()
    checks.append(ValidationCheck("equal angles are off by, deg", 6.2, float(gap), 0.05))
    return ValidationResult(
        "V13 bearings", "recording; asin of equal steps", tuple(checks), _draw_bearings
    )


def bearings_deg(beams: int, half_deg: float, *, sine: bool = True) -> NDArray[np.float64]:
    """Bearing of each beam of a fan."""
    sonar = dataclasses.replace(
        SonarSettings(), beams=beams, half_aperture_rad=math.radians(half_deg)
    )
    return np.degrees(np.arcsin(beam_sines(sonar, Physics(sine_bearings=sine))))


def _draw_bearings(axes: "Axes") -> None:
    for sine, label in ((True, "uniform in sine"), (False, "equal angles")):
        axes.plot(np.diff(bearings_deg(512, 65.0, sine=sine)), lw=1.0, label=label)
    axes.set_xlabel("beam of 512 over 130 deg")
    axes.set_ylabel("spacing, deg")
    axes.legend(fontsize=6)


AMPLITUDES = np.array([1.0, 0.25, 0.0625, 1.0 / 65025.0], dtype=np.float32)
AT_ONE_HALF = (255.0, 127.5, 63.75, 1.0)
BOTH = Physics(gamma=True, saturation=True, quantised=True)


def v14_quantiser() -> ValidationResult:
    """Values of the reference, and the ends of 8, 16 and 32 bits."""
    curve = 255.0 * _core.pixels(AMPLITUDES, 0.5, 0, clip=True)
    eight = _core.pixels(AMPLITUDES, 0.5, 8, clip=True)
    checks = [
        ValidationCheck(f"255 A^0.5 at A = {a:.3g}", want, float(got), 1e-3)
        for a, want, got in zip(AMPLITUDES, AT_ONE_HALF, curve, strict=True)
    ]
    checks += [
        ValidationCheck(f"8 bit at A = {a:.3g}", want, float(got), 0.5)
        for a, want, got in zip(AMPLITUDES, AT_ONE_HALF, eight, strict=True)
    ]
    sixteen = quantise(AMPLITUDES, BOTH, gamma_byte=255, bits=16)
    checks += [
        ValidationCheck(f"16 bit, linear, at A = {a:.3g}", 65535.0 * float(a), float(got), 0.5)
        for a, got in zip(AMPLITUDES, sixteen, strict=True)
    ]
    over = np.array([1.0, 1.7, 1e9], dtype=np.float32)
    for bits in (8, 16, 32):
        end = float(quantise(over, BOTH, gamma_byte=127, bits=bits).min())
        checks.append(ValidationCheck(f"{bits} bit: end of the scale", 2.0**bits - 1.0, end, 0.0))
    return ValidationResult(
        "V14 quantiser", "pixel = full scale A^gamma", tuple(checks), _draw_quantiser
    )


def _draw_quantiser(axes: "Axes") -> None:
    amplitude = np.geomspace(1e-5, 2.0, 400).astype(np.float32)
    for gamma_byte in (255, 127, 64):
        image = quantise(amplitude, BOTH, gamma_byte=gamma_byte)
        axes.semilogx(amplitude, image, lw=1.0, label=f"gamma byte {gamma_byte}")
    axes.semilogx(AMPLITUDES, AT_ONE_HALF, "k+", ms=8)
    axes.set_xlabel("amplitude of full scale")
    axes.set_ylabel("8-bit pixel")
    axes.legend(fontsize=6)
