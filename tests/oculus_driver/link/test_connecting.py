"""How the link finds its sonar, loses it and comes back."""

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


def test_a_lost_connection_comes_back_and_settings_are_sent_again(start: MakeBench) -> None:
    # quirk 22: the connection is lost right after the first configuration.
    bench = start(FireSettings(range_m=7.0))
    bench.connect()
    bench.lose("connection reset by the sonar")
    assert (bench.state, bench.reason) == (LinkState.BACKING_OFF, "connection reset by the sonar")
    bench.wait(0.5)
    assert bench.connects == [HERE, HERE]
    bench.connect()
    assert [fire["range_demand"] for fire in bench.sent] == [7.0, 7.0]


def test_pauses_grow_to_five_seconds_and_start_over_after_a_message(start: MakeBench) -> None:
    bench = start()

    def lose() -> float:
        bench.lose()
        pause_s = ((bench.link.deadline_ns or 0) - bench.now_ns) / S
        bench.wait(pause_s)
        assert bench.state is LinkState.CONNECTING
        return pause_s

    assert [lose() for _ in range(7)] == [0.5, 1, 2, 4, 5, 5, 5]
    bench.connect()
    assert lose() == 5.0  # to be connected is not enough
    bench.connect()
    bench.ping()
    assert lose() == 0.5


def test_an_attempt_that_gets_no_answer_ends_with_advice(start: MakeBench) -> None:
    bench = start()
    bench.wait(3.0)
    assert bench.state is LinkState.BACKING_OFF
    assert bench.disconnects == [bench.reason]
    assert re.search(r"192\.168\.2\.3:52100 .*\b3 s\b", bench.reason)


def test_without_an_address_a_status_is_waited_for(start: MakeBench) -> None:
    bench = start(address=None)
    bench.wait(60.0)
    assert (bench.state, bench.connects) == (LinkState.SEARCHING, [])
    bench.sight(THERE)
    assert (bench.state, bench.connects) == (LinkState.CONNECTING, [THERE])


def test_a_sonar_that_another_client_holds_is_left_alone_and_named(start: MakeBench) -> None:
    # quirk 20
    bench = start(address=None)
    bench.sight(holder=VIEWER)
    bench.wait(1.0)
    bench.sight(holder=VIEWER)
    assert (bench.state, bench.connects) == (LinkState.SEARCHING, [])
    assert "192.168.2.3" in bench.reason
    assert "192.168.2.10" in bench.reason
    assert bench.link.status.time_in_state_s(bench.now_ns) == 1.0
    bench.sight()
    assert bench.connects == [HERE]


def test_our_own_dead_connection_does_not_keep_us_out(pinging: MakeBench) -> None:
    bench = pinging(address=None)
    bench.lose()
    bench.sight(holder=VIEWER)  # the address that we were connected from
    bench.wait(0.5)
    assert bench.connects == [HERE, HERE]


def test_a_sonar_that_moved_is_followed(pinging: MakeBench) -> None:
    bench = pinging(address=None)
    bench.sight(THERE)
    assert bench.connects == [HERE]  # pings still come: nothing is wrong
    bench.wait(2.2)
    assert bench.connects == [HERE, THERE]
    (reason,) = bench.disconnects
    assert re.search(r"192\.168\.2\.3 .*192\.168\.2\.4$", reason)


@pytest.mark.parametrize("state", ["connecting", "configuring", "standby", "silent", "backing off"])
def test_a_move_is_followed_at_once_where_no_pings_come(start: MakeBench, state: str) -> None:
    settings = FireSettings(ping_rate=PingRate.STANDBY if state == "standby" else PingRate.NORMAL)
    bench = start(settings, address=None)
    bench.sight()
    if state == "silent":
        bench.connect()
        bench.ping()
        bench.wait(2.2)
    elif state == "backing off":
        bench.lose()
    elif state != "connecting":
        bench.connect()
    assert bench.state == state
    bench.sight(THERE)
    assert bench.connects == [HERE, THERE]
    assert len(bench.disconnects) == (state != "backing off")


def test_a_sonar_without_status_and_data_is_gone_and_searched(pinging: MakeBench) -> None:
    bench = pinging(address=None)
    bench.wait(5.1)
    assert bench.state is LinkState.SEARCHING
    assert "is the sonar powered?" in bench.disconnects[0]
    bench.sight()
    assert bench.connects == [HERE, HERE]


def test_a_sonar_without_status_that_still_pings_is_kept(pinging: MakeBench) -> None:
    bench = pinging(address=None)
    for _ in range(20):
        bench.wait(1.0)
        bench.ping()
    assert bench.state is LinkState.PINGING


def test_a_sonar_without_status_that_sends_anything_is_kept(pinging: MakeBench) -> None:
    bench = pinging(address=None)
    for _ in range(20):
        bench.wait(1.0)
        bench.dummy()
    assert bench.state is LinkState.SILENT
    assert bench.disconnects == []


def test_an_old_status_is_no_reason_to_connect_after_a_pause(start: MakeBench) -> None:
    bench = start(address=None, times=LinkTimeouts(back_off_ns=(6 * S,)))
    bench.sight()
    bench.lose()
    bench.wait(6.0)
    assert (bench.state, bench.connects) == (LinkState.SEARCHING, [HERE])


def test_closing_ends_everything(pinging: MakeBench) -> None:
    bench = pinging()
    bench.actions += bench.link.close("done", bench.now_ns)
    bench.lose()
    assert (bench.state, bench.link.deadline_ns) == (LinkState.CLOSED, None)
    assert bench.disconnects == ["done"]


@pytest.mark.parametrize("name", ["10.9.8.7", "another client"])
def test_the_client_that_a_sonar_names_while_it_pings_for_us_is_no_other_program(
    start: MakeBench, name: str
) -> None:
    bench = start(address=None)
    bench.sight()
    bench.connect()
    for _ in range(5):
        bench.ping()
        bench.sight(holder=name)
        bench.wait(1.0)
    bench.lose()
    bench.sight(holder=name)  # the sonar has not noticed it yet
    bench.wait(1.0)
    assert bench.connects == [HERE, HERE]
    assert "in use" not in bench.reason


def test_a_late_status_does_not_make_another_client_ours(start: MakeBench) -> None:
    bench = start(address=None)
    bench.sight()
    bench.connect()
    bench.ping()
    bench.sight(holder="10.9.8.7")
    bench.lose()
    bench.sight(holder="10.9.8.7")
    bench.wait(1.0)
    assert "in use by 10.9.8.7" in bench.reason
