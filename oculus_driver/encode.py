"""Encode messages with the layouts that the parser decodes with."""

from __future__ import annotations

from ipaddress import IPv4Address
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from oculus_driver.errors import EncodeError
from oculus_driver.fan import bearing_table_cdeg
from oculus_driver.wire import (
    DUMMY,
    FIRE_V1,
    FIRE_V2,
    HEADER,
    PING_RESULT_V1,
    PING_RESULT_V2,
    STATUS,
    USER_CONFIG,
    FireFlags,
    MessageId,
    PingRate,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from oculus_driver.wire import Layout

__all__ = [
    "bearing_table_cdeg",
    "encode_dummy",
    "encode_fire",
    "encode_ping",
    "encode_status",
    "encode_user_config",
]

IMAGE_OFFSET: Final = 2048
"""Image offset of real version-1 sonars. A longer bearing table moves the image back."""

_GAIN_WORD: Final = 4
_VERSION_2: Final = 2
_SMALL_FAN: Final = 256
_BITS_24: Final = 3


def encode_fire(
    *,
    version: int = 2,
    mode: int = 1,
    ping_rate: int = PingRate.NORMAL,
    network_speed_mbps: int = 255,
    gamma: int = 255,
    flags: int = 0x4D,
    range_demand: float = 10.0,
    gain_percent: float = 50.0,
    speed_of_sound_demand_mps: float = 0.0,
    salinity_ppt: float = 35.0,
    extended_flags: int = 0,
    source_id: int = 0,
    destination_id: int = 0,
) -> bytes:
    """Return a simple fire message, 53 bytes (version 0 or 1) or 89 bytes (version 2).

    If bit 0 of `flags` is set, `range_demand` is in metres, otherwise in percent of the mode's
    maximum. With a speed of sound of 0 the sonar computes it.

    Raises:
        EncodeError: a value does not fit its field, or version 1 is given extended flags.
    """
    layout = FIRE_V2 if version == _VERSION_2 else FIRE_V1
    values: dict[str, Any] = {
        "mode": mode,
        "ping_rate": int(ping_rate),
        "network_speed_mbps": network_speed_mbps,
        "gamma": gamma,
        "flags": int(flags),
        "range_demand": range_demand,
        "gain_percent": gain_percent,
        "speed_of_sound_demand_mps": speed_of_sound_demand_mps,
        "salinity_ppt": salinity_ppt,
    }
    if extended_flags or layout is FIRE_V2:
        values["extended_flags"] = extended_flags
    return _message(
        layout, MessageId.FIRE, version, values, source_id=source_id, destination_id=destination_id
    )


def encode_dummy(*, source_id: int = 0, destination_id: int = 0, version: int = 0) -> bytes:
    """Return a dummy message, 16 bytes. A sonar in standby sends it instead of pings."""
    return _message(
        DUMMY, MessageId.DUMMY, version, {}, source_id=source_id, destination_id=destination_id
    )


def encode_user_config(
    *,
    address: IPv4Address | str | None = None,
    netmask: IPv4Address | str | None = None,
    dhcp: bool = False,
    source_id: int = 0,
) -> bytes:
    """Return a user configuration message, 28 bytes. Without an address it is a query."""
    values = {
        "address": int(IPv4Address(address or 0)),
        "netmask": int(IPv4Address(netmask or 0)),
        "dhcp": int(dhcp),
    }
    return _message(USER_CONFIG, MessageId.USER_CONFIG, 0, values, source_id=source_id)


def encode_status(
    *,
    device_id: int,
    part_number: int = 1032,
    status_bits: int = 0x03,
    arm0_version: int = 0,
    arm0_date: int = 0,
    arm1_version: int = 0,
    arm1_date: int = 0,
    fpga_version: int = 0,
    fpga_date: int = 0,
    address: IPv4Address | str = "127.0.0.1",
    netmask: IPv4Address | str = "255.255.255.0",
    client_address: IPv4Address | str | None = None,
    mac: bytes = bytes(6),
    temperatures_c: Sequence[float] = (0.0,) * 8,
    pressure_bar: float = 0.0,
) -> bytes:
    """Return a status datagram, 142 bytes. A sonar broadcasts one about once per second.

    Raises:
        EncodeError: a value does not fit its field, or there are not eight temperatures.
    """
    values = {
        "device_id": device_id,
        "device_type": 1,
        "device_part_number": part_number,
        "status_bits": status_bits,
        "arm0_version": arm0_version,
        "arm0_date": arm0_date,
        "arm1_version": arm1_version,
        "arm1_date": arm1_date,
        "fpga_version": fpga_version,
        "fpga_date": fpga_date,
        "address": IPv4Address(address).packed,
        "netmask": IPv4Address(netmask).packed,
        "client_address": IPv4Address(client_address or 0).packed,
        "mac": mac,
        "temperatures_c": tuple(temperatures_c),
        "pressure_bar": pressure_bar,
        "part_number": part_number,
    }
    return _message(
        STATUS, MessageId.STATUS, 1, values, source_id=device_id & 0xFFFF, destination_id=0xFFFF
    )


def encode_ping(
    *,
    version: int = 2,
    ping_id: int,
    mode: int,
    frequency_hz: float,
    range_m: float,
    gain_percent: float,
    speed_of_sound_mps: float,
    salinity_ppt: float,
    start_time: float,
    range_resolution_m: float,
    bearings_cdeg: NDArray[np.int16],
    image: NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.uint32],
    data_size: int | None = None,
    gains: NDArray[np.uint32] | None = None,
    source_id: int = 0,
    part_number: int = 1032,
    flags: int | None = None,
    gamma: int = 255,
    temperature_c: float = 0.0,
    pressure_bar: float = 0.0,
    heading_deg: float = 0.0,
    pitch_deg: float = 0.0,
    roll_deg: float = 0.0,
    status: int = 0,
) -> bytes:
    """Return a simple ping result, as a sonar sends it.

    Args:
        version: 2, or 0 or 1 for the version-1 layout, which has no attitude.
        ping_id: see `oculus_driver.wire`, as for all arguments without a description here.
        mode: master mode.
        frequency_hz: acoustic frequency.
        range_m: requested range.
        gain_percent: gain.
        speed_of_sound_mps: speed of sound used by the sonar.
        salinity_ppt: salinity.
        start_time: seconds since power-up (version 2) or clock ticks (version 1).
        range_resolution_m: depth of one row.
        bearings_cdeg: int16 (beams,), hundredths of a degree, positive to starboard.
        image: unsigned (rows, beams), nearest row first.
        data_size: bytes per sample, 1 to 4; None: as in the image. 3 packs uint32 into 24 bits.
        gains: uint32 (rows,), written in front of the rows; None: no gain words.
        source_id: low 16 bits of the device id.
        part_number: of the sonar.
        flags: echo of the fire flags; None: the flags that match the image.
        gamma: exponent gamma/255 of the image.
        temperature_c: of the water.
        pressure_bar: of the water.
        heading_deg: of the sonar.
        pitch_deg: of the sonar.
        roll_deg: of the sonar.
        status: raw status word.

    Raises:
        EncodeError: the shapes of the arrays do not match, or a value does not fit its field.
    """
    width = image.dtype.itemsize if data_size is None else data_size
    beams = _check_arrays(bearings_cdeg, image, width, gains)
    layout = PING_RESULT_V2 if version == _VERSION_2 else PING_RESULT_V1
    table = np.ascontiguousarray(bearings_cdeg, dtype="<i2").tobytes()
    body = _image_bytes(image, width, gains)
    image_offset = max(IMAGE_OFFSET, layout.size + len(table))
    values: dict[str, Any] = {
        "mode": mode,
        "gamma": gamma,
        "flags": _flags(width, beams, gains) if flags is None else int(flags),
        "range_demand": range_m,
        "gain_percent": gain_percent,
        "speed_of_sound_demand_mps": speed_of_sound_mps,
        "salinity_ppt": salinity_ppt,
        "ping_id": ping_id,
        "status": status,
        "frequency_hz": frequency_hz,
        "temperature_c": temperature_c,
        "pressure_bar": pressure_bar,
        "speed_of_sound_mps": speed_of_sound_mps,
        "data_size": width - 1,
        "range_resolution_m": range_resolution_m,
        "rows": image.shape[0],
        "beams": beams,
        "image_offset": image_offset,
        "image_size": len(body),
        "message_size": image_offset + len(body),
        "part_number": part_number,
        "payload_size": image_offset + len(body) - HEADER.size,
    }
    if layout is PING_RESULT_V2:
        values["start_time_s"] = float(start_time)
        values |= {"heading_deg": heading_deg, "pitch_deg": pitch_deg, "roll_deg": roll_deg}
    else:
        values["start_ticks"] = int(start_time) & 0xFFFFFFFF
    fixed = _message(layout, MessageId.PING_RESULT, version, values, source_id=source_id)
    gap = bytes(image_offset - len(fixed) - len(table))
    return b"".join((fixed, table, gap, body))


def _message(
    layout: Layout,
    message_id: int,
    version: int,
    values: dict[str, Any],
    *,
    source_id: int = 0,
    destination_id: int = 0,
) -> bytes:
    if not 0 <= version <= _VERSION_2:
        raise EncodeError(f"there is no message layout of version {version}")
    header = {
        "message_id": int(message_id),
        "version": version,
        "payload_size": layout.size - HEADER.size,
        "source_id": source_id,
        "destination_id": destination_id,
    }
    return layout.pack(header | values)


def _flags(width: int, beams: int, gains: NDArray[np.uint32] | None) -> int:
    flags = FireFlags.RANGE_IN_METRES | FireFlags.SIMPLE_RETURN
    if width > 1:
        flags |= FireFlags.SIXTEEN_BIT
    if gains is not None:
        flags |= FireFlags.SEND_GAIN
    if beams > _SMALL_FAN:
        flags |= FireFlags.FULL_BEAMS
    return int(flags)


def _check_arrays(
    bearings_cdeg: NDArray[np.int16],
    image: NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.uint32],
    width: int,
    gains: NDArray[np.uint32] | None,
) -> int:
    """Return the number of beams. Raise EncodeError if the arrays do not match."""
    rows, beams = image.shape
    if bearings_cdeg.shape != (beams,):
        raise EncodeError(f"{beams} beams, but bearings of shape {bearings_cdeg.shape}")
    if image.dtype.kind != "u" or width not in (1, 2, 3, 4):
        raise EncodeError(f"cannot encode {image.dtype} as samples of {width} bytes")
    if gains is not None and gains.shape != (rows,):
        raise EncodeError(f"{rows} rows, but gains of shape {gains.shape}")
    if image.dtype.itemsize > width and image.size and int(image.max()) >> (8 * width):
        raise EncodeError(f"a sample does not fit into {width} bytes")
    return int(beams)


def _image_bytes(
    image: NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.uint32],
    width: int,
    gains: NDArray[np.uint32] | None,
) -> bytes:
    rows, beams = image.shape
    whole = np.ascontiguousarray(image, dtype="<u4" if width == _BITS_24 else f"<u{width}")
    samples = whole.view(np.uint8).reshape(rows, beams, -1)[:, :, :width]
    if gains is None:
        return samples.tobytes()
    lines = np.empty((rows, _GAIN_WORD + beams * width), dtype=np.uint8)
    words = np.ascontiguousarray(gains, dtype="<u4").view(np.uint8)
    lines[:, :_GAIN_WORD] = words.reshape(rows, _GAIN_WORD)
    lines[:, _GAIN_WORD:] = samples.reshape(rows, beams * width)
    return lines.tobytes()
