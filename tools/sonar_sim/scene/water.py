"""What the water does to sound: speed, absorption, thermal noise."""

import itertools
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sonar_sim.errors import SceneError

MIN_SPEED_MPS, MAX_SPEED_MPS = 1300.0, 1700.0
"""Of any water that a vehicle dives in."""


@dataclass(frozen=True, slots=True)
class Water:
    """Water of one temperature, salinity and acidity, as the sound meets it at one depth.

    Attributes:
        temperature_c: 0 to 40.
        salinity_ppt: 0 (fresh) to 45.
        depth_m: where the formulas are taken.
        acidity_ph: pH.
        absorption_model: whose formula. Above 1 MHz both are carried on beyond their measurements,
            and their difference, some 8 %, is what is not known.
        profile: speed of sound over depth, pairs (depth_m, speed_mps) of increasing depth, linear
            between them and constant beyond; None is `speed_of_sound_mps` everywhere.
        sediment_kg_per_m3, sediment_radius_m: quartz in suspension, everywhere.
        volume_strength_db: back scattering strength of the water, dB re 1/m: clear -90 to -80,
            coastal -75 to -65, turbid or full of plankton -60 to -50.
        reverberation_db: energy that echoes leave behind them in each metre of range, by scattering
            several times between floor, surface and walls, dB re 1/m of their own. As fitted to a
            public recording of a floor.
        reverberation_decay_db_per_m: by which that tail fades.
    """

    temperature_c: float = 10.0
    salinity_ppt: float = 35.0
    depth_m: float = 5.0
    acidity_ph: float = 8.0
    absorption_model: Literal["francois_garrison", "ainslie_mccolm"] = "francois_garrison"
    profile: tuple[tuple[float, float], ...] | None = None
    sediment_kg_per_m3: float = 0.0
    sediment_radius_m: float = 5e-6
    volume_strength_db: float = -80.0
    reverberation_db: float = -18.5
    reverberation_decay_db_per_m: float = 14.0

    def __post_init__(self) -> None:
        if self.profile is None:
            return
        if not self.profile:
            raise SceneError("a profile of sound speed needs at least one depth")
        if any(above[0] >= below[0] for above, below in itertools.pairwise(self.profile)):
            raise SceneError("the depths of a profile of sound speed must increase")
        if not all(MIN_SPEED_MPS <= speed_mps <= MAX_SPEED_MPS for _, speed_mps in self.profile):
            raise SceneError(
                f"a profile of sound speed holds a speed outside of {MIN_SPEED_MPS:g} to "
                f"{MAX_SPEED_MPS:g} m/s: outside the range of water"
            )

    @property
    def speed_of_sound_mps(self) -> float:
        """Speed of sound at `depth_m`: the profile's, or Medwin's."""
        return self.speed_at_mps(self.depth_m)

    def speed_at_mps(self, depth_m: float) -> float:
        """Speed of sound at a depth; without a profile `depth_m` stands for all depths."""
        if self.profile is None:
            return self.medwin_mps
        depths_m, speeds_mps = zip(*self.profile, strict=True)
        return float(np.interp(depth_m, depths_m, speeds_mps))

    @property
    def largest_gradient_per_s(self) -> float:
        """Largest change of the speed of sound with depth, 1/s, unsigned."""
        pairs = itertools.pairwise(self.profile or ())
        return max((abs((c2 - c1) / (d2 - d1)) for (d1, c1), (d2, c2) in pairs), default=0.0)

    @property
    def medwin_mps(self) -> float:
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
        """One-way absorption by the chosen model; without sediment.

        Args:
            frequency_hz: acoustic frequency.

        Returns:
            Loss in dB per metre of path.
        """
        if self.absorption_model == "ainslie_mccolm":
            return self.ainslie_mccolm_db_per_m(frequency_hz)
        return self.francois_garrison_db_per_m(frequency_hz)

    def ainslie_mccolm_db_per_m(self, frequency_hz: float) -> float:
        """One-way absorption by Ainslie and McColm (1998), dB/m."""
        f, t, s = frequency_hz / 1e3, self.temperature_c, self.salinity_ppt
        depth_km = self.depth_m / 1e3
        boron = 0.78 * math.sqrt(s / 35.0) * math.exp(t / 26.0)
        magnesium = 42.0 * math.exp(t / 17.0)
        boric = 0.106 * math.exp((self.acidity_ph - 8.0) / 0.56) * _relaxing(f, boron)
        sulphate = 0.52 * (1.0 + t / 43.0) * s / 35.0 * math.exp(-depth_km / 6.0)
        pure = 0.00049 * math.exp(-(t / 27.0 + depth_km / 17.0)) * f**2
        return (boric + sulphate * _relaxing(f, magnesium) + pure) / 1e3

    def francois_garrison_db_per_m(self, frequency_hz: float) -> float:
        """One-way absorption by Francois and Garrison (1982), dB/m.

        Stated validity ends at 1 MHz; above, this is their formula carried on.
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
        return strength * _relaxing(f_khz, relaxation)

    def _magnesium_sulphate(self, f_khz: float) -> float:
        t, s, d = self.temperature_c, self.salinity_ppt, self.depth_m
        strength = 21.44 * s / self._formula_speed() * (1.0 + 0.025 * t)
        pressure = 1.0 - 1.37e-4 * d + 6.2e-9 * d**2
        relaxation = 8.17 * math.pow(10.0, 8.0 - 1990.0 / (273.0 + t))
        relaxation /= 1.0 + 0.0018 * (s - 35.0)
        return strength * pressure * _relaxing(f_khz, relaxation)

    def _pure_water(self, f_khz: float) -> float:
        t, d = self.temperature_c, self.depth_m
        if t <= 20.0:  # noqa: PLR2004 the paper fits two polynomials that meet here
            strength = 4.937e-4 - 2.59e-5 * t + 9.11e-7 * t**2 - 1.50e-8 * t**3
        else:
            strength = 3.964e-4 - 1.146e-5 * t + 1.45e-7 * t**2 - 6.5e-10 * t**3
        pressure = 1.0 - 3.83e-5 * d + 4.9e-10 * d**2
        return strength * pressure * f_khz**2


def _relaxing(f_khz: float, relaxation_khz: float) -> float:
    """A relaxing molecule's share of the absorption, by frequency."""
    return relaxation_khz * f_khz**2 / (f_khz**2 + relaxation_khz**2)


def thermal_noise_db(frequency_hz: float, bandwidth_hz: float) -> float:
    """Noise of the water's own thermal motion, which governs above about 100 kHz.

    Returns:
        Level in the band, dB re 1 µPa, at one omnidirectional element (Mellen's formula).
    """
    spectrum_db = -15.0 + 20.0 * math.log10(frequency_hz / 1e3)
    return spectrum_db + 10.0 * math.log10(bandwidth_hz)
