"""When a sonar has to be quiet because it is hot."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import pytest

from oculus_driver import Ping, Status, decode_ping, decode_status, encode_status
from oculus_driver.status import ThermalGuard

if TYPE_CHECKING:
    from collections.abc import Callable

    from oculus_driver import Message
    from tests.oculus_driver.conftest import MakePing

SHUT_DOWN = 0x03 | 3 << 14


def status(main_c: float = 20.0, bits: int = 0x03) -> Status:
    temperatures_c = (99.0,) * 6 + (main_c, 99.0)
    decoded = decode_status(
        encode_status(device_id=1, status_bits=bits, temperatures_c=temperatures_c)
    )
    assert isinstance(decoded, Status)
    return decoded


@pytest.fixture
def ping_at(make_ping: MakePing, parse: Callable[[bytes], Message]) -> Callable[[float], Ping]:
    def make(temperature_c: float) -> Ping:
        ping = decode_ping(parse(make_ping(temperature_c=temperature_c)))
        assert isinstance(ping, Ping)
        return ping

    return make


def test_a_sonar_that_has_shut_down_may_ping_when_it_reports_so() -> None:
    # quirk 17
    guard = ThermalGuard(None)
    guard.status(status(bits=SHUT_DOWN))
    assert guard.reason is not None
    assert "too hot" in guard.reason
    guard.status(status(bits=0x03 | 1 << 14))  # high: it pings, only slower
    assert guard.reason is None


def test_a_limit_counts_for_pings_and_statuses(ping_at: Callable[[float], Ping]) -> None:
    # quirk 16
    guard = ThermalGuard(35.0)
    guard.ping(ping_at(34.9))
    assert guard.reason is None
    guard.ping(ping_at(35.0))
    assert re.match(r"35\.0 °C, .*\b35\b", guard.reason or "")
    guard.status(status(32.1))
    assert guard.reason is not None
    guard.status(status(32.0))
    assert not guard.reason
    guard.status(status(40.0))
    assert guard.reason.startswith("40.0 °C")


def test_without_a_limit_readings_decide_nothing(ping_at: Callable[[float], Ping]) -> None:
    guard = ThermalGuard(None)
    guard.ping(ping_at(90.0))
    guard.status(status(90.0))
    assert guard.reason is None


def test_a_reading_that_is_not_there_changes_nothing(ping_at: Callable[[float], Ping]) -> None:
    # quirk 5: sensors that are not there read as nonsense.
    guard = ThermalGuard(35.0)
    guard.ping(ping_at(2.6e-76))
    guard.ping(ping_at(1e194))
    guard.status(status(math.nan))
    assert guard.reason is None
    guard.status(status(50.0))
    guard.status(status(math.nan))
    assert guard.reason is not None
