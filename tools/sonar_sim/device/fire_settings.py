"""Converts fire messages to a sonar's settings, and computes its ping period."""

import math
from dataclasses import replace

from oculus_driver.models import MAX_RATE_HZ, MODELS
from oculus_driver.virtual_sonar.device import FireRequest
from oculus_driver.virtual_sonar.resample import requested_bits, requested_range_m
from oculus_driver.wire import FireFlags, PingRate
from sonar_sim.errors import SceneError
from sonar_sim.scene.sonar import SonarSettings, sonar_preset
from sonar_sim.scene.water import Water

FULL_BEAMS, HALF_BEAMS = 512, 256
BITS_32 = 32
SPEEDS_MPS = (1300.0, 1700.0)
MAX_SALT_PPT = 42.0
LINK_SPEED = (0, 255)
"""Link speed bytes that mean the speed of the link."""

OF_ALL_MODES = (
    "side_lobe_db",
    "source_level_db",
    "array_gain_db",
    "noise_excess_db",
    "tvg_spreading_log",
    "forced_rows",
    "max_rows",
    "pulse_s",
    "crosstalk_db",
    "ring_down_db",
    "dynamic_focus",
)
"""Settings that all modes of a scenario's sonar share and fire messages lack."""

PROCESSING_S = 0.002
"""Time between the last echo and the first byte."""


def part_number_of(model: str) -> int:
    """Return the part number of a model's plain version.

    Raises:
        SceneError: the model is unknown.
    """
    for number, known in MODELS.items():
        if known.name == model:
            return number
    raise SceneError(
        f"sonar: a {model} does not speak the Oculus protocol and cannot be served; render it, or "
        "choose an Oculus, such as the M750d"
    )


def initial_request(sonar: SonarSettings, ping_rate_hz: float) -> FireRequest:
    """Return the initial fire request with the scenario's settings.

    Args:
        sonar: the scenario's sonar.
        ping_rate_hz: the slowest rate setting that allows it is used.
    """
    flags = FireFlags.RANGE_IN_METRES | FireFlags.SIMPLE_RETURN
    flags |= FireFlags.FULL_BEAMS if sonar.beams > HALF_BEAMS else 0
    flags |= FireFlags.SIXTEEN_BIT if sonar.bits > 8 else 0  # noqa: PLR2004 bits of a byte
    allowing = [rate for rate, max_hz in MAX_RATE_HZ.items() if max_hz >= ping_rate_hz]
    return FireRequest(
        mode=sonar.mode,
        ping_rate=min(allowing, key=MAX_RATE_HZ.__getitem__, default=PingRate.HIGHEST),
        gamma=sonar.gamma_byte,
        flags=flags,
        range_demand=sonar.demanded_range_m,
        gain_percent=sonar.gain_percent,
        extended_flags=0x200 if sonar.bits == BITS_32 else 0,
    )


def settings_for(demand: FireRequest, sonar: SonarSettings, water: Water) -> SonarSettings:
    """Return the sonar's settings after a fire message.

    Ranges are limited to those of the mode and are at least one row, and an unknown mode means the
    first one; the firmware's behaviour in these cases is not documented.

    Args:
        demand: the fire message.
        sonar: the scenario's sonar; settings that fire messages lack stay.
        water: gives the speed of sound if the sonar computes it.
    """
    part = part_number_of(sonar.model)
    mode = demand.mode if _has_mode(sonar.model, demand.mode) else 1
    base = sonar
    if mode != sonar.mode:
        kept = {name: getattr(sonar, name) for name in OF_ALL_MODES}
        base = sonar_preset(sonar.model, mode, **kept)
    range_m = min(requested_range_m(replace(demand, mode=mode), part), base.max_range_m)
    if base.forced_rows is None:
        range_m = max(range_m, base.base_row_m)
    gain = demand.gain_percent if math.isfinite(demand.gain_percent) else base.gain_percent
    return replace(
        base,
        demanded_range_m=range_m,
        beams=FULL_BEAMS if demand.flags & FireFlags.FULL_BEAMS else HALF_BEAMS,
        gain_percent=min(max(gain, 0.0), 100.0),
        gamma_byte=demand.gamma,
        bits=requested_bits(demand),
        told_speed_mps=_assumed_speed_mps(demand, water),
    )


def period_s(demand: FireRequest, sonar: SonarSettings, water: Water, message_bytes: int) -> float:
    """Return the ping period: limited by the rate, the two-way travel time, and the network.

    Args:
        demand: the fire message.
        sonar: the resulting settings.
        water: water of the scene.
        message_bytes: size of a ping.
    """
    known = demand.ping_rate in set(MAX_RATE_HZ)
    rate_hz = MAX_RATE_HZ[PingRate(demand.ping_rate)] if known else MAX_RATE_HZ[PingRate.NORMAL]
    waits = [0.0 if demand.triggered or not rate_hz else 1.0 / rate_hz]
    waits.append(listening_s(sonar, water) + PROCESSING_S)
    if demand.network_speed_mbps not in LINK_SPEED:
        waits.append(8e-6 * message_bytes / demand.network_speed_mbps)
    return max(waits)


def listening_s(sonar: SonarSettings, water: Water) -> float:
    """Return the time until the last echo arrives."""
    return 2.0 * sonar.range_m / water.speed_of_sound_mps


def _has_mode(model: str, mode: int) -> bool:
    try:
        sonar_preset(model, mode)
    except SceneError:
        return False
    return True


def _assumed_speed_mps(demand: FireRequest, water: Water) -> float | None:
    """Return the assumed speed of sound: as set, or by the set salinity; None is the true one."""
    slowest_mps, fastest_mps = SPEEDS_MPS
    if slowest_mps <= demand.speed_of_sound_demand_mps <= fastest_mps:
        return demand.speed_of_sound_demand_mps
    if demand.salinity_ppt == water.salinity_ppt or not 0 <= demand.salinity_ppt <= MAX_SALT_PPT:
        return None
    return replace(water, salinity_ppt=demand.salinity_ppt, profile=None).speed_of_sound_mps
