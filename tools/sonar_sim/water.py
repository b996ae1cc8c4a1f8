"""What the water does to sound: speed, absorption, thermal noise."""

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Water:
    """Water of one temperature, salinity and acidity, as the sound meets it at one depth."""

    temperature_c: float = 10.0
    salinity_ppt: float = 35.0
    depth_m: float = 5.0
    acidity_ph: float = 8.0

    @property
    def speed_of_sound_mps(self) -> float:
        """Speed of sound by Medwin (1975), which holds for sea and, within 0.7 m/s, fresh water."""
        t, s, d = self.temperature_c, self.salinity_ppt, self.depth_m
        return (
            1449.2
            + 4.6 * t
            - 0.055 * t**2
            + 0.00029 * t**3
            + (1.34 - 0.010 * t) * (s - 35.0)
            + 0.016 * d
        )

    def absorption_db_per_m(self, frequency_hz: float) -> float:
        """One-way absorption by Francois and Garrison (1982).

        Stated validity ends at 1 MHz; above, this is their formula carried on.

        Args:
            frequency_hz: acoustic frequency.

        Returns:
            Loss in dB per metre of path.
        """
        f = frequency_hz / 1e3
        boric = self._boric_acid(f)
        magnesium = self._magnesium_sulphate(f)
        return (boric + magnesium + self._pure_water(f)) / 1e3

    def _formula_speed(self) -> float:
        """The sound speed that belongs to the absorption formula's own fit, m/s."""
        t, s, d = self.temperature_c, self.salinity_ppt, self.depth_m
        return 1412.0 + 3.21 * t + 1.19 * s + 0.0167 * d

    def _boric_acid(self, f_khz: float) -> float:
        t, s = self.temperature_c, self.salinity_ppt
        strength = 8.86 / self._formula_speed() * math.pow(10.0, 0.78 * self.acidity_ph - 5.0)
        relaxation = 2.8 * math.sqrt(s / 35.0) * math.pow(10.0, 4.0 - 1245.0 / (273.0 + t))
        return strength * relaxation * f_khz**2 / (f_khz**2 + relaxation**2)

    def _magnesium_sulphate(self, f_khz: float) -> float:
        t, s, d = self.temperature_c, self.salinity_ppt, self.depth_m
        strength = 21.44 * s / self._formula_speed() * (1.0 + 0.025 * t)
        pressure = 1.0 - 1.37e-4 * d + 6.2e-9 * d**2
        relaxation = 8.17 * math.pow(10.0, 8.0 - 1990.0 / (273.0 + t))
        relaxation /= 1.0 + 0.0018 * (s - 35.0)
        return strength * pressure * relaxation * f_khz**2 / (f_khz**2 + relaxation**2)

    def _pure_water(self, f_khz: float) -> float:
        t, d = self.temperature_c, self.depth_m
        if t <= 20.0:  # noqa: PLR2004 the paper fits two polynomials that meet here
            strength = 4.937e-4 - 2.59e-5 * t + 9.11e-7 * t**2 - 1.50e-8 * t**3
        else:
            strength = 3.964e-4 - 1.146e-5 * t + 1.45e-7 * t**2 - 6.5e-10 * t**3
        pressure = 1.0 - 3.83e-5 * d + 4.9e-10 * d**2
        return strength * pressure * f_khz**2


def thermal_noise_db(frequency_hz: float, bandwidth_hz: float) -> float:
    """Noise of the water's own thermal motion, which governs above about 100 kHz.

    Returns:
        Level in the band, dB re 1 µPa, at one omnidirectional element (Mellen's formula).
    """
    spectrum_db = -15.0 + 20.0 * math.log10(frequency_hz / 1e3)
    return spectrum_db + 10.0 * math.log10(bandwidth_hz)
