import math
from datetime import UTC, datetime

import numpy as np
import pynmea2
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapperd.config.odometry import FormatSettings
from mapperd.errors import Reject
from mapperd.geometry.frames import quaternion_to_matrix
from mapperd.odometry.decoder import Decoder
from mapperd.odometry.formats import make_decoder
from mapperd.odometry.records import Odometry
from tests.support.odometry import assert_sound
from tests.support.peers.misbehaviour import Misbehaviour
from tests.support.peers.nmea_talker import NmeaTalker, sentence

SECOND = 1_000_000_000


def unix_ns(*date: int) -> int:
    return round(datetime(*date, tzinfo=UTC).timestamp()) * SECOND  # type: ignore[misc, arg-type]


NOON_NS = unix_ns(2023, 11, 14, 12)


def link() -> Decoder:
    return make_decoder(FormatSettings(format="nmea"))


def one(data: bytes, arrival_ns: int | None = None, decoder: Decoder | None = None) -> object:
    (result,) = (decoder or link()).feed(data, arrival_ns)
    return result


def record(data: bytes, arrival_ns: int | None = None, decoder: Decoder | None = None) -> Odometry:
    result = one(data, arrival_ns, decoder)
    assert isinstance(result, Odometry), result
    return result


def axes(data: bytes) -> np.ndarray:
    """Columns: where forward, port and up of the base point in the map."""
    quaternion = record(data).map_q_base
    assert quaternion is not None
    return quaternion_to_matrix(quaternion)


@given(
    st.floats(0, 89.99),
    st.floats(0, 179.99),
    st.sampled_from("NS"),
    st.sampled_from("EW"),
)
def test_place_is_what_pynmea2_makes_of_it(lat: float, lon: float, north: str, east: str) -> None:
    latitude = f"{int(lat):02d}{lat % 1 * 59.99:07.4f}"
    longitude = f"{int(lon):03d}{lon % 1 * 59.99:07.4f}"
    data = NmeaTalker().gga((latitude, north), (longitude, east))
    theirs = pynmea2.parse(data.decode())
    geo = record(data).geo
    assert geo is not None
    assert math.degrees(geo.latitude_rad) == pytest.approx(theirs.latitude, abs=1e-9)
    assert math.degrees(geo.longitude_rad) == pytest.approx(theirs.longitude, abs=1e-9)
    assert geo.altitude_m == 545.4


def test_altitude_that_is_not_reported_is_unknown() -> None:
    geo = record(NmeaTalker().gga(altitude="")).geo
    assert geo is not None
    assert geo.altitude_m is None


@pytest.mark.parametrize(
    ("compass_deg", "map_deg"), [("0.0", 90), ("90.0", 0), ("180.0", -90), ("315.0", 135)]
)
def test_heading_is_clockwise_from_north(compass_deg: str, map_deg: float) -> None:
    found = record(NmeaTalker().hdt(compass_deg))
    assert found.heading_rad == pytest.approx(math.radians(map_deg))
    assert (found.stamp_ns, found.clock) == (0, "arrival")


@pytest.mark.parametrize(("course", "east_north"), [("90.0", [1, 0]), ("0.0", [0, 1])])
def test_course_is_a_velocity_in_metres(course: str, east_north: list[float]) -> None:
    expected = pytest.approx(2 * 1852 / 3600 * np.array(east_north), abs=1e-9)
    talker = NmeaTalker()
    for data in (talker.vtg(course), talker.rmc(course=course)):
        found = record(data)
        assert found.velocity_east_north_mps == expected
        assert found.velocity_map_mps is None
    only_kmh = record(talker.vtg(course, knots="")).velocity_east_north_mps
    assert only_kmh == pytest.approx(3.704 / 3.6 * np.array(east_north), abs=1e-9)


def test_prdid_is_pitch_roll_heading() -> None:
    nose_up = axes(NmeaTalker().prdid("30", "0", "90"))
    assert nose_up[:, 0] == pytest.approx([math.sqrt(0.75), 0, 0.5])
    starboard_down = axes(NmeaTalker().prdid("0", "30", "90"))
    assert starboard_down[:, 0] == pytest.approx([1, 0, 0], abs=1e-9)
    assert starboard_down[:, 1] == pytest.approx([0, math.sqrt(0.75), 0.5], abs=1e-9)


def test_pashr_is_heading_roll_pitch() -> None:
    nose_up = axes(NmeaTalker().pashr("90.00", "+0.00", "+30.00"))
    assert nose_up[:, 0] == pytest.approx([math.sqrt(0.75), 0, 0.5])
    starboard_down = axes(NmeaTalker().pashr("90.00", "+30.00", "+0.00"))
    assert starboard_down[:, 1] == pytest.approx([0, math.sqrt(0.75), 0.5], abs=1e-9)


def test_published_prdid_is_read() -> None:
    found = axes(b"$PRDID,-1.31,7.81,47.31*68\r\n")
    heading = math.degrees(math.atan2(found[0, 0], found[1, 0]))
    assert heading == pytest.approx(47.31)
    assert math.degrees(math.asin(found[2, 0])) == pytest.approx(-1.31)


def test_time_of_day_gets_the_date_nearest_to_the_hosts() -> None:
    talker = NmeaTalker("235959.50")
    midnight_ns = unix_ns(2023, 11, 15)
    for arrival_ns in (midnight_ns + SECOND, midnight_ns - SECOND):
        found = record(talker.gga(), arrival_ns)
        assert (found.stamp_ns, found.clock) == (midnight_ns - SECOND // 2, "unix")


def test_date_of_the_sender_comes_before_the_hosts() -> None:
    decoder, talker = link(), NmeaTalker("235959.00")
    record(talker.rmc(), unix_ns(2000, 1, 1), decoder)
    talker.time = "000000.25"
    past_midnight = record(talker.gga(), unix_ns(2000, 1, 1), decoder)
    assert past_midnight.stamp_ns == unix_ns(2023, 11, 15) + SECOND // 4
    talker.date = "151123"
    assert record(talker.rmc(), None, decoder).stamp_ns == past_midnight.stamp_ns


def test_zda_reports_the_date() -> None:
    decoder = link()
    assert list(decoder.feed(NmeaTalker().zda(), None)) == []
    assert record(NmeaTalker().gga(), None, decoder).stamp_ns == NOON_NS + SECOND // 2


@pytest.mark.parametrize("arrival_ns", [None, 5 * SECOND])
def test_time_of_day_without_any_date_is_no_stamp(arrival_ns: int | None) -> None:
    found = record(NmeaTalker().gga(), arrival_ns)
    assert (found.stamp_ns, found.clock) == (0, "arrival")


def test_check_in_lower_case_will_do() -> None:
    data = sentence("HEHDT,1.0,T")
    lower = data[:-4] + data[-4:].lower()
    assert lower != data
    assert record(lower).heading_rad is not None


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (NmeaTalker().gga(quality="0"), "no_fix"),
        (NmeaTalker().rmc(status="V"), "no_fix"),
        (NmeaTalker().vtg(course=""), "no_fix"),
        (NmeaTalker().gga(lat=("", "")), "wrong_shape"),
        (NmeaTalker().gga(lat=("9107.0", "N")), "wrong_shape"),
        (NmeaTalker().gga(lat=("4860.0", "N")), "wrong_shape"),
        (NmeaTalker().gga(lat=("04807.0", "N")), "wrong_shape"),
        (NmeaTalker().gga(lat=("4807.0", "E")), "wrong_shape"),
        (NmeaTalker().gga(altitude="1e9"), "wrong_shape"),
        (NmeaTalker().gga(altitude="99999"), "wrong_shape"),
        (NmeaTalker("250000").gga(), "wrong_shape"),
        (NmeaTalker().rmc(date="321323"), "wrong_shape"),
        (NmeaTalker().rmc(knots="inf"), "wrong_shape"),
        (NmeaTalker().zda(year="9999"), "wrong_shape"),
        (NmeaTalker().zda(year=""), "wrong_shape"),
        (NmeaTalker().hdt("nan"), "wrong_shape"),
        (NmeaTalker().hdt(""), "wrong_shape"),
        (NmeaTalker().hdt("361"), "wrong_shape"),
        (NmeaTalker().vtg(knots="", kmh=""), "wrong_shape"),
        (NmeaTalker().prdid("91", "0", "0"), "wrong_shape"),
        (NmeaTalker().prdid("", "0", "0"), "wrong_shape"),
        (sentence("HEHDT"), "not_a_sentence"),
        (sentence("GPGGA,120000"), "wrong_shape"),
        (b"$HEHDT,90.0,T*00\r\n", "bad_checksum"),
        (b"$HEHDT,90.0,T\r\n", "bad_checksum"),
        (b"hello\r\n", "not_a_sentence"),
        (b"$\xff\xfe\r\n", "not_a_sentence"),
        (b"$" + b"x" * 600 + b"\r\n", "too_long"),
    ],
)
def test_bad_sentence_is_rejected_with_a_reason(data: bytes, reason: str) -> None:
    result = one(data)
    assert isinstance(result, Reject), result
    assert result.reason == reason


def test_other_sentences_are_passed_over() -> None:
    decoder = link()
    data = sentence("GPGSV,1,1,00") + sentence("XXABC,1") + sentence("PASHR,LTN,5")
    assert list(decoder.feed(data, None)) == []
    assert decoder.counters.ignored.total() == 3
    assert decoder.counters.bytes_skipped == 0


@given(st.lists(st.binary(max_size=80), max_size=8))
def test_any_bytes_give_records_or_rejects(pieces: list[bytes]) -> None:
    decoder = link()
    for piece in [*pieces, b"\n"]:
        for result in decoder.feed(piece, NOON_NS):
            assert isinstance(result, Reject)


NAMES = ("GPGGA", "GPRMC", "GPVTG", "HEHDT", "PRDID", "PASHR", "PASHR,LTN", "GPZDA", "PXXX", "P")
fields = st.text("0123456789.,-+NSEWTAVMK", max_size=60)


@given(st.sampled_from(NAMES), fields)
def test_any_fields_give_records_or_rejects(name: str, text: str) -> None:
    assert_sound(link().feed(sentence(f"{name},{text}"), NOON_NS))


@given(st.text(st.characters(max_codepoint=126, min_codepoint=32), max_size=40))
def test_any_sentence_gives_records_or_rejects(text: str) -> None:
    assert_sound(link().feed(sentence(text), NOON_NS))


def test_bad_line_loses_only_what_it_spoils() -> None:
    decoder = link()
    bad = Misbehaviour(drop=0.1, garble=0.1, noise=0.1, max_bytes=30)
    messages = [NmeaTalker().prdid("1.0", "2.0", str(n)) for n in range(300)]
    found = [r for piece in bad.pieces(messages) for r in decoder.feed(piece, None)]
    assert sum(isinstance(result, Odometry) for result in found) > 200
    assert decoder.counters.rejects.total() > 20


def test_a_heading_does_not_level_a_vehicle_that_leans() -> None:
    talker = NmeaTalker()
    decoder = make_decoder(FormatSettings(format="nmea"))
    stated = talker.hdt("90.0") + talker.prdid("6.0", "0.0", "90.0") + talker.hdt("90.0")
    alone, leaning = decoder.feed(stated, 0)
    assert isinstance(alone, Odometry)
    assert alone.heading_rad is not None
    assert isinstance(leaning, Odometry)
    assert leaning.map_q_base is not None
    assert list(decoder.feed(talker.hdt("90.0"), 3 * 10**9)) == []
    assert decoder.counters.ignored == {"superseded": 2}
