"""Both protocols of the DVL; the examples are those of the maker's protocol pages."""

import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapperd.config.odometry import FormatSettings
from mapperd.errors import Reject
from mapperd.geometry.frames import quaternion_to_matrix
from mapperd.odometry.decoder import Decoder
from mapperd.odometry.formats import make_decoder
from mapperd.odometry.records import UNKNOWN_VARIANCE, Odometry
from mapperd.odometry.water_linked import crc8
from tests.support.odometry import assert_sound
from tests.support.peers import dvl as peer
from tests.support.peers.dvl import Dvl, sentence
from tests.support.peers.misbehaviour import Misbehaviour

SECOND = 1_000_000_000
T_US = 1_700_000_000_000_000
small = st.floats(-20, 20, width=16)
triples = st.tuples(small, small, small)

PAGE_VELOCITY = b"""{ "time": 106.3935775756836, "vx": -3.713480691658333e-05,
 "vy": 5.703703573090024e-05, "vz": 2.4990416932269e-05, "fom": 0.00016016385052353144,
 "covariance": [
  [2.4471841442164077e-08, -3.3937477272871774e-09, -1.6659699175747278e-09],
  [-3.3937477272871774e-09, 1.4654466085062268e-08, 4.0409570134514183e-10],
  [-1.6659699175747278e-09, 4.0409570134514183e-10, 1.5971971523143225e-09]],
 "altitude": 0.4949815273284912, "transducers": [
  {"id": 0, "velocity": 0.00010825289791682735, "distance": 0.5568000078201294,
   "rssi": -30.494251251220703, "nsd": -88.73271179199219, "beam_valid": true}],
 "velocity_valid": true, "status": 0, "tracking_mode": "bottom", "format": "json_v3.2",
 "type": "velocity", "time_of_validity": 1638191471563017,
 "time_of_transmission": 1638191471752336 }""".replace(b"\n", b"")

PAGE_POSITION = b"""{ "ts": 49056.809, "x": 12.43563613697886467, "y": 64.617631152402609587,
 "z": 1.767641898933798075, "std": 0.001959984190762043, "roll": 0.6173566579818726,
 "pitch": 0.6173566579818726, "yaw": 0.6173566579818726, "type": "position_local", "status": 0,
 "format": "json_v3.1" }""".replace(b"\n", b"")

PAGE_RESPONSE = b"""{ "response_to":"get_config", "success":true, "error_message":"",
 "result":{ "speed_of_sound":1475.00, "acoustic_enabled":true, "dark_mode_enabled":false,
 "mounting_rotation_offset":20.00, "range_mode":"auto", "periodic_cycling_enabled":true },
 "format":"json_v3.1", "type":"response" }""".replace(b"\n", b"")

PAGE_SENTENCES = [
    b"wrz,0.120,-0.400,2.000,y,1.30,1.855,1e-07;0;1.4;0;1.2;0;0.2;0;1e+09,7,14,123.00,1*50",
    b"wrs,0.120,-0.400,2.000,y,1.855,1e-07;0;1.4;0;1.2;0;0.2;0;1e+09,7,14,123.00,1*50",
    b"wru,0,0.070,1.10,-40,-95*9c",
    b"wru,1,-0.500,1.25,-62,-104*f0",
    b"wru,2,2.200,1.40,-56,-98*18",
    b"wru,3,1.800,1.35,-58,-96*a3",
    b"wrp,49056.809,0.41,0.15,1.23,0.4,53.9,13.0,19.3,0*de",
    b"wrp,49057.269,0.39,0.18,1.23,0.4,53.9,13.0,19.3,0*e2",
]


def json_link() -> Decoder:
    return make_decoder(FormatSettings(format="water_linked_json"))


def serial_link() -> Decoder:
    return make_decoder(FormatSettings(format="water_linked_serial"))


LINKS = pytest.mark.parametrize("link", [json_link, serial_link])


def one(link: Decoder, data: bytes) -> Odometry | Reject:
    (result,) = link.feed(data, None)
    return result


def record(link: Decoder, data: bytes) -> Odometry:
    result = one(link, data)
    assert isinstance(result, Odometry), result
    return result


def test_velocity_of_the_makers_page() -> None:
    found = record(json_link(), PAGE_VELOCITY + b"\r\n")
    assert found.velocity_mps == pytest.approx([-3.713480e-05, -5.703703e-05, -2.499041e-05])
    assert found.altitude_m == pytest.approx(0.49498, abs=1e-5)
    assert (found.stamp_ns, found.clock) == (1_638_191_471_563_017_000, "unix")
    assert found.sent_ns == 1_638_191_471_752_336_000
    assert found.valid
    covariance = found.twist_covariance
    assert covariance is not None
    assert np.diag(covariance)[:3] == pytest.approx([2.447e-08, 1.4654e-08, 1.597e-09], rel=1e-3)
    assert covariance[0, 1] == pytest.approx(3.3937e-09, rel=1e-4)  # forward with port
    assert covariance[1, 2] == pytest.approx(4.0409e-10, rel=1e-4)
    assert np.diag(covariance)[3:] == pytest.approx([UNKNOWN_VARIANCE] * 3)


def test_position_of_the_makers_page() -> None:
    found = record(json_link(), PAGE_POSITION + b"\n")
    assert found.position_m == pytest.approx([12.4356361, -64.6176312, -1.7676419])
    assert (found.stamp_ns, found.clock) == (49_056_809_000_000, "boot")  # its clock is not set
    assert found.sent_ns is None
    assert not found.north_referenced


def test_answers_to_commands_are_passed_over() -> None:
    link = json_link()
    assert list(link.feed(PAGE_RESPONSE + b"\n" + Dvl().response(), None)) == []
    assert link.counters.ignored == {"response": 2}


def test_sentences_of_the_makers_page_have_this_check() -> None:
    # The page's wrs carries the check of its wrz: the maker's slip.
    for line in PAGE_SENTENCES[:1] + PAGE_SENTENCES[2:]:
        body, _, check = line.partition(b"*")
        assert f"{crc8(body):02x}".encode() == check
        assert peer.crc8(body) == crc8(body)


def test_sentences_of_the_makers_page() -> None:
    link = serial_link()
    velocity, bad, first, second = link.feed(b"\r\n".join(PAGE_SENTENCES) + b"\r\n", None)
    assert isinstance(velocity, Odometry)
    assert velocity.velocity_mps == pytest.approx([0.12, 0.4, -2.0])
    assert velocity.altitude_m == 1.3
    assert velocity.confidence == 0.0  # 1.855 m/s
    assert (velocity.stamp_ns, velocity.clock, velocity.sent_ns) == (7000, "boot", 14000)
    assert velocity.twist_covariance == pytest.approx(
        UNKNOWN_VARIANCE * np.eye(6)
    )  # it reports 1e9
    assert isinstance(bad, Reject)
    assert bad.reason == "bad_checksum"
    assert isinstance(first, Odometry)
    assert first.position_m == pytest.approx([0.41, -0.15, -1.23])
    assert isinstance(second, Odometry)
    assert second.stamp_ns == 49_057_269_000_000
    assert link.counters.ignored == {"wru": 4}
    assert link.counters.warnings == {"overheating": 1}


@given(triples)
def test_velocity_is_forward_starboard_down(frd: tuple[float, ...]) -> None:
    x, y, z = frd
    for data, link in (
        (Dvl().velocity(frd), json_link()),
        (Dvl().velocity_sentence(frd), serial_link()),
    ):
        found = record(link, data)
        assert found.velocity_mps == pytest.approx([x, -y, -z], abs=5.1e-4)
        assert found.velocity_map_mps is None
        assert found.altitude_m == 2.5
        assert found.confidence == pytest.approx(0.95)
        assert (found.stamp_ns, found.sent_ns) == (T_US * 1000, (T_US + 147_000) * 1000)


@given(triples)
def test_position_is_from_where_it_was_reset(frd: tuple[float, ...]) -> None:
    x, y, z = frd
    for data, link in (
        (Dvl().position(frd), json_link()),
        (Dvl().position_sentence(frd), serial_link()),
    ):
        found = record(link, data)
        assert found.position_m == pytest.approx([x, -y, -z], abs=5.1e-3)
        assert (found.stamp_ns, found.clock) == (T_US * 1000, "unix")
        assert found.pose_covariance is not None
        assert np.diag(found.pose_covariance) == pytest.approx([0.01] * 3 + [1e6] * 3)


@pytest.mark.parametrize(
    ("rpy_deg", "forward", "port"),
    [
        ((0, 0, 90), [0, -1, 0], [1, 0, 0]),  # to starboard
        ((0, 30, 0), [math.sqrt(0.75), 0, 0.5], [0, 1, 0]),  # nose up
        ((30, 0, 0), [1, 0, 0], [0, math.sqrt(0.75), 0.5]),  # starboard down
    ],
)
def test_angles_are_degrees(
    rpy_deg: tuple[float, ...], forward: list[float], port: list[float]
) -> None:
    roll, pitch, yaw = rpy_deg
    for data, link in (
        (Dvl().position(roll=roll, pitch=pitch, yaw=yaw), json_link()),
        (Dvl().position_sentence(rpy_deg=rpy_deg), serial_link()),
    ):
        quaternion = record(link, data).map_q_base
        assert quaternion is not None
        axes = quaternion_to_matrix(quaternion)
        assert axes[:, 0] == pytest.approx(forward, abs=1e-9)
        assert axes[:, 1] == pytest.approx(port, abs=1e-9)


@pytest.mark.parametrize(
    ("link", "data"),
    [
        (json_link, Dvl().velocity(velocity_valid=False, altitude=-1, fom=2e9)),
        (serial_link, Dvl().velocity_sentence(valid=False)),
        (json_link, Dvl().position(status=1)),
        (serial_link, Dvl().position_sentence(status=1)),
    ],
)
def test_report_of_a_lost_dvl_is_a_time_and_nothing_else(
    link: Callable[[], Decoder], data: bytes
) -> None:
    found = record(link(), data)
    assert not found.valid
    assert found.stamp_ns == T_US * 1000
    for name in ("velocity_mps", "position_m", "map_q_base", "altitude_m", "confidence"):
        assert getattr(found, name) is None


def test_velocity_through_the_water_is_not_over_ground() -> None:
    link = json_link()
    water = Dvl().velocity(type="velocity_water") + Dvl().velocity(tracking_mode="water")
    assert list(link.feed(water, None)) == []
    assert link.counters.ignored == {"velocity_water": 2}
    link = serial_link()
    clock = sentence("wrs,1,2,3,4") + sentence("wrs,0.1,0.2,0.3,y,0.1,1;0;0;0;1;0;0;0;1,7,14,1,0")
    assert list(link.feed(clock, None)) == []
    assert link.counters.ignored == {"wrs": 2}


def test_old_firmware_without_times_is_stamped_by_arrival() -> None:
    report = json.loads(Dvl().velocity())
    del report["time_of_validity"], report["time_of_transmission"], report["covariance"]
    found = record(json_link(), json.dumps(report).encode() + b"\n")
    assert (found.clock, found.sent_ns) == ("arrival", None)
    assert found.twist_covariance is not None
    assert found.twist_covariance[0, 0] == pytest.approx(0.02**2)


def test_no_altitude_is_unknown() -> None:
    assert record(json_link(), Dvl().velocity(altitude=-1)).altitude_m is None


def test_heat_is_a_warning() -> None:
    for link, data in (
        (json_link(), Dvl().velocity(status=1)),
        (serial_link(), Dvl().velocity_sentence(status=1)),
    ):
        record(link, data)
        assert link.counters.warnings == {"overheating": 1}


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (Dvl().velocity(format="json_v4"), "version"),
        (Dvl().velocity(format="json_v30"), "version"),
        (Dvl().velocity(vx="fast"), "wrong_shape"),
        (Dvl().velocity(vx=None), "wrong_shape"),
        (Dvl().velocity(covariance=[[1, 2], [3, 4]]), "wrong_shape"),
        (Dvl().velocity(vx=1e6), "out_of_range"),
        (Dvl().velocity(covariance=[[1e300] * 3] * 3), "out_of_range"),
        (Dvl().velocity(fom=-1), "out_of_range"),
        (Dvl().velocity(time_of_validity=10**17), "out_of_range"),
        (Dvl().velocity(time_of_validity=-1), "out_of_range"),
        (Dvl().velocity(time_of_validity=1.5), "wrong_shape"),
        (Dvl().position(ts=1e12), "out_of_range"),
        (Dvl().position(yaw=1e4), "out_of_range"),
        (Dvl().position(std=-1), "out_of_range"),
        (b'{"type": "velocity"}\n', "wrong_shape"),
        (b"[1, 2, 3]\n", "wrong_shape"),
        (b'{"type": "velocity", "vx": NaN}\n', "not_json"),
        (b'{"x": ' + b"[" * 5000 + b"\n", "not_json"),
        (b"\xff\xfe\n", "not_json"),
        (b"hello\n", "not_json"),
        (b"x" * 20000 + b"\n", "too_long"),
    ],
)
def test_bad_report_is_rejected_with_a_reason(data: bytes, reason: str) -> None:
    result = one(json_link(), data)
    assert isinstance(result, Reject), result
    assert result.reason == reason


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"wrz,1*zz\n", "bad_checksum"),
        (b"wrp,1,2,3*FF\n", "bad_checksum"),
        (b"hello\n", "not_a_sentence"),
        (b"wcr*00\n", "not_a_sentence"),
        (sentence("wrz,1,2,3"), "wrong_shape"),
        (sentence("wrz,a,b,c,y,1,1,1;1;1;1;1;1;1;1;1,1,1,1,0"), "wrong_shape"),
        (sentence("wrz,nan,0,0,y,1,1,1;0;0;0;1;0;0;0;1,1,1,1,0"), "wrong_shape"),
        (sentence("wrz,1e9,0,0,y,1,1,1;0;0;0;1;0;0;0;1,1,1,1,0"), "out_of_range"),
        (sentence("wrz,0,0,0,x,1,1,1;0;0;0;1;0;0;0;1,1,1,1,0"), "wrong_shape"),
        (sentence("wrp,1,2,3,4,5,6,7,8"), "wrong_shape"),
        (sentence("wrp,1,2,3,4,5,6,7,8,9,10"), "wrong_shape"),
    ],
)
def test_bad_sentence_is_rejected_with_a_reason(data: bytes, reason: str) -> None:
    result = one(serial_link(), data)
    assert isinstance(result, Reject), result
    assert result.reason == reason


@pytest.mark.parametrize("end", [b"\n", b"\r\n", b"\r"])
def test_every_line_end_will_do(end: bytes) -> None:
    link = serial_link()
    data = Dvl().velocity_sentence().rstrip() + end
    assert len(list(link.feed(data * 3, None))) == 3


@LINKS
@given(st.lists(st.binary(max_size=60), max_size=10))
def test_any_bytes_give_records_or_rejects(
    link: Callable[[], Decoder], pieces: list[bytes]
) -> None:
    decoder = link()
    for piece in [*pieces, b"\n"]:
        for result in decoder.feed(piece, None):
            assert isinstance(result, Reject)


words = st.text("0123456789.,;-+eyninfa", max_size=40)


@given(st.sampled_from(("wrz", "wrp", "wrs", "wrn")), words)
def test_any_fields_give_records_or_rejects(name: str, fields: str) -> None:
    assert_sound(serial_link().feed(sentence(f"{name},{fields}"), None))


json_values: st.SearchStrategy[Any] = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner),
    max_leaves=6,
)


@given(st.sampled_from(sorted(json.loads(Dvl().velocity()))), json_values)
def test_any_field_gives_a_record_or_a_reject(key: str, value: Any) -> None:
    results = list(json_link().feed(Dvl().velocity(**{key: value}), None))
    assert_sound(results)
    assert len(results) <= 1


@pytest.mark.parametrize(
    ("link", "message"), [(json_link, "velocity"), (serial_link, "velocity_sentence")]
)
def test_bad_line_loses_only_what_it_spoils(link: Callable[[], Decoder], message: str) -> None:
    dvl, decoder = Dvl(), link()
    bad = Misbehaviour(drop=0.1, garble=0.1, noise=0.1, max_bytes=200)
    messages = [getattr(dvl, message)() for _ in range(300)]
    found = [r for piece in bad.pieces(messages) for r in decoder.feed(piece, None)]
    assert sum(isinstance(result, Odometry) for result in found) > 200
    assert decoder.counters.rejects.total() > 20


@pytest.mark.parametrize("key", ["time_of_validity", "time_of_transmission"])
def test_a_time_of_hundreds_of_digits_is_refused(key: str) -> None:
    """JSON holds integers that no float can."""
    changes: dict[str, Any] = {key: 10**400}
    result = one(json_link(), Dvl().velocity(**changes))
    assert isinstance(result, Reject)
    assert result.reason == "out_of_range"
