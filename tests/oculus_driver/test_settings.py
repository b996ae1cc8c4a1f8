"""What a sonar may be asked for, and the bytes that ask."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from oculus_driver import FireSettings, Mode, PingRate, SettingsError, model_of
from oculus_driver.models import UNKNOWN
from oculus_driver.wire import FIRE_V1, FIRE_V2

M370S, M750D, M1200D = 1041, 1032, 1042

SETTINGS = st.builds(
    FireSettings,
    mode=st.sampled_from(Mode),
    ping_rate=st.sampled_from(PingRate),
    range_m=st.floats(0.1, 200.0),
    gain_percent=st.floats(0.0, 100.0),
    gamma=st.integers(0, 255),
    speed_of_sound_mps=st.none() | st.floats(1300.0, 1700.0),
    salinity_ppt=st.floats(0.0, 42.0),
    beams=st.sampled_from((256, 512)),
    bits_per_sample=st.sampled_from((8, 16, 32)),
    gain_words=st.booleans(),
    gain_assist=st.booleans(),
    network_trigger=st.booleans(),
    network_limit_mbps=st.none() | st.integers(1, 254),
)


def test_the_defaults_are_those_of_the_specification() -> None:
    # Section 6.7: 10 m, gain 50, linear, 512 beams with gain words, sea water.
    assert FireSettings().encode().hex() == (
        "534f00000000150002004900000000000100ffff4d00000000000024400000000000004940"
        "0000000000000000" + "0000000000804140" + "00" * 36
    )


def test_a_worked_vector_of_the_specification_comes_out() -> None:
    settings = FireSettings(
        mode=Mode.HIGH_FREQUENCY,
        ping_rate=PingRate.STANDBY,
        gain_percent=80.0,
        speed_of_sound_mps=1500.0,
        salinity_ppt=0.0,
        bits_per_sample=32,
    )
    assert settings.encode().hex() == (
        "534f00000000150002004900000000000205ffff4f00000000000024400000000000005440"
        "00000000007097400000000000000000" + "00020000" + "00" * 32
    )


@given(SETTINGS)
def test_every_setting_reaches_its_field(settings: FireSettings) -> None:
    fields = FIRE_V2.unpack(settings.encode())
    assert (fields["mode"], fields["ping_rate"]) == (settings.mode, settings.ping_rate)
    assert (fields["gamma"], fields["gain_percent"]) == (settings.gamma, settings.gain_percent)
    assert fields["range_demand"] == settings.range_m
    assert fields["speed_of_sound_demand_mps"] == (settings.speed_of_sound_mps or 0.0)
    assert fields["salinity_ppt"] == settings.salinity_ppt
    assert fields["network_speed_mbps"] == (settings.network_limit_mbps or 255)
    assert fields["extended_flags"] == (0x200 if settings.bits_per_sample == 32 else 0)
    if not settings.needs_version_2:
        older = FIRE_V1.unpack(settings.encode(version=1))
        changed = {"version", "payload_size"}
        assert all(older[name] == fields[name] for name in older.keys() - changed)


@pytest.mark.parametrize(
    ("change", "mask", "bit"),
    [
        ({}, 0xFF, 0x4D),
        ({"range_m": None, "range_percent": 50.0}, 0x01, 0),  # quirk 29: both units
        ({"bits_per_sample": 16}, 0x02, 0x02),
        ({"bits_per_sample": 32}, 0x02, 0x02),
        ({"gain_words": False}, 0x04, 0),
        ({"gain_assist": True}, 0x10, 0x10),  # quirk 8: taken as 1 = on
        ({"beams": 256}, 0x40, 0),
        ({"network_trigger": True}, 0x80, 0x80),
    ],
)
def test_each_flag_follows_its_setting(change: dict[str, Any], mask: int, bit: int) -> None:
    assert FireSettings(**change).flags & mask == bit


@given(SETTINGS)
def test_dangerous_bits_stay_clear_unless_asked_for(settings: FireSettings) -> None:
    assert settings.flags & 0x08
    assert not settings.flags & 0x20
    assert bool(settings.flags & 0x80) == settings.network_trigger  # quirk 9


def test_a_range_in_percent_is_sent_as_percent() -> None:
    # quirk 29: the unit follows from which range is given, not from its value.
    for percent in (0.5, 75.0, 100.0):
        settings = FireSettings(range_m=None, range_percent=percent)
        assert FIRE_V2.unpack(settings.encode())["range_demand"] == percent


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"mode": 0}, "mode is 0: it must be one of 1, 2"),
        ({"ping_rate": 6}, "ping_rate is 6"),
        ({"range_m": 0.05}, "range_m is 0.05: it must be from 0.1 to 200"),
        ({"range_m": 201.0}, "range_m"),
        ({"range_m": math.nan}, "range_m is nan"),
        ({"range_m": None}, "either range_m or range_percent"),
        ({"range_percent": 10.0}, "either range_m or range_percent"),
        ({"range_m": None, "range_percent": 0.0}, "range_percent is 0"),
        ({"range_m": None, "range_percent": 100.1}, "range_percent"),
        ({"gain_percent": -1.0}, "gain_percent"),
        ({"gain_percent": math.inf}, "gain_percent"),
        ({"gamma": 256}, "gamma is 256"),
        ({"gamma": 0.5}, "gamma is 0.5: it must be a whole number"),
        ({"speed_of_sound_mps": 0.0}, "speed_of_sound_mps is 0.0: it must be from 1300 to 1700"),
        ({"salinity_ppt": 43.0}, "salinity_ppt"),
        ({"beams": 300}, "beams is 300: it must be one of 256, 512"),
        ({"bits_per_sample": 24}, "bits_per_sample"),
        ({"network_limit_mbps": 0}, "network_limit_mbps"),
        ({"network_limit_mbps": 255}, "network_limit_mbps"),
    ],
)
def test_what_cannot_be_asked_for_is_named(change: dict[str, Any], words: str) -> None:
    with pytest.raises(SettingsError, match=words):
        FireSettings(**change)


def test_32_bit_need_version_2() -> None:
    settings = FireSettings(bits_per_sample=32)
    assert settings.needs_version_2
    with pytest.raises(SettingsError, match="version 2"):
        settings.encode(version=1)
    with pytest.raises(SettingsError, match=r"version 3"):
        FireSettings().encode(version=3)


def test_a_range_beyond_the_model_is_cut_to_what_it_has() -> None:
    far = FireSettings(mode=Mode.HIGH_FREQUENCY, range_m=60.0)
    assert far.limited_to(model_of(M750D)).range_m == 40.0
    assert far.limited_to(model_of(M1200D)).range_m == 10.0
    near = FireSettings(range_m=119.0)
    assert near.limited_to(model_of(M750D)) is near
    percent = FireSettings(range_m=None, range_percent=100.0)
    assert percent.limited_to(model_of(M1200D)) is percent


def test_a_range_beyond_the_model_is_named() -> None:
    far = FireSettings(mode=Mode.HIGH_FREQUENCY, range_m=100.0)
    with pytest.raises(SettingsError, match="a range of 100 m: M750d reaches 40 m in mode 2"):
        far.check_model(model_of(M750D))
    FireSettings(range_m=100.0).check_model(model_of(M750D))
    with pytest.raises(SettingsError, match="M370s has no mode 2"):
        FireSettings(mode=Mode.HIGH_FREQUENCY).check_model(model_of(M370S))
    far.check_model(model_of(1))


def test_no_model_is_refused_for_its_part_number() -> None:
    # quirk 24: what one model has is no reason to refuse another.
    far = FireSettings(range_m=200.0)
    unknown = model_of(9999)
    assert unknown.family == UNKNOWN
    assert far.limited_to(unknown) is far


def test_a_mode_that_the_model_has_not_is_refused() -> None:
    with pytest.raises(SettingsError, match=r"M370s .*mode 2.*mode 1"):
        FireSettings(mode=Mode.HIGH_FREQUENCY).limited_to(model_of(M370S))


def test_standby_is_quiet_whatever_else_is_set() -> None:
    quiet = FireSettings(ping_rate=PingRate.HIGHEST, network_trigger=True).in_standby()
    assert quiet.standby
    assert not quiet.flags & 0x80
    assert math.isinf(quiet.max_period_s)


@pytest.mark.parametrize(
    ("change", "period_s"),
    [
        ({}, 0.1),
        ({"ping_rate": PingRate.LOWEST}, 0.5),
        ({"ping_rate": PingRate.HIGHEST, "range_m": 140.0}, 0.2),  # the way of the sound
        ({"range_m": None, "range_percent": 70.0}, 0.2),
        ({"network_limit_mbps": 100, "beams": 256}, 0.1),  # 100 Mbit: the rate decides
        ({"network_limit_mbps": 10, "beams": 256}, 8 * (4096 + 800 * 260) / 10e6),
    ],
)
def test_the_slowest_of_rate_way_and_network_is_the_period(
    change: dict[str, Any], period_s: float
) -> None:
    assert FireSettings(**change).max_period_s == pytest.approx(period_s)


@pytest.mark.parametrize(("limit", "byte"), [(None, 255), (100, 100), (10, 10)])
def test_the_network_byte_covers_100_mbit_and_1_gbit(limit: int | None, byte: int) -> None:
    # A gigabit has no number in one byte: "as fast as the link" is the setting for it.
    settings = FireSettings(network_limit_mbps=limit)
    assert FIRE_V2.unpack(settings.encode())["network_speed_mbps"] == byte
