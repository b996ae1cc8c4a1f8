"""Correct the ranges of pings that were made with a wrong speed of sound.

A sonar measures times and multiplies them by a speed of sound, so with a wrong one all ranges are
wrong by the same factor. Times stay: those of the echoes, too.
"""

from dataclasses import replace

from mapperd.config.device import WaterConfig
from oculus_driver.ping import Ping
from oculus_driver.sound_speed import SALINITY_LIMITS_PPT, TEMPERATURE_LIMITS_C, speed_of_sound_mps

__all__ = ["corrected_ranges", "true_speed_mps"]

HALVINGS = 40
"""Of 40 °C: the temperature is exact to 1e-10 °C."""


def corrected_ranges(ping: Ping, water: WaterConfig) -> Ping:
    """Return a ping whose ranges hold for the speed of sound of this water.

    Args:
        ping: as the sonar sent it.
        water: the true water; without `correct_ranges` the ping is returned unchanged.
    """
    if not water.correct_ranges:
        return ping
    used_mps = ping.credible_speed_of_sound_mps
    true_mps = true_speed_mps(water, used_mps, ping.salinity_ppt)
    if true_mps == used_mps:
        return ping
    return replace(
        ping,
        range_resolution_m=ping.range_resolution_m * (true_mps / used_mps),
        speed_of_sound_mps=true_mps,
    )


def true_speed_mps(water: WaterConfig, used_mps: float, used_ppt: float) -> float:
    """Return the speed of sound in the water, m/s.

    It is the measured one, or computed from the measured temperature, or, from the salinity alone,
    at the temperature at which the sonar's speed holds for the sonar's salinity. Where no
    temperature between 0 and 40 °C explains the sonar's speed, the nearer end is used.

    Args:
        water: the true water.
        used_mps: speed of sound used by the sonar.
        used_ppt: salinity used by the sonar; other values than 0 to 40 change nothing.
    """
    if water.speed_of_sound:
        return water.speed_of_sound
    if water.temperature:
        return speed_of_sound_mps(water.temperature, water.salinity)
    low_ppt, high_ppt = SALINITY_LIMITS_PPT
    if not low_ppt <= used_ppt <= high_ppt or used_ppt == water.salinity:
        return used_mps
    temperature_c = _temperature_c(used_mps, used_ppt)
    factor = speed_of_sound_mps(temperature_c, water.salinity) / speed_of_sound_mps(
        temperature_c, used_ppt
    )
    return used_mps * factor


def _temperature_c(speed_mps: float, salinity_ppt: float) -> float:
    """Return the temperature of a speed of sound, which rises with it from 0 to 40 °C."""
    low_c, high_c = TEMPERATURE_LIMITS_C
    for _ in range(HALVINGS):
        middle_c = (low_c + high_c) / 2
        if speed_of_sound_mps(middle_c, salinity_ppt) < speed_mps:
            low_c = middle_c
        else:
            high_c = middle_c
    return (low_c + high_c) / 2
