"""Bytes back into objects: equal ones, the same ones where they were the same, nothing foreign."""

import random
from collections import Counter, deque
from typing import Any

import msgspec
import numpy as np
import pytest

from mapperd.config.tree import Config
from mapperd.errors import CheckpointError
from mapperd.odometry.fusion import Fusion
from mapperd.odometry.records import Odometry
from mapperd.odometry.series import Sample, Series
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.decoder import SessionDecoder
from mapperd.pipeline.pose_lookup import OdometryPoses
from mapperd.store.checkpoint_reader import overlay
from mapperd.store.checkpoint_writer import written


def back(value: object) -> object:
    return overlay(written(value), None)[0]


def test_plain_values_come_back_as_they_were() -> None:
    value = {
        ("a", 1): [1, -(2**63), 2**64, 2**200, 0.1, float("inf"), None, True, "ü", b"\0\xff"],
        2: (deque([1, 2], maxlen=3), {3, 1, 2}, frozenset("xy"), Counter(a=2), bytearray(b"z")),
    }
    again = back(value)
    assert again == value
    assert isinstance(again, dict)
    row, _, _, counter, array = again[2]
    assert (row.maxlen, type(counter), type(array)) == (3, Counter, bytearray)
    assert type(again["a", 1][7]) is bool


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("dtype", ["<f8", ">u2", "|u1", "<u4", "|b1"])
def test_arrays_keep_kind_order_and_rights(dtype: str, order: str) -> None:
    array = np.array(np.arange(12).reshape(3, 4), dtype=dtype, order=order)  # type: ignore[call-overload]
    array.setflags(write=False)
    again = back(array)
    assert isinstance(again, np.ndarray)
    assert np.array_equal(again, array)
    assert (again.dtype.str, again.strides) == (array.dtype.str, array.strides)
    assert not again.flags.writeable


def test_settings_are_checked_as_they_come_back() -> None:
    assert back(Config()) == Config()
    saved = msgspec.msgpack.decode(written(Config()))
    saved[1][0][2]["octree"]["voxel_resolution"] = -1.0
    with pytest.raises(CheckpointError):
        overlay(msgspec.msgpack.encode(saved), None)


def test_settings_of_an_earlier_version_come_back() -> None:
    saved = msgspec.msgpack.decode(written(Config()))
    settings = saved[1][0][2]
    settings["mapping"] |= {"integrator": "projective", "error_bound": 0.1}
    settings["behind"] |= {"policy": "drop_oldest", "error_bound": 0.5}
    assert overlay(msgspec.msgpack.encode(saved), None) == (Config(),)


def test_what_was_one_object_is_one_again() -> None:
    series: Series[int] = Series()
    one, two = overlay(written([series, series], [series]), None, None)
    assert one[0] is one[1] is two[0]
    assert one[0] is not series


def test_fresh_objects_stay_themselves() -> None:
    saved: Series[int] = Series()
    saved.add(5, 7, 0)
    fresh: Series[int] = Series()
    samples = fresh._samples
    (same,) = overlay(written(saved), fresh)
    assert same is fresh
    assert fresh._samples is samples
    assert fresh.newest == Sample(5, 7, 0)


def test_long_rows_come_back_as_short_ones_do() -> None:
    for count in (3, 15, 16, 100):
        row = deque(
            Sample(k, Odometry(k, "boot", position_m=np.arange(3.0) + k, depth_m=0.5 * k), k % 2)
            for k in range(count)
        )
        again = back(row)
        assert isinstance(again, deque)
        assert [sample.t_ns for sample in again] == list(range(count))
        assert [sample.segment for sample in again] == [k % 2 for k in range(count)]
        for k, sample in enumerate(again):
            assert type(sample.t_ns) is int
            assert sample.value.position_m.tolist() == [k, k + 1.0, k + 2.0]
            assert sample.value.position_m.base is None  # no row keeps the others alive
            assert (sample.value.depth_m, sample.value.clock) == (0.5 * k, "boot")
            assert sample.value.geo is None


@pytest.mark.parametrize("name", ["os:system", "builtins:eval", "mapperd.config.tree:msgspec", "x"])
def test_nothing_foreign_is_made(name: str) -> None:
    for parts in (["o", name, []], ["e", name, "x"], ["u", name, {}]):
        with pytest.raises(CheckpointError, match="knows no"):
            overlay(msgspec.msgpack.encode([1, [parts]]), None)


def test_what_cannot_be_saved_is_a_mistake_of_ours() -> None:
    with pytest.raises(TypeError, match="cannot stand in a checkpoint"):
        written(random.Random(1))  # noqa: S311
    with pytest.raises(TypeError, match="array of objects"):
        written(np.array([object()]))


def test_a_program_with_other_attributes_is_reported() -> None:
    saved = msgspec.msgpack.decode(written(Fusion()))
    held = saved[1][0][2]
    held[0] = "_older"
    with pytest.raises(CheckpointError, match=r"mapperd.odometry.fusion:Fusion differs in _older"):
        overlay(msgspec.msgpack.encode(saved), Fusion())


def test_damaged_bytes_are_refused_or_change_values_only() -> None:
    good = written(OdometryPoses(Config()))
    (_, name, attributes), *_ = msgspec.msgpack.decode(good)[1]
    chance = random.Random(5)  # noqa: S311
    refused = 0
    for _ in range(2000):
        bad = bytearray(good)
        for _ in range(chance.randint(1, 4)):
            bad[chance.randrange(len(bad))] = chance.randrange(256)
        bad = bad[: chance.randint(1, len(bad))] if chance.random() < 0.2 else bad
        poses = OdometryPoses(Config())
        try:
            overlay(bytes(bad), poses)
        except CheckpointError:
            refused += 1
            continue
        # Only registered classes are inside, or it could not be written, with their attributes.
        (_, read_name, read_attributes), *_ = msgspec.msgpack.decode(written(poses))[1]
        assert read_name == name
        assert read_attributes[::2] == attributes[::2]
    assert 0 < refused < 2000


FORMER = {
    "mapperd.config.tree:Config": "mapperd.config:Config",
    "mapperd.pipeline.decoder:PingStream": "mapperd.ping_stream:PingStream",
    "mapperd.pipeline.decoder:SessionDecoder": "mapperd.engine:Engine",
    "mapperd.pipeline.pose_lookup:OdometryPoses": "mapperd.pairing:OdometryPoses",
}


def test_former_names_of_classes_are_read() -> None:
    def decoder() -> SessionDecoder:
        poses = OdometryPoses(Config())
        return SessionDecoder(Config(), poses, PipelineCounters(), confirm=False, obey=True)

    def formerly(value: Any) -> Any:
        if isinstance(value, list):
            return [formerly(one) for one in value]
        return FORMER.get(value, value) if isinstance(value, str) else value

    now = written(decoder())
    former = msgspec.msgpack.encode(formerly(msgspec.msgpack.decode(now)))
    assert all(name.encode() in former for name in FORMER.values())
    assert written(*overlay(former, decoder())) == now
