import math
from collections.abc import Callable
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapperd.errors import Reject
from mapperd.odometry.native import (
    MAX_RECORD_BYTES,
    NativeDecoder,
    NativeRecord,
    decode_native,
    encode_native,
)
from mapperd.odometry.records import Odometry
from tests.support.odometry import assert_sound

GOOD: dict[str, Any] = {
    "v": 1,
    "t": 5,
    "clk": "unix",
    "w": "enu",
    "b": "flu",
    "p": [1.0, 2.0, 3.0],
    "q": [1.0, 0.0, 0.0, 0.0],
}


def packed(**changes: Any) -> bytes:
    data: bytes = msgpack.packb({k: v for k, v in (GOOD | changes).items() if v is not None})
    return data


def accepted(**changes: Any) -> Odometry:
    odometry = decode_native(packed(**changes))
    assert isinstance(odometry, Odometry), odometry
    return odometry


def triangle(matrix: np.ndarray) -> list[float]:
    return [float(number) for number in matrix[np.triu_indices(6)]]


def test_record_in_our_frames_comes_out_as_it_is() -> None:
    odometry = accepted(u=[1, 0, 0], r=[0, 0, 0.1], rst=3, src="ekf")
    assert odometry.stamp_ns == 5
    assert odometry.clock == "unix"
    assert odometry.position_m == pytest.approx([1, 2, 3])
    assert odometry.map_q_base == pytest.approx([1, 0, 0, 0])
    assert odometry.velocity_mps == pytest.approx([1, 0, 0])
    assert odometry.rate_radps == pytest.approx([0, 0, 0.1])
    assert odometry.reset_count == 3
    assert odometry.source == "ekf"


def test_unknown_is_not_zero() -> None:
    odometry = accepted(p=None, q=None)
    for name in ("position_m", "map_q_base", "velocity_mps", "rate_radps"):
        assert getattr(odometry, name) is None
    assert odometry.pose_covariance is None
    assert odometry.twist_covariance is None


def test_ned_frd_record_is_converted() -> None:
    odometry = accepted(w="ned", b="frd", u=[1, 2, 3], r=[0.1, 0.2, 0.3])
    assert odometry.position_m == pytest.approx([2, 1, -3])
    half = math.sqrt(0.5)
    assert abs(float(odometry.map_q_base @ [half, 0, 0, half])) == pytest.approx(1)  # type: ignore[operator]
    assert odometry.velocity_mps == pytest.approx([1, -2, -3])
    assert odometry.rate_radps == pytest.approx([0.1, -0.2, -0.3])


@pytest.mark.parametrize(("world", "place"), [("local_flu", [1, 2, 3]), ("local_frd", [1, -2, -3])])
def test_world_of_arbitrary_heading_is_reported(world: str, place: list[float]) -> None:
    odometry = accepted(w=world)
    assert odometry.position_m == pytest.approx(place)
    assert not odometry.north_referenced
    assert accepted().north_referenced


def test_level_vehicle_at_the_start_of_a_local_world_is_not_turned() -> None:
    quaternion = accepted(w="local_frd", b="frd").map_q_base
    assert quaternion is not None
    assert abs(quaternion) == pytest.approx([1, 0, 0, 0])


def test_covariance_turns_with_its_axes() -> None:
    theirs = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    theirs[0, 1] = theirs[1, 0] = 0.5  # north with east
    theirs[0, 2] = theirs[2, 0] = 0.25  # north with down
    theirs[2, 3] = theirs[3, 2] = 0.125  # down with rotation about north
    pose = accepted(w="ned", b="frd", pc=triangle(theirs)).pose_covariance
    assert pose is not None
    assert np.diag(pose) == pytest.approx([2, 1, 3, 5, 4, 6])
    assert pose[1, 0] == pytest.approx(0.5)  # east with north, as before
    assert pose[1, 2] == pytest.approx(-0.25)  # north with up
    assert pose[2, 4] == pytest.approx(-0.125)
    assert pose == pytest.approx(pose.T)
    twist = accepted(w="ned", b="frd", uc=triangle(theirs)).twist_covariance
    assert twist is not None
    assert np.diag(twist) == pytest.approx([1, 2, 3, 4, 5, 6])
    assert twist[0, 1] == pytest.approx(-0.5)


def test_arrays_are_read_only() -> None:
    position = accepted().position_m
    assert position is not None
    with pytest.raises(ValueError, match="read-only"):
        position[0] = 1


def test_slightly_unnormalised_quaternion_is_normalised() -> None:
    quaternion = accepted(q=[1.005, 0, 0, 0]).map_q_base
    assert quaternion == pytest.approx([1, 0, 0, 0], abs=1e-12)


def test_stamp_may_be_absent_only_without_a_clock() -> None:
    assert accepted(t=None, clk="arrival").stamp_ns == 0


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"v": 2}, "version"),
        ({"v": None}, "wrong_shape"),
        ({"t": None}, "no_stamp"),
        ({"t": -1}, "wrong_shape"),
        ({"t": 2**63}, "wrong_shape"),
        ({"t": 1.5}, "wrong_shape"),
        ({"clk": "gps"}, "wrong_shape"),
        ({"clk": None}, "wrong_shape"),
        ({"w": None}, "wrong_shape"),
        ({"w": "frd"}, "wrong_shape"),
        ({"b": "ned"}, "wrong_shape"),
        ({"p": [1, 2]}, "wrong_shape"),
        ({"p": [1, 2, 3, 4]}, "wrong_shape"),
        ({"p": "abc"}, "wrong_shape"),
        ({"p": [1, 2, True]}, "wrong_shape"),
        ({"p": [math.nan, 0, 0]}, "not_finite"),
        ({"p": [math.inf, 0, 0]}, "not_finite"),
        ({"p": [1e300, 0, 0]}, "out_of_range"),
        ({"q": [1, 0, 0]}, "wrong_shape"),
        ({"q": [0, 0, 0, 0]}, "zero_quaternion"),
        ({"q": [1e-200, 0, 0, 0]}, "zero_quaternion"),
        ({"q": [math.nan, 0, 0, 1]}, "not_finite"),
        ({"q": [0.5, 0, 0, 0]}, "unnormalised_quaternion"),
        ({"q": [2, 0, 0, 0]}, "unnormalised_quaternion"),
        ({"q": [1e308, 1e308, 0, 0]}, "out_of_range"),
        ({"u": [1e6, 0, 0]}, "out_of_range"),
        ({"u": [math.nan] * 3}, "not_finite"),
        ({"r": [0, 0, -math.inf]}, "not_finite"),
        ({"pc": [0.0] * 20}, "wrong_shape"),
        ({"pc": [math.nan] * 21}, "not_finite"),
        ({"pc": [-1.0] + [0.0] * 20}, "negative_variance"),
        ({"uc": [1e300] * 21}, "out_of_range"),
        ({"rst": -1}, "wrong_shape"),
        ({"src": "x" * 65}, "wrong_shape"),
        ({"src": 5}, "wrong_shape"),
        ({"pp": [1, 2, 3]}, "wrong_shape"),
    ],
)
def test_bad_record_is_rejected_with_a_reason(changes: dict[str, Any], reason: str) -> None:
    reject = decode_native(packed(**changes))
    assert isinstance(reject, Reject), reject
    assert reject.reason == reason
    assert reject.detail


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "not_msgpack"),
        (b"\xc1", "not_msgpack"),
        (packed()[:-1], "not_msgpack"),
        (packed() + b"\x00", "not_msgpack"),
        (b"\xdf\xff\xff\xff\xff", "not_msgpack"),
        (b"\x81\xa1v\xdd\xff\xff\xff\xff", "wrong_shape"),
        (b"\x81\xa1p\xdd\xff\xff\xff\xff", "wrong_shape"),
        (b"\x81\xdb\xff\xff\xff\xffa", "not_msgpack"),
        (b"\x81\xa1\xff\x01", "not_msgpack"),
        (b"\x91" * 2000, "wrong_shape"),
        (b"\x81\xa1p" + b"\x91" * 2000, "wrong_shape"),
        (b"\x93\x01\x02\x03", "wrong_shape"),
        (b"hello", "wrong_shape"),
        (bytes(MAX_RECORD_BYTES + 1), "too_long"),
    ],
)
def test_bytes_that_are_no_record_are_rejected(data: bytes, reason: str) -> None:
    reject = decode_native(data)
    assert isinstance(reject, Reject)
    assert reject.reason == reason


@given(st.binary(max_size=300))
def test_any_bytes_give_a_record_or_a_reject(data: bytes) -> None:
    assert_sound([decode_native(data)])


@given(st.data())
def test_damaged_record_never_raises(data: st.DataObject) -> None:
    record = bytearray(packed(u=[1, 2, 3], pc=[0.5] * 21, rst=2, src="dvl"))
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(record) - 1))
        record[place] = data.draw(st.integers(0, 255))
    assert_sound([decode_native(bytes(record))])


def test_encoder_writes_the_documented_keys_and_leaves_out_the_unknown() -> None:
    data = encode_native(
        NativeRecord(v=1, t=5, clk="boot", w="ned", b="frd", p=(1.0, 2.0, 3.0), src="x")
    )
    assert msgpack.unpackb(data) == {
        "v": 1,
        "t": 5,
        "clk": "boot",
        "w": "ned",
        "b": "frd",
        "p": [1.0, 2.0, 3.0],
        "src": "x",
    }


def test_encoded_record_is_read_back(odometry_bytes: Callable[..., bytes]) -> None:
    full = odometry_bytes(
        u=(0.1, 0.2, 0.3), r=(0.0, 0.0, 0.1), pc=(0.5,) * 21, uc=(0.25,) * 21, rst=9, src="ekf"
    )
    assert len(full) < MAX_RECORD_BYTES / 2
    odometry = decode_native(full)
    assert isinstance(odometry, Odometry)
    assert odometry.pose_covariance == pytest.approx(np.full((6, 6), 0.5))
    assert odometry.reset_count == 9


def test_datagrams_are_counted() -> None:
    decoder = NativeDecoder()
    for data in (packed(), b"hello", packed(p=[math.nan, 0.0, 0.0])):
        list(decoder.feed(data, None))
    counters = decoder.counters
    assert counters.bytes_total == 2 * len(packed()) + 5
    assert counters.bytes_skipped == 5
    assert counters.records == 1
    assert counters.rejects == {"wrong_shape": 1, "not_finite": 1}
    assert counters.messages == {"record": 2}
