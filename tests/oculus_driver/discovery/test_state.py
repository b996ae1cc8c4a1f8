"""Sonars in sight, from status datagrams."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from oculus_driver.discovery.state import (
    DUPLICATE_NS,
    GONE_NS,
    STALE_NS,
    DiscoveredSonar,
    DiscoveryState,
    version_text,
)
from oculus_driver.encode import encode_status
from oculus_driver.errors import Reject

S = 1_000_000_000
HOME = {"address": "192.168.2.3"}


def heard(
    state: DiscoveryState, arrival_ns: int, source: str | None = None, **values: Any
) -> DiscoveredSonar:
    seen = state.feed(encode_status(**({"device_id": 7892} | HOME | values)), source, arrival_ns)
    assert isinstance(seen, DiscoveredSonar)
    return seen


def refused(state: DiscoveryState, datagram: bytes, arrival_ns: int = 0) -> str:
    reject = state.feed(datagram, None, arrival_ns)
    assert isinstance(reject, Reject)
    return reject.reason


def test_a_sonar_is_followed_over_its_statuses() -> None:
    state = DiscoveryState()
    heard(state, 10 * S)
    heard(state, 11 * S)
    seen = heard(state, 12 * S, pressure_bar=2.5)
    assert (seen.first_seen_ns, seen.last_seen_ns, seen.count) == (10 * S, 12 * S, 3)
    assert (seen.address, seen.model.name, seen.status.pressure_bar) == (
        "192.168.2.3",
        "M750d",
        2.5,
    )
    assert list(state.sonars.values()) == [seen]


def test_several_sonars_are_distinguished_by_serial_and_by_part_number() -> None:
    state = DiscoveryState()
    for serial, part in ((7892, 1032), (7893, 1032), (7892, 1042)):
        heard(state, serial * S, device_id=serial, part_number=part)
    assert set(state.sonars) == {(1032, 7892), (1032, 7893), (1042, 7892)}


def test_a_copy_from_another_network_port_is_no_news() -> None:
    # quirk 21: a host with two ports on one net hears every status twice
    state = DiscoveryState()
    heard(state, S)
    status = encode_status(device_id=7892, **HOME)  # type: ignore[arg-type]
    assert refused(state, status, S + DUPLICATE_NS) == "duplicate"
    assert heard(state, S + DUPLICATE_NS + 1).count == 2
    assert (state.statuses, state.rejects) == (2, {"duplicate": 1})


def test_a_status_with_news_is_never_a_copy() -> None:
    state = DiscoveryState()
    heard(state, S)
    assert heard(state, S + 1, status_bits=0x83).status.busy


def test_another_size_of_datagram_does_not_deafen() -> None:
    # quirk 28: one driver stops listening for ever after one
    state = DiscoveryState()
    status = encode_status(device_id=7892)
    for datagram in (b"", b"SO", status[:-1], b"x" * 142):
        refused(state, datagram)
    assert state.rejects == {"short_message": 3, "bad_magic": 1}
    assert isinstance(state.feed(status + b"newer firmware", None, 0), DiscoveredSonar)


def test_an_unknown_model_is_a_sonar_all_the_same() -> None:
    # quirk 24: other drivers refuse models that they do not know
    seen = heard(DiscoveryState(), 0, part_number=9999)
    assert (seen.model.name, seen.model.family.max_range_m) == ("part 9999", (120.0, 40.0))


def test_the_sonars_own_address_is_where_to_connect() -> None:
    seen = heard(DiscoveryState(), 0, source="10.0.0.9")
    assert (seen.address, seen.source_address) == ("192.168.2.3", "10.0.0.9")


@pytest.mark.parametrize(
    "claimed",
    [
        "0.0.0.0",  # noqa: S104 - as a sonar sends it
        "255.255.255.255",
        "224.0.0.1",
    ],
)
def test_a_sonar_without_an_address_of_its_own_is_where_it_speaks_from(claimed: str) -> None:
    assert heard(DiscoveryState(), 0, source="10.0.0.9", address=claimed).address == "10.0.0.9"


def test_a_new_address_shows_at_once() -> None:
    state = DiscoveryState()
    heard(state, S)
    moved = heard(state, 2 * S, address="192.168.2.77")
    assert (moved.address, moved.count, len(state.sonars)) == ("192.168.2.77", 2, 1)


def test_a_silent_sonar_is_stale_and_then_gone() -> None:
    state = DiscoveryState()
    seen = heard(state, S)
    assert not seen.stale(S + STALE_NS)
    assert seen.stale(S + STALE_NS + 1)
    assert state.present(S + GONE_NS) == [seen]
    assert state.present(S + GONE_NS + 1) == []


def test_a_sonar_that_comes_back_has_just_appeared() -> None:
    state = DiscoveryState()
    heard(state, S)
    back = heard(state, S + GONE_NS + 1)
    assert (back.first_seen_ns, back.count) == (S + GONE_NS + 1, 1)


def test_a_flood_of_invented_sonars_is_refused_and_the_real_one_kept() -> None:
    state = DiscoveryState(max_sonars=4)
    heard(state, 0)
    for serial in range(100):
        state.feed(encode_status(device_id=serial), None, serial)
    assert len(state.sonars) == 4
    assert state.rejects == {"too_many_sonars": 97}
    assert heard(state, S).count == 2


def test_sonars_that_are_gone_make_room() -> None:
    state = DiscoveryState(max_sonars=2)
    for serial in range(3):
        heard(state, serial * (GONE_NS + 1), device_id=serial)
    assert len(state.sonars) <= 2
    assert (1032, 2) in state.sonars


@pytest.mark.parametrize("wanted", ["7892", "192.168.2.3", "M750d", "m750D", "MT750d"])
def test_a_sonar_is_chosen_by_serial_address_or_model(wanted: str) -> None:
    seen = heard(DiscoveryState(), 0, part_number=2419)
    assert seen.matches(wanted)


@pytest.mark.parametrize("wanted", ["789", "192.168.2.30", "M1200d", ""])
def test_no_other_sonar_is_chosen(wanted: str) -> None:
    assert not heard(DiscoveryState(), 0).matches(wanted)


def test_the_facts_are_all_that_the_status_reports() -> None:
    seen = heard(
        DiscoveryState(),
        0,
        source="192.168.2.3",
        status_bits=0x83,
        client_address="192.168.2.10",
        arm0_version=0x01020003,
        mac=bytes.fromhex("0050c2a1b2c3"),
        temperatures_c=(20.0, 20.5, 21.0, 21.5, 22.0, 22.5, 23.0, float("nan")),
        pressure_bar=1.25,  # quirk 30: bar, not pascal
    )
    facts = json.loads(json.dumps(seen.snapshot(), allow_nan=False))
    assert facts["firmware"] == {"arm0": "1.2.3", "arm1": "0.0.0", "fpga": "0.0.0"}
    assert (facts["address"], facts["netmask"]) == ("192.168.2.3", "255.255.255.0")
    assert (facts["busy"], facts["held_by"]) == (True, "192.168.2.10")
    assert (facts["temperature_c"], facts["temperatures_c"][7]) == (23.0, None)
    assert (facts["mac"], facts["serial_number"]) == ("00:50:c2:a1:b2:c3", 7892)
    assert (facts["state"], facts["pressure_bar"]) == ("running", 1.25)


def test_a_version_has_three_parts() -> None:
    assert version_text(0xFF0A1234) == "255.10.4660"


@given(st.lists(st.binary(max_size=160).map(lambda tail: b"SO" + tail), max_size=8))
def test_any_datagram_is_a_sighting_or_a_reject(datagrams: list[bytes]) -> None:
    state = DiscoveryState()
    for arrival_ns, datagram in enumerate(datagrams):
        assert isinstance(state.feed(datagram, None, arrival_ns), DiscoveredSonar | Reject)
    assert state.statuses + state.rejects.total() == len(datagrams)
