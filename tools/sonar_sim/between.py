"""How an echo between columns is spread over whole columns so that beams cannot tell."""

import functools

import numpy as np
from numpy.typing import NDArray

from sonar_sim.propagation.beam_pattern import azimuth_amplitude, main_lobe_end
from sonar_sim.propagation.physics import Physics
from sonar_sim.scene.sonar import SonarSettings

FRACTIONS = 64
TAPS = 6
REACH = 24
"""Pitches on each side over which the beams' pattern is matched."""
NEAREST = np.array([[1.0, 0.0], [0.0, 1.0]], dtype=np.float32)


def column_taps(sonar: SonarSettings, physics: Physics) -> NDArray[np.float32]:
    """Weights of whole columns for echoes between two of them, by the fraction, (F, even).

    Column 0 of the weights is the one `count / 2 - 1` before the echo. Without a beam pattern each
    echo falls into the nearest column.
    """
    if physics.beam_width_rad is None:
        return NEAREST
    lobes_db = sonar.side_lobe_db if physics.side_lobe_db is None else physics.side_lobe_db
    return _fitted(
        physics.beam_width_rad,
        lobes_db,
        sonar.sine_pitch,
        power=not physics.speckle,
        main_only=physics.side_lobe_db is None,
    )


@functools.lru_cache(maxsize=16)
def _fitted(
    width_rad: float, side_lobe_db: float, pitch: float, *, power: bool, main_only: bool
) -> NDArray[np.float32]:
    """Least squares: the shifted pattern as a sum of patterns about whole columns."""
    pattern = azimuth_amplitude(width_rad, side_lobe_db)
    null = main_lobe_end(width_rad, side_lobe_db)

    def heard(offset: NDArray[np.float64]) -> NDArray[np.float64]:
        sine = offset * pitch
        amplitude = pattern(sine)
        if main_only:
            amplitude = np.where(np.abs(sine) > null, 0.0, amplitude)
        return np.square(amplitude) if power else amplitude

    place = np.linspace(-REACH, REACH, 16 * REACH + 1)
    whole = np.arange(TAPS) - (TAPS // 2 - 1)
    fraction = (np.arange(FRACTIONS) + 0.5) / FRACTIONS
    basis = heard(place[:, None] - whole)
    wanted = heard(place[:, None] - fraction)
    weights = np.linalg.lstsq(basis, wanted, rcond=1e-6)[0]
    return np.ascontiguousarray(weights.T, dtype=np.float32)
