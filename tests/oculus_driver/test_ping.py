"""Pings of every kind that no real capture holds, and every reason not to have one."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oculus_driver.encode import encode_dummy
from oculus_driver.errors import EncodeError, Reject
from oculus_driver.ping import Ping, PingHeader, decode_header, decode_ping
from oculus_driver.stream import Message
from oculus_driver.wire import F64, PING_RESULT_V1, PING_RESULT_V2, U8, U16, U32, Layout

MakePing = Callable[..., bytes]
Parse = Callable[[bytes], Message]

CODES = {name: "<" + code for name, code in (("u8", U8), ("u16", U16), ("u32", U32), ("f64", F64))}


def message_of(data: bytes, version: int = 2) -> Message:
    """Return a message as the parser would, without the parser's own opinion of it."""
    return Message(0x23, version, 7892, 1032, data, 0, 10**18)


def patched(data: bytes, layout: Layout, **fields: Any) -> bytes:
    return layout.pack(layout.unpack(data) | fields) + data[layout.size :]


def ping_of(data: bytes, version: int = 2, **options: bool) -> Ping:
    message = message_of(data, version)
    ping, header = decode_ping(message, **options), decode_header(message, **options)
    assert isinstance(ping, Ping), ping
    assert isinstance(header, PingHeader)
    for name in set(PingHeader.__slots__) - {"message", "layout", "fields"}:
        assert str(getattr(header, name)) == str(getattr(ping, name))  # also NaN
    return ping


def reason_of(data: bytes, version: int = 2) -> str:
    reject = decode_ping(message_of(data, version))
    assert isinstance(reject, Reject)
    assert reject.detail
    assert decode_header(message_of(data, version)) == reject
    return reject.reason


@pytest.mark.parametrize("version", [0, 1, 2])  # quirk 15: 0 means 1
@pytest.mark.parametrize("beams", [256, 512])
@pytest.mark.parametrize("gains", [False, True])
@pytest.mark.parametrize(
    ("width", "dtype"), [(1, np.uint8), (2, np.uint16), (3, np.uint32), (4, np.uint32)]
)
def test_what_is_encoded_is_decoded(
    *,
    make_ping: MakePing,
    parse: Parse,
    version: int,
    beams: int,
    gains: bool,
    width: int,
    dtype: Any,
) -> None:
    rng = np.random.default_rng(width)
    image = rng.integers(0, 1 << 8 * width, size=(7, beams), dtype=np.uint64).astype(dtype)
    words = rng.integers(1, 1 << 32, size=7, dtype=np.uint64).astype(np.uint32) if gains else None
    data = make_ping(
        version=version, rows=7, beams=beams, image=image, gains=words, data_size=width
    )
    assert len(data) == 2048 + 7 * (beams * width + 4 * gains)
    ping = decode_ping(parse(data))
    assert isinstance(ping, Ping)
    np.testing.assert_array_equal(ping.image, image)
    assert (ping.image.dtype, ping.bits_per_sample) == (dtype, 8 * width)
    assert not ping.image.flags.writeable
    assert ping.full_scale == (1 << 8 * width) - 1
    if words is None:
        assert ping.gains is None
    else:
        np.testing.assert_array_equal(ping.gains, words)
    assert (ping.start_time_s, ping.start_ticks) == ((12.5, None) if version == 2 else (None, 12))
    assert ping.warnings == frozenset()
    assert (ping.version, ping.source_id, ping.part_number) == (max(1, version), 7892, 1032)


def test_all_but_24_bit_samples_are_views(make_ping: MakePing) -> None:
    for dtype in (np.uint8, np.uint16, np.uint32):
        data = make_ping(dtype=dtype, gains=np.ones(5, np.uint32))
        assert np.shares_memory(ping_of(data).image, np.frombuffer(data, np.uint8))


def test_version_2_carries_attitude_water_and_settings(make_ping: MakePing) -> None:
    ping = ping_of(
        make_ping(
            heading_deg=270.0, pitch_deg=-5.0, roll_deg=180.0, temperature_c=8.5, pressure_bar=3.0
        )
    )
    assert ping.heading_rad == pytest.approx(math.radians(270.0))
    assert ping.pitch_rad == pytest.approx(math.radians(-5.0))
    assert ping.roll_rad == pytest.approx(math.pi)
    assert (ping.temperature_c, ping.pressure_bar) == (8.5, 3.0)
    assert (ping.range_setting_m, ping.salinity_ppt, ping.frequency_hz) == (10.0, 35.0, 750e3)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300, -361.0, 2.6e-76])
def test_impossible_readings_are_not_available(make_ping: MakePing, value: float) -> None:
    ping = ping_of(
        make_ping(
            heading_deg=value,
            pitch_deg=value,
            roll_deg=value,
            temperature_c=value,
            pressure_bar=value,
        )
    )
    readings = (ping.heading_rad, ping.pitch_rad, ping.roll_rad, ping.temperature_c)
    assert (*readings, ping.pressure_bar) == (None,) * 5


def test_numbers_that_are_invalid_stay_numbers_but_are_reported(make_ping: MakePing) -> None:
    nan = math.nan
    ping = ping_of(
        make_ping(
            frequency_hz=nan, gain_percent=math.inf, salinity_ppt=nan, range_m=nan, start_time=nan
        )
    )
    assert math.isnan(ping.frequency_hz)
    assert math.isnan(ping.gain_percent)
    assert math.isnan(ping.salinity_ppt)
    assert ping.range_setting_m is None
    assert ping.start_time_s is None
    assert ping.warnings == {"bad_frequency"}


def test_a_range_in_percent_is_not_taken_for_metres(make_ping: MakePing) -> None:
    assert ping_of(make_ping(flags=0x08)).range_setting_m is None


@pytest.mark.parametrize("speed", [0.0, -1.0, 1299.9, 1700.1, math.nan, math.inf, 1e-300])
def test_an_odd_sound_speed_is_reported_and_timing_uses_1500(
    make_ping: MakePing, speed: float
) -> None:
    ping = ping_of(make_ping(speed_of_sound_mps=speed))
    assert ping.warnings == {"odd_sound_speed"}
    start = ping.transmit_time_ns()
    assert start == 10**18 - round(2 * ping.max_range_m / 1500.0 * 1e9)


def test_without_a_stamp_there_is_no_time(make_ping: MakePing) -> None:
    ping = decode_ping(Message(0x23, 2, 0, 0, make_ping(), 0, None))
    assert isinstance(ping, Ping)
    assert ping.transmit_time_ns() is None
    assert ping.echo_time_ns(1.0) is None


def test_amplitude_takes_the_gain_out(make_ping: MakePing) -> None:
    image = np.full((3, 256), 60, np.uint8)
    gains = np.array([4, 0, 9], np.uint32)
    ping = ping_of(make_ping(image=image, gains=gains))
    amplitude = ping.amplitude()
    assert amplitude.dtype == np.float32
    np.testing.assert_allclose(amplitude[:, 0], [30.0, 0.0, 20.0])
    assert ping.row_valid.tolist() == [True, False, True]


def test_amplitude_without_gains_is_the_sample(make_ping: MakePing) -> None:
    ping = ping_of(make_ping())
    np.testing.assert_array_equal(ping.amplitude(), ping.image.astype(np.float32))
    assert ping.row_valid.all()


def test_amplitude_is_finite_at_full_scale(make_ping: MakePing) -> None:
    image = np.full((2, 256), 2**32 - 1, np.uint32)
    gains = np.array([1, 2**32 - 1], np.uint32)
    amplitude = ping_of(make_ping(image=image, gains=gains)).amplitude()
    assert np.isfinite(amplitude).all()
    np.testing.assert_allclose(amplitude[:, 0], [2.0**32, 2.0**16], rtol=1e-6)


def test_gain_words_are_read_by_size_not_by_flag(make_ping: MakePing) -> None:
    with_words = ping_of(make_ping(gains=np.ones(5, np.uint32), flags=0x09))
    without = ping_of(make_ping(flags=0x0D))
    assert with_words.gains is not None
    assert without.gains is None
    assert with_words.warnings == without.warnings == {"gain_flag"}
    np.testing.assert_array_equal(with_words.image, without.image)


@pytest.mark.parametrize("width", [1, 2, 3, 4])
def test_an_unknown_data_size_is_inferred_from_the_only_fit(
    make_ping: MakePing, width: int
) -> None:
    data = make_ping(dtype=np.uint32, image=np.full((5, 256), 77, np.uint32), data_size=width)
    ping = ping_of(patched(data, PING_RESULT_V2, data_size=9))
    assert ping.bits_per_sample == 8 * width
    assert (ping.image == 77).all()
    assert ping.warnings == {"bad_data_size"}


def test_rows_of_a_broken_number_of_bytes_are_dropped(make_ping: MakePing) -> None:
    data = make_ping() + b"\0"
    whole = patched(
        data,
        PING_RESULT_V2,
        image_size=PING_RESULT_V2.unpack(data)["image_size"] + 1,
        message_size=len(data),
        payload_size=len(data) - 16,
    )
    assert reason_of(whole) == "size_mismatch"


def test_ranges_are_those_of_the_rows_middles(make_ping: MakePing) -> None:
    ping = ping_of(make_ping())
    expected = (np.arange(ping.rows) + 0.5) * ping.range_resolution_m
    np.testing.assert_array_equal(ping.ranges_m, expected)


def test_an_unknown_data_size_with_two_fits_is_dropped(make_ping: MakePing) -> None:
    data = make_ping(beams=4)  # 4 beams of 2 bytes are also 4 of 1 byte and a gain word
    image_size = 5 * 8
    longer = data + bytes(image_size - 20)
    whole = patched(
        longer,
        PING_RESULT_V2,
        data_size=9,
        image_size=image_size,
        message_size=len(longer),
        payload_size=len(longer) - 16,
    )
    assert reason_of(whole) == "bad_data_size"


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"rows": 0}, "empty"),
        ({"beams": 0}, "empty"),
        ({"beams": 60000}, "out_of_bounds"),
        ({"image_offset": 2049}, "out_of_bounds"),
        ({"image_size": 2**32 - 1}, "out_of_bounds"),
        ({"image_offset": 2**32 - 1}, "out_of_bounds"),
        ({"image_offset": 700}, "size_mismatch"),
        ({"message_size": 5}, "size_mismatch"),
        ({"payload_size": 5}, "size_mismatch"),
        ({"image_size": 100}, "size_mismatch"),
        ({"rows": 6}, "size_mismatch"),
        ({"rows": 10}, "size_mismatch"),
        ({"data_size": 1}, "size_mismatch"),
        ({"range_resolution_m": 0.0}, "bad_resolution"),
        ({"range_resolution_m": -0.01}, "bad_resolution"),
        ({"range_resolution_m": math.nan}, "bad_resolution"),
        ({"range_resolution_m": math.inf}, "bad_resolution"),
        ({"range_resolution_m": 1e300}, "bad_resolution"),
        ({"range_resolution_m": 5e-324}, "bad_resolution"),
    ],
)
def test_a_ping_that_cannot_be_used_has_a_reason(
    make_ping: MakePing, changes: dict[str, Any], reason: str
) -> None:
    assert reason_of(patched(make_ping(), PING_RESULT_V2, **changes)) == reason


def test_an_image_over_the_table_is_a_mismatch(make_ping: MakePing) -> None:
    data = make_ping()
    over = {"image_offset": len(data) - 11 * 256, "image_size": 11 * 256, "rows": 11}
    assert over["image_offset"] < PING_RESULT_V2.size + 2 * 256
    assert reason_of(patched(data, PING_RESULT_V2, **over)) == "size_mismatch"


def test_two_beams_in_one_direction_are_reported(make_ping: MakePing) -> None:
    table = np.linspace(-6000, 6000, 256).astype(np.int16)
    table[7] = table[8]
    assert ping_of(make_ping(bearings_cdeg=table)).warnings == {"bad_bearings"}


def test_other_messages_are_no_pings(make_ping: MakePing, parse: Parse) -> None:
    reject = decode_ping(parse(encode_dummy()))
    assert isinstance(reject, Reject)
    assert reject.reason == "not_a_ping"
    assert reason_of(make_ping(), version=3) == "unknown_version"
    assert reason_of(make_ping()[:201]) == "short_message"
    assert reason_of(b"") == "short_message"


def test_version_1_fields_in_a_version_2_message_are_not_believed(make_ping: MakePing) -> None:
    assert reason_of(make_ping(version=1, rows=300), version=2) in {
        "empty",
        "out_of_bounds",
        "size_mismatch",
    }


def test_sizes_that_contradict_can_be_delivered_with_a_warning(make_ping: MakePing) -> None:
    data = patched(make_ping(), PING_RESULT_V2, message_size=5)
    ping = ping_of(data, deliver_mismatched=True)
    assert ping.warnings == {"size_mismatch"}
    np.testing.assert_array_equal(ping.image, ping_of(make_ping()).image)


def test_odd_fans_are_delivered_with_a_warning(make_ping: MakePing) -> None:
    assert ping_of(make_ping(beams=100)).warnings == {"odd_beams"}
    assert ping_of(make_ping(beams=1)).beam_edges_rad().shape == (2,)


@pytest.mark.parametrize("place", [0, 1, 255])
@pytest.mark.parametrize("value", [9001, -9001, 0, 32767])
def test_odd_bearings_are_delivered_with_a_warning(
    make_ping: MakePing, place: int, value: int
) -> None:
    data = bytearray(make_ping())
    struct.pack_into("<h", data, PING_RESULT_V2.size + 2 * place, value)
    ping = ping_of(bytes(data))
    assert ping.warnings == {"bad_bearings"}
    assert np.isfinite(ping.beam_edges_rad()).all()


def test_bearings_up_to_a_right_angle_are_good(make_ping: MakePing) -> None:
    table = np.linspace(-9000, 9000, 256).astype(np.int16)
    assert ping_of(make_ping(bearings_cdeg=table)).warnings == frozenset()


@pytest.mark.parametrize("version", [1, 2])
@given(data=st.data())
def test_any_fixed_part_gives_a_ping_or_a_reject(
    make_ping: MakePing, version: int, data: st.DataObject
) -> None:
    layout = PING_RESULT_V2 if version == 2 else PING_RESULT_V1
    fixed = data.draw(st.binary(min_size=layout.size, max_size=layout.size))
    sound = make_ping(version=version)
    kept = data.draw(st.integers(0, layout.size))
    check_total(fixed[:kept] + sound[kept:], version)
    check_total(sound[:kept] + fixed[kept:] + sound[layout.size :], version)


@given(st.data())
def test_any_change_of_a_field_gives_a_ping_or_a_reject(
    make_ping: MakePing, data: st.DataObject
) -> None:
    field = data.draw(st.sampled_from(PING_RESULT_V2.fields))
    size = struct.calcsize("<" + field.code)
    sound = make_ping(gains=np.ones(5, np.uint32))
    value = data.draw(st.binary(min_size=size, max_size=size))
    check_total(sound[: field.offset] + value + sound[field.offset + size :], 2)


def check_total(data: bytes, version: int) -> None:
    """Decode, and use all of a ping that comes out."""
    for mismatched in (False, True):
        ping = decode_ping(message_of(data, version), deliver_mismatched=mismatched)
        if isinstance(ping, Reject):
            continue
        assert ping.image.shape == (ping.rows, ping.beams) == (ping.ranges_m.size, ping.beams)
        assert np.isfinite(ping.amplitude()).all()
        assert np.isfinite(ping.beam_edges_rad()).all()
        assert 0.0 < ping.max_range_m <= 1000.0
        time = ping.echo_time_ns(ping.max_range_m)
        assert time is not None
        assert abs(time - 10**18) < 10**10


@pytest.mark.parametrize(
    "changes",
    [
        {"bearings_cdeg": np.zeros(255, np.int16)},
        {"gains": np.ones(4, np.uint32)},
        {"image": np.zeros((5, 256), np.int8)},
        {"image": np.full((5, 256), 300, np.uint16), "data_size": 1},
        {"data_size": 5},
        {"version": 3},
        {"ping_id": -1},
    ],
)
def test_what_cannot_be_sent_is_not_encoded(make_ping: MakePing, changes: dict[str, Any]) -> None:
    with pytest.raises(EncodeError):
        make_ping(**changes)
