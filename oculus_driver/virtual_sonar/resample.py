"""Converts a recorded ping to other settings.

The recorded echoes stay: rows are cut, padded with zeros or combined, beams and samples are
    repeated
or thinned. The number of rows follows measurements on real sonars: the row spacing is a base step
times a power of two, so that there are at most 720 rows.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from oculus_driver.encode import encode_ping
from oculus_driver.fan import CENTIDEGREE_RAD, bearing_table_cdeg
from oculus_driver.models import model_of
from oculus_driver.wire import EXTENDED_32_BIT, FIRE_V1, FIRE_V2, FireFlags

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oculus_driver.ping import Ping
    from oculus_driver.virtual_sonar.device import FireRequest

MAX_ROWS: Final = 720
_MIN_RANGE_M: Final = 0.1
_VERSION_2: Final = 2
_U32: Final = struct.Struct("<I")

GARBAGE_PING_RATE: Final = 195
"""Real firmware echoes an undefined value here; captures contain this one."""

GARBAGE_NETWORK_SPEED: Final = 25
"""Real firmware echoes this value for any request."""


def resample_ping(ping: Ping, request: FireRequest, part_number: int) -> bytes:
    """Return the ping as a message with the requested range, beams, samples and version."""
    range_m = requested_range_m(request, part_number)
    image, step_m, gains = _rows(ping, range_m)
    bearings_cdeg, image = _beams(ping, image, 512 if request.flags & FireFlags.FULL_BEAMS else 256)
    data = encode_ping(
        version=request.version,
        ping_id=ping.ping_id,
        mode=request.mode,
        frequency_hz=ping.frequency_hz,
        range_m=request.range_demand,
        gain_percent=request.gain_percent,
        speed_of_sound_mps=request.speed_of_sound_demand_mps or ping.speed_of_sound_mps,
        salinity_ppt=request.salinity_ppt,
        start_time=_start_time(ping, request.version),
        range_resolution_m=step_m,
        bearings_cdeg=bearings_cdeg,
        image=_samples(image, ping.bits_per_sample, requested_bits(request)),
        gains=gains if request.flags & FireFlags.SEND_GAIN else None,
        source_id=ping.source_id,
        part_number=ping.part_number,
        flags=request.flags,
        gamma=request.gamma,
        temperature_c=ping.temperature_c or 0.0,
        pressure_bar=ping.pressure_bar or 0.0,
    )
    return with_settings_echo(data, request)


def requested_range_m(request: FireRequest, part_number: int) -> float:
    """Return the range in metres, limited to the model's range."""
    wide, narrow = model_of(part_number).family.max_range_m
    largest = wide if request.mode == 1 or narrow is None else narrow
    asked = request.range_demand
    if not request.flags & FireFlags.RANGE_IN_METRES:
        asked *= largest / 100.0
    return min(max(_MIN_RANGE_M, asked), largest)  # in this order NaN gives the minimum


def _rows(ping: Ping, range_m: float) -> tuple[NDArray[Any], float, NDArray[np.uint32]]:
    together = 1
    while range_m / (ping.range_resolution_m * together) > MAX_ROWS:
        together *= 2
    step_m = ping.range_resolution_m * together
    rows = max(1, round(range_m / step_m))
    kept = ping.image[: rows * together]
    image = np.zeros((rows * together, ping.beams), dtype=kept.dtype)
    image[: len(kept)] = kept
    gains = np.ones(rows, dtype=np.uint32)
    if ping.gains is not None:
        known = ping.gains[: rows * together : together]
        gains[: len(known)] = known
    return image.reshape(rows, together, ping.beams).max(axis=1), step_m, gains


def _beams(ping: Ping, image: NDArray[Any], beams: int) -> tuple[NDArray[np.int16], NDArray[Any]]:
    if beams == ping.beams:
        return np.rint(ping.bearings_rad / CENTIDEGREE_RAD).astype(np.int16), image
    nearest = np.rint(np.linspace(0, ping.beams - 1, beams)).astype(np.intp)
    half_rad = float(np.clip(np.abs(ping.bearings_rad).max(), 1e-3, np.pi / 2))
    return bearing_table_cdeg(beams, half_rad), image[:, nearest]


def requested_bits(request: FireRequest) -> int:
    """Return the requested bits per sample."""
    if request.version == _VERSION_2 and request.extended_flags & EXTENDED_32_BIT:
        return 32
    return 16 if request.flags & FireFlags.SIXTEEN_BIT else 8


def _samples(image: NDArray[Any], have: int, want: int) -> NDArray[Any]:
    whole = image.astype(np.uint64)
    if want < have:
        whole >>= np.uint64(have - want)
    else:
        whole *= np.uint64(((1 << want) - 1) // ((1 << have) - 1))
    return whole.astype(f"u{want // 8}")


def _start_time(ping: Ping, version: int) -> float:
    """Return seconds (version 2) or ticks of 8 ns (version 1), whichever clock was recorded."""
    if version == _VERSION_2:
        known = ping.start_time_s
        return known if known is not None else (ping.start_ticks or 0) * 8e-9
    if ping.start_ticks is not None:
        return float(ping.start_ticks)
    return float(round((ping.start_time_s or 0.0) / 8e-9))


def with_settings_echo(data: bytes, request: FireRequest) -> bytes:
    """Return a ping with the firmware's echo of a fire message, including its undefined values."""
    changed = bytearray(data)
    changed[FIRE_V1.offset_of("ping_rate")] = GARBAGE_PING_RATE
    changed[FIRE_V1.offset_of("network_speed_mbps")] = GARBAGE_NETWORK_SPEED
    if request.version == _VERSION_2:
        _U32.pack_into(changed, FIRE_V2.offset_of("extended_flags"), request.extended_flags)
    return bytes(changed)
