"""The receiver: noise, time-varied gain, operator's gain, gamma and the 8-bit quantiser."""

import numpy as np
from numpy.typing import NDArray

from sonar_sim.sonar import SonarSettings
from sonar_sim.water import Water, thermal_noise_db

GAIN_DB_PER_PERCENT = 0.96
FULL_SCALE_DB = 210.0
"""Level after gains that fills the quantiser; one constant, free because levels are relative."""


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


def pixels(amplitude: NDArray[np.float32], gamma_byte: int = 255) -> NDArray[np.uint8]:
    """Quantise: 255 * clip(amplitude, 0, 1) ^ (gamma / 255), rounded.

    Args:
        amplitude: any shape, 1 at full scale.
        gamma_byte: 0 and 255 mean linear.
    """
    clipped = np.clip(amplitude, 0.0, 1.0)
    if gamma_byte not in (0, 255):
        clipped = clipped ** (gamma_byte / 255.0)
    quantised: NDArray[np.uint8] = np.rint(255.0 * clipped).astype(np.uint8)
    return quantised
