"""Streams of a vehicle and its sonar in each format: chunks between which a dive is cut."""

import json
import math
import zlib
from collections.abc import Callable, Iterator
from typing import Any

from mapperd.odometry.native import (
    NativeRecord,
    encode_native,
    encode_native_json,
    encode_native_serial,
)
from oculus_driver.recording import Chunk
from tests.mapperd.conftest import make_ping
from tests.support.peers.autopilot import Autopilot
from tests.support.peers.dvl import Dvl
from tests.support.peers.misbehaviour import Misbehaviour
from tests.support.peers.nmea_talker import NmeaTalker, sentence

T0_NS = 1_700_000_000 * 10**9
STEPS = 40
STEP_S = 0.1


def native(k: int) -> NativeRecord:
    """A record of a vehicle that turns as it drives; it jumps once."""
    half = 0.02 * k
    jump = 8.0 if k > STEPS // 2 else 0.0
    return NativeRecord(
        v=1,
        clk="boot",
        w="ned",
        b="frd",
        t=round((50 + STEP_S * k) * 1e9),
        p=(0.1 * k + jump, 0.02 * k, 1.0),
        q=(math.cos(half), 0.0, 0.0, math.sin(half)),
        u=(1.0, 0.2, 0.0),
        r=(0.0, 0.0, 0.4),
        a=(0.0, 0.0, -9.8),
        pc=tuple(0.01 * (i + 1) if i in (0, 6, 11, 15, 18, 20) else 0.001 for i in range(21)),
        src="rov",
    )


def mavlink() -> Iterator[bytes]:
    autopilot = Autopilot()
    for k in range(STEPS):
        autopilot.boot_ms = 5000 + round(1000 * STEP_S * k)
        yield autopilot.heartbeat()
        yield autopilot.attitude((0.01 * k, 0.02, 0.03 * k), (0.1, 0.0, 0.3))
        yield autopilot.local_position((0.1 * k, 0.05 * k, 2.0), (1.0, 0.5, 0.0))
        yield autopilot.pressure(1500.0 + k)
        if k % 7 == 3:
            yield autopilot.odometry(x=0.1 * k)


def nmea() -> Iterator[bytes]:
    for k in range(STEPS):
        talker = NmeaTalker(time=f"22{13 + k // 600:02d}{20 + STEP_S * k:05.2f}")
        yield talker.gga((f"4807.{38 + k:04d}", "N"))
        yield talker.hdt(f"{30 + k}.0")
        yield sentence(f"PRDID,{-1.5 + 0.1 * k:.2f},2.00,{30 + k}.00")


def dvl(*, serial: bool) -> Iterator[bytes]:
    for k in range(STEPS):
        device = Dvl(unix_us=1_700_000_000_000_000 + round(1e6 * STEP_S * k), latency_us=20_000)
        if serial:
            yield device.velocity_sentence((0.5, 0.01 * k, 0.0), valid=k % 9 != 4)
            yield device.position_sentence((0.05 * k, 0.0, 1.0), (0, 0, 0.5 * k))
        else:
            yield device.velocity((0.5, 0.01 * k, 0.0), velocity_valid=k % 9 != 4)
            yield device.position((0.05 * k, 0.0, 1.0), yaw=0.5 * k)


FORMATS: dict[str, Callable[[], Iterator[bytes]]] = {
    "native": lambda: (encode_native(native(k)) for k in range(STEPS)),
    "native_json": lambda: (encode_native_json(native(k)) for k in range(STEPS)),
    "native_serial": lambda: (encode_native_serial(native(k)) for k in range(STEPS)),
    "nmea": nmea,
    "mavlink": mavlink,
    "water_linked_json": lambda: dvl(serial=False),
    "water_linked_serial": lambda: dvl(serial=True),
}


def chunks_of(name: str, *, cut: bool = True) -> list[Chunk]:
    """A dive with odometry of a format, in pieces as links deliver them, in order of arrival.

    Args:
        name: of the format.
        cut: streams into pieces of any length, with some bytes spoilt.
    """
    messages = list(FORMATS[name]())
    bad = Misbehaviour(garble=0.05, noise=0.05, max_bytes=0 if name == "native" else 150, seed=3)
    pieces = [piece for piece in bad.pieces(messages) if piece] if cut else messages
    chunks: list[tuple[int, Chunk]] = []
    for i, piece in enumerate(pieces):
        t_ns = T0_NS + round(STEPS * STEP_S * 1e9 * (i + 1) / len(pieces)) + (i * 7919 % 13) * 10**5
        chunks.append((t_ns, Chunk("vehicle", f"odometry-{name}", t_ns, piece, i == 30)))
    for k in range(STEPS):
        data = make_ping(k + 1, start_time=70 + STEP_S * k)
        t_ns = T0_NS + round((STEP_S * k + 0.05) * 1e9)
        for j, begin in enumerate(range(0, len(data), 1500)):
            piece = data[begin : begin + 1500]
            late_ns = t_ns + 10**6 * j + (k * 31 % 7) * 10**6
            chunks.append((late_ns, Chunk("sonar", "oculus", late_ns, piece)))
    return [chunk for _, chunk in sorted(chunks, key=lambda pair: pair[0])]


def checksum(values: Any) -> int:
    """Of anything plain."""
    return zlib.crc32(json.dumps(values, sort_keys=True, default=str).encode())
