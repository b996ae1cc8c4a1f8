"""Captures and synthetic messages for the driver's tests."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from oculus_driver import Message, StreamParser, bearing_table_cdeg, encode_ping

if TYPE_CHECKING:
    from pathlib import Path

MakePing = Callable[..., bytes]


@pytest.fixture(scope="session")
def capture_path(shared_data: Path) -> Path:
    return shared_data / "oculus" / "three_pings_8bit.raw"


@pytest.fixture(scope="session")
def capture(capture_path: Path) -> bytes:
    return capture_path.read_bytes()


@pytest.fixture(scope="session")
def captured(capture: bytes) -> list[Message]:
    return StreamParser().feed(capture, arrival_ns=10**18)


@pytest.fixture(scope="session")
def make_ping() -> MakePing:
    """Return a maker of ping messages: small and sound, except for `changes`."""

    def make(**changes: Any) -> bytes:
        rows, beams = changes.pop("rows", 5), changes.pop("beams", 256)
        dtype = changes.pop("dtype", np.uint8)
        image = np.arange(rows * beams, dtype=np.uint64).reshape(rows, beams)
        values: dict[str, Any] = {
            "ping_id": 7,
            "mode": 1,
            "frequency_hz": 750e3,
            "range_m": 10.0,
            "gain_percent": 50.0,
            "speed_of_sound_mps": 1500.0,
            "salinity_ppt": 35.0,
            "start_time": 12.5,
            "range_resolution_m": 0.02,
            "bearings_cdeg": bearing_table_cdeg(beams, np.pi / 3),
            "image": image.astype(dtype),
            "source_id": 7892,
        }
        return encode_ping(**(values | changes))

    return make


@pytest.fixture(scope="session")
def parse() -> Callable[[bytes], Message]:
    """Return a function from the bytes of one message to that message."""

    def one(data: bytes) -> Message:
        parser = StreamParser()
        (message,) = parser.feed(data, arrival_ns=10**18) + parser.finish()
        return message

    return one


@pytest.fixture
def pings(make_ping: Callable[..., bytes]) -> list[bytes]:
    return [make_ping(ping_id=40 + index, start_time=5.0 + 0.1 * index) for index in range(4)]
