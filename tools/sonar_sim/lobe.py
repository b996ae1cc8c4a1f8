"""The mirror's lobe of a rough surface."""

import math

import numpy as np
from numpy.typing import NDArray

LEAST_COSINE = 1e-3


def lobe_strength(
    cos_incidence: NDArray[np.float64],
    reflection: NDArray[np.float64],
    roughness_m: NDArray[np.float64],
    slope_rad: NDArray[np.float64],
    wave_number_per_m: float,
) -> NDArray[np.float64]:
    """Mirror lobe per unit area: |G|² sec⁴i / (8 pi s²) exp(-tan²i / (2 s²)).

    Geometric optics over facets of slope s; |G|² = reflection² exp(-4 k² h² cos²i) is what
    roughness h within a wavelength's patch leaves of the mirror.
    """
    cos2 = np.maximum(np.square(cos_incidence), LEAST_COSINE**2)
    kept = np.square(reflection) * np.exp(-4.0 * np.square(wave_number_per_m * roughness_m) * cos2)
    spread = 2.0 * np.square(slope_rad)
    tan2 = 1.0 / cos2 - 1.0
    lobe: NDArray[np.float64] = kept / (cos2**2 * 4.0 * math.pi * spread) * np.exp(-tan2 / spread)
    return lobe
