"""Status datagrams."""

from __future__ import annotations

import math
from ipaddress import IPv4Address

import pytest
from hypothesis import given
from hypothesis import strategies as st

from oculus_driver.encode import encode_status
from oculus_driver.errors import Reject
from oculus_driver.status import Status, decode_status


def decoded(**values: object) -> Status:
    status = decode_status(encode_status(**({"device_id": 70_007} | values)))  # type: ignore[arg-type]
    assert isinstance(status, Status)
    return status


def test_every_field_of_the_worked_vector_is_read() -> None:
    status = decoded(
        device_id=7892,
        status_bits=0x83,
        arm0_version=0x01020003,
        address="192.168.2.3",
        client_address="192.168.2.10",
        mac=bytes.fromhex("0050c2a1b2c3"),
        temperatures_c=(20.0, 20.5, 21.0, 21.5, 22.0, 22.5, 23.0, 23.5),
        pressure_bar=1.25,
    )
    assert (status.device_id, status.source_id, status.model.name) == (7892, 7892, "M750d")
    assert (status.master_state, status.pause_reason, status.busy) == ("running", None, True)
    assert (status.temperature_state, status.transmitter_failed) == ("good", False)
    assert status.firmware == (0x01020003, 0, 0)
    assert status.address == IPv4Address("192.168.2.3")
    assert status.netmask == IPv4Address("255.255.255.0")
    assert status.client_address == IPv4Address("192.168.2.10")
    assert status.mac.hex(":") == "00:50:c2:a1:b2:c3"
    assert status.temperatures_c == (20.0, 20.5, 21.0, 21.5, 22.0, 22.5, 23.0, 23.5)
    assert status.pressure_bar == 1.25


def test_a_free_sonar_has_no_client() -> None:
    status = decoded()
    assert status.client_address is None
    assert not status.busy
    assert status.source_id == 70_007 - 65_536


@pytest.mark.parametrize(
    ("bits", "state", "reason"),
    [
        (0b000_000, "boot loader booting", "magnetic switch"),
        (0b110_001, "boot loader halted", "brown-out"),
        (0b110_010, "booting", None),
        (0b110_111, "unknown", None),
    ],
)
def test_the_state_of_the_sonar_has_a_name(bits: int, state: str, reason: str | None) -> None:
    status = decoded(status_bits=bits)
    assert (status.master_state, status.pause_reason) == (state, reason)


def test_heat_and_failure_are_reported() -> None:
    status = decoded(status_bits=3 | 3 << 14 | 1 << 16)
    assert status.temperature_state == "shut down"
    assert status.transmitter_failed


def test_impossible_readings_are_not_available() -> None:
    temperatures = (math.nan, math.inf, -41.0, 121.0, -40.0, 120.0, 0.0, 1e300)
    status = decoded(temperatures_c=temperatures, pressure_bar=-1e194)
    assert status.temperatures_c == (None, None, None, None, -40.0, 120.0, 0.0, None)
    assert status.pressure_bar is None


def test_an_unknown_part_number_is_a_model_all_the_same() -> None:
    model = decoded(part_number=9999).model
    assert (model.name, model.family.max_range_m) == ("part 9999", (120.0, 40.0))


def test_a_longer_datagram_is_read_and_a_shorter_one_is_not() -> None:
    datagram = encode_status(device_id=1)
    assert decode_status(datagram + b"more") == decode_status(datagram)
    short = decode_status(datagram[:-1])
    assert isinstance(short, Reject)
    assert short.reason == "short_message"


@given(st.binary(max_size=300))
def test_any_datagram_is_a_status_or_a_reject(datagram: bytes) -> None:
    assert isinstance(decode_status(datagram), Reject)
    assert isinstance(decode_status(b"SO" + datagram), Status | Reject)
