"""States into bytes and back: equal ones, and nothing else than states."""

import random
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from mapperd.config.tree import Config
from mapperd.errors import CheckpointError
from mapperd.odometry.records import Odometry
from mapperd.odometry.series import Sample, Series
from mapperd.odometry.states import BasePosition
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.decoder import SessionDecoder, SessionDecoderState
from mapperd.pipeline.pose_lookup import FixedPose, OdometryPoses, PoseLookupState
from mapperd.session.recovery import NOWHERE
from mapperd.store.checkpoint import FORMAT, decode_state, encode_state


class Inner(NamedTuple):
    number: int | None
    array: NDArray[Any] | None


class Outer(NamedTuple):
    text: str
    inner: Inner
    pairs: list[tuple[int, float]]
    counts: dict[str, int]
    data: bytes
    anything: Any


def outer_of(array: NDArray[Any] | None = None, number: int | None = 7) -> Outer:
    inner = Inner(number, array)
    return Outer("ü", inner, [(1, 0.1), (2, float("inf"))], {"a": 1}, b"\0\xff", None)


def back(state: Outer) -> Outer:
    return decode_state(encode_state(state), Outer)


def test_states_come_back_as_they_were() -> None:
    assert back(outer_of()) == outer_of()
    assert type(back(outer_of()).inner) is Inner


@pytest.mark.parametrize("number", [-(2**63), 2**64 - 1, 2**64, -(2**63) - 1, 2**200])
def test_whole_numbers_have_any_size(number: int) -> None:
    assert back(outer_of(np.arange(3), number)).inner.number == number


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("dtype", ["<f8", ">u2", "|u1", "<u4", "|b1"])
def test_arrays_keep_kind_order_and_rights(dtype: str, order: str) -> None:
    array = np.array(np.arange(12).reshape(3, 4), dtype=dtype, order=order)  # type: ignore[call-overload]
    array.setflags(write=False)
    again = back(outer_of(array)).inner.array
    assert isinstance(again, np.ndarray)
    assert np.array_equal(again, array)
    assert (again.dtype.str, again.strides) == (array.dtype.str, array.strides)
    assert not again.flags.writeable
    assert back(outer_of(np.zeros((0, 3)))).inner.array.shape == (0, 3)  # type: ignore[union-attr]


def test_long_series_come_back_as_short_ones_do() -> None:
    for count in (0, 1, 3, 100):
        series: Series[BasePosition] = Series()
        for k in range(count):
            covariance = np.eye(3, order="F") * k
            series.add(k, BasePosition(np.arange(3.0) + k, None, covariance, bool(k % 2)), k % 2)
        again: Series[BasePosition] = Series()
        kind = type(series.state())
        again.restore(decode_state(encode_state(series.state()), kind), BasePosition)
        assert encode_state(again.state()) == encode_state(series.state())
        samples = [again.around(k)[0] for k in range(count)]
        for k, sample in enumerate(samples):
            assert isinstance(sample, Sample)
            assert (type(sample.t_ns), sample.t_ns, sample.segment) == (int, k, k % 2)
            assert sample.value.position_m.tolist() == [k, k + 1.0, k + 2.0]
            assert sample.value.position_m.base is None  # no row keeps the others alive
            assert sample.value.velocity_mps is None
            assert sample.value.has_height is bool(k % 2)


def test_what_cannot_be_saved_is_a_programming_error() -> None:
    with pytest.raises(TypeError, match="cannot be in a checkpoint"):
        encode_state(random.Random(1))  # noqa: S311
    with pytest.raises(TypeError, match="array of object cannot be in a checkpoint"):
        encode_state(np.array([object()]))


@pytest.mark.parametrize(
    "data",
    [
        b"",
        msgspec.msgpack.encode([1, [["o", "mapperd.pipeline.decoder:SessionDecoder", []]]]),
        msgspec.msgpack.encode([FORMAT + 1, []]),
        msgspec.msgpack.encode([FORMAT, []]),
        msgspec.msgpack.encode([FORMAT, ["x"] * 9]),
    ],
)
def test_other_formats_are_refused(data: bytes) -> None:
    with pytest.raises(CheckpointError):
        decode_state(data, SessionDecoderState)


def decoder_of() -> SessionDecoder:
    poses = OdometryPoses(Config())
    return SessionDecoder(Config(), poses, PipelineCounters(), confirm=False, obey=True)


def test_states_of_other_poses_are_refused() -> None:
    fixed, odometry = FixedPose(NOWHERE), OdometryPoses(Config())
    for state, other in ((fixed.state(), odometry), (odometry.state(), fixed)):
        read = decode_state(encode_state(state), PoseLookupState)
        with pytest.raises(ValueError, match="was expected"):
            other.restore(read)


def test_damaged_bytes_are_refused_or_change_values_only() -> None:
    decoder = decoder_of()
    decoder.poses.add_odometry("l", b"x", 1, encoding="odometry-native_serial")
    good = encode_state(decoder.state())
    chance = random.Random(5)  # noqa: S311
    refused = 0
    for _ in range(2000):
        bad = bytearray(good)
        for _ in range(chance.randint(1, 4)):
            bad[chance.randrange(len(bad))] = chance.randrange(256)
        bad = bad[: chance.randint(1, len(bad))] if chance.random() < 0.2 else bad
        try:
            state = decode_state(bytes(bad), SessionDecoderState)
            restored = decoder_of()
            restored.restore(state)
        except (CheckpointError, ValueError):
            refused += 1
            continue
        assert encode_state(restored.state()) == encode_state(state)
    assert 0 < refused < 2000


def test_records_are_no_states() -> None:
    with pytest.raises(CheckpointError):
        decode_state(encode_state(Odometry(1, "boot")), SessionDecoderState)
