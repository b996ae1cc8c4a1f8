"""Attenuation and back scattering of bubbles and of suspended sediment."""

import math
from dataclasses import dataclass

from sonar_sim.scene.scene import Bubbles, CloudSpec
from sonar_sim.scene.sonar import SonarSettings

GRAIN_DENSITY = 2650.0
WATER_DENSITY = 1027.0
VISCOSITY_M2_PER_S = 1.3e-6
"""Kinematic, of sea water at 10 °C."""
NEPER_DB = 20.0 / math.log(10.0)


def sediment_db_per_m(
    frequency_hz: float, kg_per_m3: float, radius_m: float, speed_mps: float = 1500.0
) -> float:
    """One-way attenuation by friction at the grains and by scattering, Urick (1948).

    2 alpha = phi (k^4 a^3 / 6 + k (sigma - 1)^2 s / (s^2 + (sigma + tau)^2)), with
    beta = sqrt(omega / 2 nu), s = 9 / (4 beta a) (1 + 1 / (beta a)), tau = 1/2 + 9 / (4 beta a).

    Args:
        frequency_hz: acoustic frequency.
        kg_per_m3: concentration.
        radius_m: of the grains.
        speed_mps: of sound.

    Returns:
        dB per metre of path.
    """
    omega = 2.0 * math.pi * frequency_hz
    k = omega / speed_mps
    thickness = math.sqrt(omega / (2.0 * VISCOSITY_M2_PER_S)) * radius_m
    s = 9.0 / (4.0 * thickness) * (1.0 + 1.0 / thickness)
    tau = 0.5 + 9.0 / (4.0 * thickness)
    sigma = GRAIN_DENSITY / WATER_DENSITY
    friction = k * (sigma - 1.0) ** 2 * s / (s**2 + (sigma + tau) ** 2)
    scattering = k**4 * radius_m**3 / 6.0
    share = kg_per_m3 / GRAIN_DENSITY
    return NEPER_DB * share * (scattering + friction) / 2.0


NEPER_POWER_DB = 10.0 / math.log(10.0)
EXTINCTION = 2.0
"""A large sphere takes twice its own shadow: what it stops, and as much again by diffraction."""
QUARTZ_CONTRAST = 0.338
"""Square of (1 - g h²) / (3 g h²) + (1 - g) / (1 + 2 g) for quartz in sea water: density ratio
g = 2.58, speed ratio h = 3.99 (Johnson 1977)."""


@dataclass(frozen=True, slots=True)
class Matter:
    """Attributes.

    Attributes:
        db_per_m: one-way attenuation.
        strength: back scattering of a cubic metre, 1/m.
    """

    db_per_m: float
    strength: float


def cloud_matter(cloud: CloudSpec, sonar: SonarSettings, speed_mps: float) -> Matter:
    """What a cloud does at the sonar's frequency."""
    matter = cloud.matter
    if isinstance(matter, Bubbles):
        return bubble_matter(matter.radius_m, matter.per_m3)
    taken = sediment_db_per_m(sonar.frequency_hz, matter.kg_per_m3, matter.radius_m, speed_mps)
    sent = sediment_strength(sonar.frequency_hz, matter.kg_per_m3, matter.radius_m, speed_mps)
    return Matter(taken, sent)


def bubble_matter(radius_m: float, per_m3: float) -> Matter:
    """Bubbles far above their resonance (3.26 m/s over radius): spheres of geometric optics.

    4.34 n sigma_e dB/m with sigma_e = 2 pi a²; each sends back a² / 4.
    """
    taken = NEPER_POWER_DB * per_m3 * EXTINCTION * math.pi * radius_m**2
    return Matter(taken, per_m3 * radius_m**2 / 4.0)


def sediment_strength(
    frequency_hz: float, kg_per_m3: float, radius_m: float, speed_mps: float
) -> float:
    """Back scattering of a cubic metre with grains much smaller than the wavelength, 1/m.

    Rayleigh's law, a² (k a)^4 times the contrast of quartz (Johnson 1977), and no more than the
    geometric a² / 4 for large ones.
    """
    if kg_per_m3 <= 0.0:
        return 0.0
    per_m3 = kg_per_m3 / GRAIN_DENSITY / (4.0 / 3.0 * math.pi * radius_m**3)
    ka = 2.0 * math.pi * frequency_hz / speed_mps * radius_m
    return per_m3 * radius_m**2 * min(ka**4 * QUARTZ_CONTRAST, 0.25)
