"""Materials: how surfaces scatter and reflect sound."""

import math
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from sonar_sim.errors import SceneError

LAMBERT_DB = (-200.0, 0.0)
"""Lambert's mu cannot exceed 1/pi for a surface that sends back no more than it gets (-5 dB); a
little more is left to surfaces that favour the way back."""
SLOPE_RAD = (0.001, 1.0)


@dataclass(frozen=True, slots=True)
class Material:
    """One kind of surface.

    Attributes:
        name: for people and files.
        lambert_db: back scattering strength at normal incidence, 10 log mu, dB (Lambert's law:
            mu cos² of incidence a unit area).
        reflection: of pressure at the interface, signed; 0 has no mirror.
        roughness_m: standard deviation of the height within a wavelength's patch. The mirror's
            coherence is exp(-2 k² roughness² cos²): smooth is less than some tenth of a millimetre.
        slope_rad: standard deviation of the facets' slopes, which spreads what is mirrored.
    """

    name: str
    lambert_db: float
    reflection: float = 0.0
    roughness_m: float = 0.01
    slope_rad: float = 0.1

    def __post_init__(self) -> None:
        where = f"material {self.name!r}"
        if not LAMBERT_DB[0] <= self.lambert_db <= LAMBERT_DB[1]:
            raise SceneError(f"{where}: lambert_db {self.lambert_db:g} is not -200 to 0 dB")
        if not -1.0 <= self.reflection <= 1.0:
            raise SceneError(f"{where}: reflection {self.reflection:g} is not -1 to 1")
        if not 0.0 <= self.roughness_m <= 1.0:
            raise SceneError(f"{where}: roughness_m {self.roughness_m:g} is not 0 to 1 m")
        if not SLOPE_RAD[0] <= self.slope_rad <= SLOPE_RAD[1]:
            raise SceneError(f"{where}: slope_rad {self.slope_rad:g} is not 0.001 to 1 rad")

    @property
    def mu(self) -> float:
        """Lambert's coefficient as a ratio."""
        return float(10.0 ** (self.lambert_db / 10.0))


def _named(*materials: Material) -> MappingProxyType[str, Material]:
    return MappingProxyType({material.name: material for material in materials})


MATERIALS = _named(
    Material("mud", -32.0, 0.15, 0.005),
    Material("sand", -25.0, 0.36, 0.01, 0.15),
    Material("gravel", -20.0, 0.4, 0.03, 0.3),
    Material("rock", -14.0, 0.68, 0.03, 0.3),
    Material("concrete", -15.0, 0.68, 0.002),
    Material("overgrown_concrete", -13.0, 0.68, 0.02, 0.4),
    Material("sheet_piling", -20.0, 0.94, 0.002),
    Material("rusty_steel", -17.0, 0.94, 0.002, 0.2),
    Material("painted_steel", -20.0, 0.94, 3e-4, 0.05),
    Material("overgrown_steel", -15.0, 0.94, 0.01, 0.3),
    Material("machined_steel", -30.0, 0.94, 2e-5, 0.01),
    Material("aluminium", -30.0, 0.84, 2e-5, 0.01),
    Material("glass", -40.0, 0.80, 5e-6, 0.005),
    Material("tiles", -30.0, 0.68, 5e-5, 0.01),
    Material("pvc", -28.0, 0.36, 5e-5, 0.02),
    Material("wood", -20.0, 0.24, 0.001),
    Material("rubber", -22.0, 0.08, 5e-4),
    Material("neoprene", -16.0, -0.5, 0.002, 0.3),
    Material("absorber", -60.0),
)
"""Materials by name.

Reflections follow from the impedances Z in MRayl (steel 46, aluminium 17.3, glass 14, concrete 8,
sand and PVC 3.3, wood 2.5, mud 2.1, rubber 1.8) against water's 1.54: (Z - 1.54) / (Z + 1.54).
Scattering strengths are orders of magnitude; published values at these frequencies scatter by 5 dB.
Neoprene is full of gas, hence its sign. An absorber hides what is behind it and is silent itself.
"""


MIN_COSINE = 1e-3


def specular_lobe(
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
    cos2 = np.maximum(np.square(cos_incidence), MIN_COSINE**2)
    kept = np.square(reflection) * np.exp(-4.0 * np.square(wave_number_per_m * roughness_m) * cos2)
    spread = 2.0 * np.square(slope_rad)
    tan2 = 1.0 / cos2 - 1.0
    lobe: NDArray[np.float64] = kept / (cos2**2 * 4.0 * math.pi * spread) * np.exp(-tan2 / spread)
    return lobe
