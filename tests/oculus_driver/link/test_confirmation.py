"""What pings show against what was asked for."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from oculus_driver import FireSettings, Mode, Ping, PingRate, decode_ping
from oculus_driver.link.confirmation import CONFIRM_TIMEOUT_NS, PendingConfirmation, differences

if TYPE_CHECKING:
    from collections.abc import Callable

    from oculus_driver import Message
    from tests.oculus_driver.conftest import MakePing

ASKED = FireSettings(range_m=10.0, beams=256, gain_words=False)
S = 1_000_000_000


@pytest.fixture
def show(make_ping: MakePing, parse: Callable[[bytes], Message]) -> Callable[..., Ping]:
    """Return a maker of pings that show `ASKED` in force, but for what is changed."""

    def make(**changes: Any) -> Ping:
        ping = decode_ping(parse(make_ping(**({"flags": int(ASKED.flags)} | changes))))
        assert isinstance(ping, Ping)
        return ping

    return make


def names(settings: FireSettings, ping: Ping) -> dict[str, bool]:
    """What differs, and whether it decides."""
    return {one.name: one.decisive for one in differences(settings, ping)}


def test_a_ping_that_shows_all_that_was_asked_for_differs_in_nothing(
    show: Callable[..., Ping],
) -> None:
    assert differences(ASKED, show()) == ()


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"mode": 2}, "mode"),
        ({"gamma": 127}, "gamma"),
        ({"range_m": 9.99}, "range, m"),
        ({"flags": 0x08}, "range unit"),
        ({"flags": 0x0B}, "16-bit flag"),
        ({"flags": 0x49}, "512-beam flag"),
    ],
)
def test_mode_range_gamma_and_three_flags_decide(
    show: Callable[..., Ping], changes: dict[str, Any], name: str
) -> None:
    assert names(ASKED, show(**changes)) == {name: True}


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"gain_percent": 50.2}, "gain, percent"),
        ({"gain_percent": float("nan")}, "gain, percent"),
        ({"salinity_ppt": 0.0}, "salinity, ppt"),  # quirk 6
        ({"beams": 512}, "beams"),
        ({"dtype": np.uint16}, "bits per sample"),  # quirk 10: the result's own size counts
        ({"gains": np.ones(5, dtype=np.uint32)}, "gain words"),  # quirk 12: by size
    ],
)
def test_the_rest_is_reported_and_decides_nothing(
    show: Callable[..., Ping], changes: dict[str, Any], name: str
) -> None:
    assert names(ASKED, show(**changes)) == {name: False}


def test_the_gain_flag_of_the_echo_is_not_believed(show: Callable[..., Ping]) -> None:
    # quirk 12: one sonar sent no gains though its echo set the flag.
    asked = replace(ASKED, gain_words=True)
    assert names(asked, show(flags=int(asked.flags))) == {"gain words": False}


def test_the_speed_of_sound_is_compared_only_where_it_was_given(show: Callable[..., Ping]) -> None:
    # quirk 4: the echo holds the speed in use, not the 0 that was sent.
    assert differences(ASKED, show(speed_of_sound_mps=1490.66)) == ()
    given = replace(ASKED, speed_of_sound_mps=1500.0)
    assert differences(given, show(speed_of_sound_mps=1500.4)) == ()
    assert names(given, show(speed_of_sound_mps=1490.66)) == {"speed of sound, m/s": False}


def test_older_firmware_maps_the_gain_in_mode_2(show: Callable[..., Ping]) -> None:
    # quirk 7: the echo is 40 + 0.6 x demand, or the demand.
    asked = replace(ASKED, mode=Mode.HIGH_FREQUENCY, gain_percent=50.0)
    assert differences(asked, show(mode=2, gain_percent=70.0)) == ()
    assert differences(asked, show(mode=2, gain_percent=50.0)) == ()
    assert names(asked, show(mode=2, gain_percent=60.0)) == {"gain, percent": False}
    assert names(ASKED, show(gain_percent=70.0)) == {"gain, percent": False}


def test_the_real_echo_of_rate_and_network_is_never_compared(captured: list[Message]) -> None:
    # quirks 2, 3, 5: a ping rate of 195 and a network speed of 25 come back in real pings.
    asked = FireSettings(
        mode=Mode.HIGH_FREQUENCY,
        ping_rate=PingRate.LOWEST,
        range_m=2.0,
        beams=256,
        gain_words=False,
        gain_assist=True,
        gamma=127,
    )
    ping = decode_ping(captured[0])
    assert isinstance(ping, Ping)
    assert {one.name for one in differences(asked, ping)} <= {"gain, percent", "salinity, ppt"}


def test_a_range_in_percent_is_judged_by_its_unit(show: Callable[..., Ping]) -> None:
    # quirk 29
    asked = replace(ASKED, range_m=None, range_percent=50.0)
    assert names(asked, show()) == {"range unit": True}
    assert differences(asked, show(flags=int(asked.flags), range_m=50.0)) == ()


def test_a_difference_reads_as_words(show: Callable[..., Ping]) -> None:
    (difference,) = differences(ASKED, show(range_m=9.5))
    assert all(word in str(difference) for word in ("range", "10", "9.5"))


def test_the_first_ping_with_the_settings_confirms_them(show: Callable[..., Ping]) -> None:
    watch = PendingConfirmation(ASKED, 5 * S)
    assert watch.ping(show(range_m=3.0), 6 * S) is None  # one that was under way
    answer = watch.ping(show(gain_percent=10.0), 7 * S)
    assert answer is not None
    assert (answer.confirmed, answer.waited_ns, answer.pings) == (True, 2 * S, 2)
    assert [one.name for one in answer.changed] == ["gain, percent"]


def test_pings_that_show_otherwise_are_named_in_the_end(show: Callable[..., Ping]) -> None:
    # quirk 6: speed of sound and salinity take six seconds and more.
    watch = PendingConfirmation(ASKED, 0)
    watch.ping(show(range_m=3.0, gamma=1, gain_percent=10.0), S)
    assert watch.deadline_ns == CONFIRM_TIMEOUT_NS > 6 * S
    answer = watch.expire(watch.deadline_ns)
    assert not answer.confirmed
    assert "gamma" in answer.reason
    assert "range" in answer.reason
    assert "gain" not in answer.reason  # not decisive


@pytest.mark.parametrize(
    ("now", "earlier"),
    [
        ({"gain_percent": 61.0}, {}),
        ({"salinity_ppt": 0.0}, {}),
        ({"speed_of_sound_mps": 1450.0}, {"speed_of_sound_mps": 1500.0}),
        ({"beams": 512}, {"beams": 256, "flags": 0x49}),
        ({"bits_per_sample": 16}, {"dtype": np.uint8}),
    ],
    ids=str,
)
def test_a_changed_setting_is_waited_for_though_it_does_not_decide(
    now: dict[str, Any], earlier: dict[str, Any], show: Callable[..., Ping]
) -> None:
    before = replace(ASKED, speed_of_sound_mps=1500.0)
    asked = replace(before, **now)
    same = {"flags": int(asked.flags), "speed_of_sound_mps": 1500.0}
    under_way = show(**(same | earlier | {"flags": int(asked.flags)}))
    watch = PendingConfirmation(asked, 0, before=before)
    assert watch.ping(under_way, S) is None
    late = watch.expire(watch.deadline_ns)
    assert late.confirmed  # what decides is in force
    assert len(late.unsettled) == 1
    assert str(late.unsettled[0]) in late.reason
    quirky = replace(asked, gain_words=not asked.gain_words)
    unchanged = PendingConfirmation(quirky, 0, before=quirky).ping(under_way, S)
    assert unchanged is not None  # an old difference is not waited for


def test_without_pings_nothing_is_confirmed() -> None:
    answer = PendingConfirmation(ASKED, 0).expire(8 * S)
    assert (answer.confirmed, answer.pings) == (False, 0)
    assert "no ping" in answer.reason


def test_standby_is_confirmed_by_a_dummy_and_not_by_pings(show: Callable[..., Ping]) -> None:
    quiet = ASKED.in_standby()
    watch = PendingConfirmation(quiet, 0)
    assert watch.ping(show(), S) is None
    answer = watch.dummy(2 * S)
    assert answer is not None
    assert (answer.confirmed, answer.pings) == (True, 1)
    loud = PendingConfirmation(quiet, 0)
    loud.ping(show(), S)
    answer = loud.expire(8 * S)
    assert (answer.confirmed, answer.pings) == (False, 1)
    assert "standby" in answer.reason
    assert PendingConfirmation(ASKED, 0).dummy(S) is None


def test_what_was_sent_decides_and_what_was_asked_for_is_reported(
    show: Callable[..., Ping],
) -> None:
    asked = replace(ASKED, range_m=100.0)
    answer = PendingConfirmation(asked, 0, ASKED).ping(show(), S)
    assert answer is not None
    assert answer.confirmed
    assert [(one.name, one.asked, one.shown) for one in answer.changed] == [("range, m", 100, 10)]
