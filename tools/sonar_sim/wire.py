"""Pings as the bytes that a sonar sends, and as the pieces in which a network delivers them."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oculus_driver.encode import bearing_table_cdeg, encode_ping
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.scene.water import Water

SOURCE_ID = 750


@dataclass(frozen=True, slots=True)
class Network:
    """The way from the sonar to the host.

    Attributes:
        processing_s: from the last echo to the first byte's arrival, at least.
        jitter_s: mean of what comes on top, exponentially distributed.
        bits_per_s: rate of the link.
        segment_bytes: payload of one Ethernet frame; a read returns a whole number of them.
        max_segments: of one read.
    """

    processing_s: float = 0.003
    jitter_s: float = 0.001
    bits_per_s: float = 100e6
    segment_bytes: int = 1448
    max_segments: int = 44


def ping_message(
    image: NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.uint32],
    *,
    ping_id: int,
    start_time_s: float,
    heading_deg: float,
    sonar: SonarSettings,
    water: Water,
) -> bytes:
    """Encode one ping as a version 2 message.

    Args:
        image: (rows, beams).
        ping_id: counts up by one.
        start_time_s: transmission, seconds since power-up.
        heading_deg: compass heading, clockwise from north.
        sonar: settings to report.
        water: conditions to report.
    """
    message: bytes = encode_ping(
        version=2,
        ping_id=ping_id,
        mode=sonar.mode,
        frequency_hz=sonar.frequency_hz,
        range_m=sonar.demanded_range_m,
        gain_percent=sonar.gain_percent,
        speed_of_sound_mps=sonar.told_speed_mps or water.speed_of_sound_mps,
        salinity_ppt=water.salinity_ppt,
        start_time=start_time_s,
        range_resolution_m=sonar.range_resolution_m,
        bearings_cdeg=bearing_table_cdeg(sonar.beams, sonar.half_aperture_rad),
        image=image,
        source_id=SOURCE_ID,
        gamma=sonar.gamma_byte,
        temperature_c=water.temperature_c,
        heading_deg=heading_deg,
    )
    return message


def delivered(
    message: bytes, ready_s: float, network: Network, generator: np.random.Generator
) -> Iterator[tuple[float, bytes]]:
    """Cut a message into the pieces that successive reads return.

    Args:
        message: what the sonar sends.
        ready_s: when the last echo has come in.
        network: the way to the host.
        generator: chooses the pieces' sizes and the delay.

    Yields:
        Arrival time in seconds, never decreasing, and the piece.
    """
    time_s = ready_s + network.processing_s + network.jitter_s * generator.standard_exponential()
    start = 0
    while start < len(message):
        segments = int(generator.integers(1, network.max_segments + 1))
        piece = message[start : start + segments * network.segment_bytes]
        # A read returns when its last segment is there; the first one stamps the header.
        time_s += 8.0 * (len(piece) if start else network.segment_bytes) / network.bits_per_s
        yield time_s, piece
        start += len(piece)


def compass_heading_deg(rotation: NDArray[np.float64]) -> float:
    """Heading of a body's x axis in an east-north-up map, clockwise from north, 0 to 360."""
    east, north = float(rotation[0, 0]), float(rotation[1, 0])
    return math.degrees(math.atan2(east, north)) % 360.0
