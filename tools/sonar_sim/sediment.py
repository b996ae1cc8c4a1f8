"""Suspended grains of quartz: what they take from the sound, and what they send back."""

import math

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
