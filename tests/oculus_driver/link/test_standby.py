"""How the link keeps a sonar quiet, and fires it once at a time."""

from __future__ import annotations

from typing import TYPE_CHECKING

from oculus_driver import FireSettings, PingRate
from oculus_driver.link.state import LinkState

if TYPE_CHECKING:
    from tests.oculus_driver.link.conftest import MakeBench

HERE, THERE, VIEWER = "192.168.2.3", "192.168.2.4", "192.168.2.10"
S = 1_000_000_000


def test_standby_is_entered_and_left_by_settings(pinging: MakeBench) -> None:
    bench = pinging()
    bench.actions += bench.link.apply(FireSettings(ping_rate=PingRate.STANDBY), bench.now_ns)
    assert (bench.state, bench.reason) == (LinkState.STANDBY, "standby requested")
    bench.ping()  # one that was under way
    assert bench.reason == "standby requested"
    bench.wait(60.0)
    assert (bench.state, bench.disconnects) == (LinkState.STANDBY, [])
    bench.actions += bench.link.apply(FireSettings(), bench.now_ns)
    assert (bench.state, bench.reason) == (LinkState.CONFIGURING, "settings sent, no ping yet")
    bench.wait(0.1)
    assert bench.sent[-1]["ping_rate"] == 0
    bench.ping()
    assert (bench.state, bench.reason) == (LinkState.PINGING, "pings arrive")


def test_dummies_that_stop_in_standby_mean_a_dead_connection(start: MakeBench) -> None:
    bench = start(FireSettings(ping_rate=PingRate.STANDBY))
    bench.connect()
    bench.dummy()
    bench.wait(10.1)
    assert len(bench.disconnects) == 1


def test_a_hold_keeps_the_sonar_quiet_until_it_is_let_go(pinging: MakeBench) -> None:
    # quirks 16 and 17: a sonar in air, or too hot, must not ping.
    bench = pinging()
    bench.actions += bench.link.hold("too hot", bench.now_ns)
    assert (bench.state, bench.reason) == (LinkState.STANDBY, "too hot")
    bench.actions += bench.link.apply(FireSettings(range_m=2.0), bench.now_ns)
    bench.wait(3.0)
    assert {fire["ping_rate"] for fire in bench.sent[-3:]} == {5}
    bench.actions += bench.link.hold(None, bench.now_ns)
    bench.wait(0.1)
    assert (bench.sent[-1]["ping_rate"], bench.sent[-1]["range_demand"]) == (0, 2.0)
    assert bench.state == "configuring"


def test_a_sonar_long_unheard_gets_time_to_answer_in_standby(start: MakeBench) -> None:
    bench = start(address=None)
    bench.sight()
    bench.connect()
    bench.wait(6.0)  # longer than a sonar without status and data is thought to be there
    bench.actions += bench.link.apply(FireSettings(ping_rate=PingRate.STANDBY), bench.now_ns)
    bench.wait(4.9)
    assert bench.state == "standby"
    bench.wait(0.2)
    assert bench.state == "searching"


TRIGGERED = FireSettings(network_trigger=True)


def test_a_triggered_sonar_is_quiet_until_the_first_trigger(start: MakeBench) -> None:
    bench = start(TRIGGERED)
    bench.connect()
    assert (bench.state, bench.reason) == (LinkState.STANDBY, "waiting for a trigger")
    bench.wait(10.0)
    assert {fire["ping_rate"] for fire in bench.sent} == {5}
    assert not any(fire["flags"] & 0x80 for fire in bench.sent)


def test_each_trigger_is_one_fire_message_and_nothing_else_triggers(start: MakeBench) -> None:
    # quirk 9: with the trigger bit set, one fire message per ping.
    bench = start(TRIGGERED)
    bench.connect()
    bench.wait(0.1)
    for _ in range(3):
        bench.actions += bench.link.trigger(bench.now_ns)
        bench.wait(0.3)
        bench.ping()
        assert bench.state is LinkState.PINGING
        bench.wait(7.0)
        assert bench.state is LinkState.PINGING  # no trigger, no ping: that is not silence
    triggers = [fire for fire in bench.sent if fire and fire["flags"] & 0x80]
    assert len(triggers) == 3
    assert len([fire for fire in bench.sent if not fire]) >= 18  # quirk 36: dummies, no junk


def test_a_trigger_without_a_ping_is_silence(start: MakeBench) -> None:
    bench = start(TRIGGERED)
    bench.connect()
    bench.wait(0.1)
    bench.actions += bench.link.trigger(bench.now_ns)
    bench.wait(0.2)
    bench.ping()
    bench.actions += bench.link.trigger(bench.now_ns)
    bench.wait(2.2)
    assert bench.state is LinkState.SILENT


def test_a_trigger_that_cannot_be_sent_is_refused(start: MakeBench, pinging: MakeBench) -> None:
    bench = start(TRIGGERED)
    assert bench.link.trigger(bench.now_ns) == []  # not connected
    bench.connect()
    bench.actions += bench.link.hold("in air", bench.now_ns)
    bench.wait(1.0)
    assert bench.link.trigger(bench.now_ns) == []
    assert pinging().link.trigger(bench.now_ns) == []  # pings by itself
