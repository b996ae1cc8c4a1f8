"""The receiver: noise, time-varied gain, operator's gain, gamma and the quantiser."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sonar_sim import _core
from sonar_sim.propagation.physics import Physics
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.scene.water import Water, thermal_noise_db

GAIN_DB_PER_PERCENT = 0.96
FULL_SCALE_DB = 210.0
"""Level after gains that fills the quantiser; one constant, free because levels are relative."""

RING_DOWN_DB_PER_M = 1300.0
"""By which a public recording of rows of 2.8 mm shows it to fall."""
MAX_DB = 700.0
"""Of all gains: beyond, single precision is infinite, and silence would be not a number."""


def noise_level_db(sonar: SonarSettings, water: Water) -> float:
    """Noise of one cell at the beam former's output, dB on the echo's scale, before gains."""
    bandwidth_hz = sonar.bandwidth_hz(water.speed_of_sound_mps)
    thermal_db = thermal_noise_db(sonar.frequency_hz, bandwidth_hz)
    return thermal_db - sonar.array_gain_db + sonar.noise_excess_db


def gain_db(sonar: SonarSettings, absorption_db_per_m: float) -> NDArray[np.float64]:
    """Time-varied gain a log R + 2 alpha R plus the operator's, dB, (rows,)."""
    range_m = sonar.row_centres_m
    varied = sonar.tvg_spreading_log * np.log10(range_m) + 2.0 * absorption_db_per_m * range_m
    total: NDArray[np.float64] = varied + GAIN_DB_PER_PERCENT * sonar.gain_percent
    return total


def ring_down_power_db(
    sonar: SonarSettings, ring_down_db: float, absorption_db_per_m: float
) -> NDArray[np.float64]:
    """Level of the transducer's ring-down, in the beams before gains, dB, (rows,).

    Args:
        sonar: its time-varied gain; the ring is known by what the gain makes of it.
        ring_down_db: dB of full scale at 50 % of gain, at the transmission.
        absorption_db_per_m: that the time-varied gain makes up for, one way.
    """
    half_gain = replace(sonar, gain_percent=50.0)
    shown_db = ring_down_db - RING_DOWN_DB_PER_M * sonar.row_centres_m
    level: NDArray[np.float64] = shown_db + FULL_SCALE_DB - gain_db(half_gain, absorption_db_per_m)
    return level


def row_gain(
    sonar: SonarSettings, physics: Physics, absorption_db_per_m: float
) -> NDArray[np.float32]:
    """Amplitude of full scale per unit of amplitude received, (rows,).

    Args:
        sonar: its time-varied gain's law and the operator's gain.
        physics: which of the two are there; without them full scale is as at 0 dB.
        absorption_db_per_m: that the time-varied gain makes up for, one way.
    """
    range_m = sonar.row_centres_m
    total_db = np.full(sonar.rows, -FULL_SCALE_DB)
    if physics.tvg:
        total_db += sonar.tvg_spreading_log * np.log10(range_m)
        total_db += 2.0 * absorption_db_per_m * range_m
    if physics.gain:
        total_db += GAIN_DB_PER_PERCENT * sonar.gain_percent
    gain: NDArray[np.float32] = (10.0 ** (np.minimum(total_db, MAX_DB) / 20.0)).astype(np.float32)
    return gain


def amplitude(
    beams: NDArray[np.complex64] | NDArray[np.float32],
    gain: NDArray[np.float32],
    threads: int = 2,
) -> NDArray[np.float32]:
    """Amplitude after gains, 1 at full scale, (rows, beams); the root of what is a mean power."""
    return _core.amplitudes(beams, gain, threads)


def quantise(
    shown: NDArray[np.float32],
    physics: Physics,
    gamma_byte: int = 255,
    bits: int = 8,
    threads: int = 2,
) -> NDArray[np.float32] | NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.uint32]:
    """The pixel law: full scale times amplitude^(gamma / 255), rounded.

    Args:
        shown: amplitudes, any shape, 1 at full scale.
        physics: whether amplitudes are clipped, gamma is obeyed, and pixels are integers.
        gamma_byte: 0 and 255 mean linear.
        bits: of a pixel, 8, 16 or 32.
        threads: that share the work.
    """
    gamma = gamma_byte / 255.0 if physics.gamma and gamma_byte != 0 else 1.0
    whole = bits if physics.quantised else 0
    return _core.pixels(shown, gamma, whole, physics.saturation, threads)
