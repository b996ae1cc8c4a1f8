"""What the link sends, and when it reports that the sonar pings."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest

from oculus_driver import FireSettings, PingRate
from oculus_driver.link.state import LinkState, LinkTimeouts

if TYPE_CHECKING:
    from tests.oculus_driver.link.conftest import MakeBench

HERE, THERE, VIEWER = "192.168.2.3", "192.168.2.4", "192.168.2.10"
S = 1_000_000_000


def test_a_given_address_is_connected_at_once(start: MakeBench) -> None:
    bench = start()
    assert (bench.state, bench.connects) == (LinkState.CONNECTING, [HERE])


def test_pinging_is_reported_only_after_a_ping_came(start: MakeBench) -> None:
    bench = start()
    bench.connect()
    assert bench.state is LinkState.CONFIGURING
    bench.dummy()
    assert bench.state is LinkState.CONFIGURING
    bench.ping()
    assert (bench.state, bench.reason) == (LinkState.PINGING, "pings arrive")


def test_the_time_in_a_state_and_its_reason_are_reported(pinging: MakeBench) -> None:
    bench = pinging()
    for _ in range(3):
        bench.wait(0.5)
        bench.ping()
    status = bench.link.status
    assert status.time_in_state_s(bench.now_ns) == pytest.approx(1.5)
    assert (status.address, status.fire_version, status.failures) == (HERE, 2, 0)


def test_settings_are_sent_as_version_2_first(start: MakeBench) -> None:
    # quirk 14: some sonars need version 2.
    bench = start(FireSettings(range_m=33.0))
    bench.connect()
    (fire,) = bench.sent
    assert (fire["version"], fire["range_demand"]) == (2, 33.0)


def test_the_fire_message_is_repeated_every_second_in_every_state(
    start: MakeBench, pinging: MakeBench
) -> None:
    # quirk 1: some firmware drops the connection when nothing is sent for a second.
    bench = pinging()
    before = len(bench.sent)
    for _ in range(50):
        bench.wait(0.1)
        bench.ping()
    assert 4 <= len(bench.sent) - before <= 5
    quiet = start(FireSettings(ping_rate=PingRate.STANDBY))
    quiet.connect()
    quiet.wait(5.05)
    assert len(quiet.sent) == 6
    assert {fire["ping_rate"] for fire in quiet.sent} == {5}


def test_the_keep_alive_can_be_slower_or_off(start: MakeBench) -> None:
    for period_ns, count in ((2 * S, 3), (None, 1)):
        bench = start(
            FireSettings(ping_rate=PingRate.STANDBY), times=LinkTimeouts(keep_alive_ns=period_ns)
        )
        bench.connect()
        bench.wait(4.05)
        assert len(bench.sent) == count


def test_two_messages_are_never_closer_than_50_ms_and_the_newest_wins(pinging: MakeBench) -> None:
    bench = pinging()
    bench.actions += bench.link.apply(FireSettings(range_m=1.0), bench.now_ns)
    before = len(bench.sent)
    for range_m in (2.0, 3.0):
        bench.actions += bench.link.apply(FireSettings(range_m=range_m), bench.now_ns)
    assert len(bench.sent) == before
    bench.wait(0.049)
    assert len(bench.sent) == before
    bench.wait(0.001)
    assert [fire["range_demand"] for fire in bench.sent[before - 1 :]] == [1.0, 3.0]


def test_without_a_ping_version_1_is_tried_and_stays_if_it_helps(start: MakeBench) -> None:
    bench = start()
    bench.connect()
    bench.wait(4.9)
    assert {fire["version"] for fire in bench.sent} == {2}
    bench.wait(0.2)
    assert bench.sent[-1]["version"] == 1
    assert "fire version 1" in bench.reason
    bench.ping()
    assert bench.link.status.fire_version == 1
    bench.lose()
    bench.wait(1.0)
    bench.connect()
    assert bench.sent[-1]["version"] == 1


def test_a_version_that_worked_is_doubted_again_on_a_new_connection(start: MakeBench) -> None:
    bench = start()
    bench.connect()
    bench.wait(5.2)
    bench.ping()
    bench.lose()
    bench.wait(1.0)
    bench.connect()
    bench.wait(5.2)  # another sonar, or other firmware: version 1 gets no ping now
    assert bench.sent[-1]["version"] == 2


def test_without_a_ping_to_either_version_the_link_is_silent_and_starts_over(
    start: MakeBench,
) -> None:
    bench = start()
    bench.connect()
    bench.wait(10.19)
    assert bench.state is LinkState.CONFIGURING
    bench.wait(0.02)
    assert bench.connects == [HERE]
    assert re.search(r"192\.168\.2\.3 .*\b10\.2 s", bench.disconnects[0])
    bench.wait(0.5)
    bench.connect()
    assert bench.sent[-1]["version"] == 2


@pytest.mark.parametrize(
    ("settings", "version"), [(FireSettings(bits_per_sample=32), None), (FireSettings(), 2)]
)
def test_there_is_no_fallback_where_version_2_is_a_must(
    start: MakeBench, settings: FireSettings, version: int | None
) -> None:
    bench = start(settings, version=version)
    bench.connect()
    bench.wait(9.0)
    assert {fire["version"] for fire in bench.sent} == {2}
    assert bench.state is LinkState.SILENT
    assert "version 2" in bench.reason


def test_32_bit_are_asked_for_in_version_2_even_after_a_fallback(start: MakeBench) -> None:
    bench = start()
    bench.connect()
    bench.wait(5.1)
    bench.ping()
    bench.actions += bench.link.apply(FireSettings(bits_per_sample=32), bench.now_ns)
    bench.wait(0.1)
    assert (bench.sent[-1]["version"], bench.sent[-1]["extended_flags"]) == (2, 0x200)


def test_silence_is_named_after_the_ping_period_and_two_seconds(pinging: MakeBench) -> None:
    bench = pinging(FireSettings(ping_rate=PingRate.LOWEST))
    bench.wait(2.49)
    assert bench.state is LinkState.PINGING
    bench.wait(0.02)
    assert (bench.state, "no ping for 2.5 s" in bench.reason) == (LinkState.SILENT, True)
    bench.ping()
    assert bench.state is LinkState.PINGING


def test_a_slow_network_is_given_its_time(start: MakeBench) -> None:
    slow = FireSettings(network_limit_mbps=1)  # more than three seconds for one ping
    bench = start(slow)
    bench.connect()
    bench.wait(8.0)
    assert {fire["version"] for fire in bench.sent} == {2}
    for _ in range(5):
        bench.ping()
        bench.wait(slow.max_period_s + 1.9)
        assert bench.state is LinkState.PINGING
    bench.wait(0.2)
    assert bench.reason.startswith("no ping for 5.3 s")


def test_a_silent_sonar_is_connected_again_after_ten_seconds(pinging: MakeBench) -> None:
    bench = pinging()
    bench.wait(10.09)
    assert (bench.state, bench.disconnects) == (LinkState.SILENT, [])
    bench.wait(0.02)
    assert bench.state is LinkState.BACKING_OFF
    bench.wait(0.5)
    assert bench.connects == [HERE, HERE]


def test_a_sonar_that_went_to_standby_by_itself_is_fired_again_not_dropped(
    pinging: MakeBench,
) -> None:
    bench = pinging()
    before = len(bench.sent)
    for _ in range(30):
        bench.wait(1.0)
        bench.dummy()
    assert bench.state is LinkState.SILENT
    assert "no ping for 2.1 s" in bench.reason
    assert "standby" in bench.reason
    assert len(bench.sent) - before >= 29
    assert bench.disconnects == []
