"""Messages that no daemon sends cost a client its connection, and nothing else."""

import tracemalloc
from typing import Any

import msgspec
import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

from mapperd.client.protocol import ClientProtocol, StreamOptions
from mapperd.client.state import ClientState
from mapperd.wire.blocks import CELLS, BlockSet, encode_blocks
from mapperd.wire.framing import StreamError, framed
from mapperd.wire.messages import (
    WANTS,
    BlocksMessage,
    FanMessage,
    GreetingMessage,
    ImageMessage,
    Interest,
    LocalizationMessage,
    MapBox,
    PathMessage,
    PoseMessage,
    ResetMessage,
    ReturnsMessage,
    RobotsMessage,
    SettingsMessage,
    StatusMessage,
    WelcomeMessage,
)
from tests.support.stream_server import MAP_INFO, Served, a_block

NAN, INF = float("nan"), float("inf")
UNIT = (0.0, 0.0, 0.0, 1.0)
POSE: dict[str, Any] = {
    "stamp_ns": 1,
    "position_m": (0.0, 0.0, 0.0),
    "orientation_xyzw": UNIT,
    "sonar_position_m": (0.0, 0.0, 0.0),
    "sonar_orientation_xyzw": UNIT,
}
IMAGE: dict[str, Any] = {
    "stamp_ns": 1,
    "ping_id": 1,
    "rows": 2,
    "beams": 3,
    "range_resolution_m": 0.1,
    "bearings_rad": bytes(12),
    "body": zstandard.compress(bytes(6)),
}
WELCOME = WelcomeMessage(
    version=1, server="", vehicle="", session="s", map=MAP_INFO, revision=0, resumed=False
)


def a_protocol(interest: Interest | None = None, **more: Any) -> ClientProtocol:
    """Connected, and welcome."""
    options = StreamOptions(WANTS, interest or Interest(detail="counts"))
    client_state = ClientState(options.interest, lambda _: None, **more)
    protocol = ClientProtocol(options, client_state, None, lambda _: None)
    protocol.receive(framed(GreetingMessage()) + framed(WELCOME))
    protocol.outgoing()
    return protocol


def body(cells: int = 5, key: int = 0, counts: int | None = None, times: int = 1) -> bytes:
    number = (times, CELLS)
    return encode_blocks(
        BlockSet(
            np.full((times, 3), key, np.int32),
            np.zeros(times, np.uint32),
            np.full(number, cells, np.int8),
            None if counts is None else np.full(number, counts, np.uint8),
        )
    )


def blocks(data: bytes, **more: Any) -> BlocksMessage:
    return BlocksMessage(revision=1, stamp_ns=1, body=data, **more)


@pytest.mark.parametrize(
    "message",
    [
        GreetingMessage(),
        WELCOME,
        blocks(body(counts=17)),
        blocks(body(counts=1, times=2)),
        blocks(body()),
        blocks(b"nothing"),
        blocks(b"", complete=2),
        ResetMessage(map=msgspec.structs.replace(MAP_INFO, resolution_m=NAN), revision=1),
        ResetMessage(map=msgspec.structs.replace(MAP_INFO, free_log_odds=9.0), revision=1),
        PoseMessage(**POSE | {"position_m": (NAN, 0.0, 0.0)}),
        PoseMessage(**POSE | {"sonar_position_m": (INF, 0.0, 0.0)}),
        PoseMessage(**POSE | {"orientation_xyzw": (0.0, 0.0, 0.0, 0.0)}),
        PoseMessage(**POSE | {"orientation_xyzw": (NAN, 0.0, 0.0, 1.0)}),
        PoseMessage(**POSE, velocity_mps=(NAN, 0.0, 0.0)),
        PoseMessage(**POSE, covariance=(INF,) * 36),
        PoseMessage(**POSE, odom_position_m=(NAN, 0, 0), odom_orientation_xyzw=(0, 0, 0, 1)),
        PoseMessage(**POSE, odom_position_m=(0, 0, 0), odom_orientation_xyzw=(0, 0, 0, 2)),
        PathMessage(first=1, points=b""),
        PathMessage(first=0, points=bytes(11)),
        PathMessage(first=0, points=np.full(3, NAN, "<f4").tobytes()),
        PathMessage(first=0, points=bytes(12 * 100_001)),
        PathMessage(first=0, points=bytes(24), rest=bytes(12)),
        PathMessage(first=0, points=bytes(12), rest=bytes(11)),
        PathMessage(first=0, points=bytes(12), rest=np.full(3, INF, "<f4").tobytes()),
        FanMessage(
            bearings_rad=(1.0, -1.0), vertical_aperture_rad=0.2, min_range_m=0, max_range_m=1
        ),
        FanMessage(
            bearings_rad=(-1.0, 1.0), vertical_aperture_rad=NAN, min_range_m=0, max_range_m=1
        ),
        ReturnsMessage(stamp_ns=1, ping_id=1, points=bytes(12), intensities=b""),
        ImageMessage(**IMAGE | {"rows": 3}),
        ImageMessage(**IMAGE | {"body": zstandard.compress(bytes(1 << 24))}),
        ImageMessage(**IMAGE | {"bearings_rad": bytes(8)}),
        RobotsMessage(seen=[(1, NAN, 0.0, 0.0)]),
        LocalizationMessage(report={}, particles=bytes(15)),
        LocalizationMessage(report={}, scan=np.full(3, INF, "<f4").tobytes()),
        SettingsMessage(facts={str(number): 1 for number in range(10_001)}),
    ],
    ids=lambda message: type(message).__name__,
)
def test_message_that_cannot_be_ends_the_connection(message: Any) -> None:
    with pytest.raises(StreamError):
        a_protocol().receive(framed(message))


@pytest.mark.parametrize(
    "interest", [Interest(box=MapBox((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))), Interest(detail="classes")]
)
def test_blocks_that_nobody_asked_for_end_the_connection(interest: Interest) -> None:
    inside, outside = blocks(body(1, 1)), blocks(body(9, 50))
    a_protocol(interest).receive(framed(inside))
    with pytest.raises(StreamError):
        a_protocol(interest).receive(framed(outside))
    forgotten = blocks(body(-128, 50))
    a_protocol(interest).receive(framed(forgotten))


def test_map_that_is_not_wanted_is_refused() -> None:
    options = StreamOptions(("pose",), Interest())
    client_state = ClientState(options.interest, lambda _: None)
    protocol = ClientProtocol(options, client_state, None, lambda _: None)
    protocol.receive(framed(GreetingMessage()) + framed(WELCOME))
    with pytest.raises(StreamError, match="not requested"):
        protocol.receive(framed(blocks(body())))


@pytest.mark.parametrize("resumed", [True, False])
def test_only_what_was_held_is_gone_on_with(resumed: bool) -> None:  # noqa: FBT001
    protocol = a_protocol()
    protocol.receive(framed(blocks(body(counts=1), complete=1)))
    protocol.end()
    protocol.begin()
    other = msgspec.structs.replace(
        WELCOME, resumed=resumed, map=msgspec.structs.replace(MAP_INFO, id="another")
    )
    if resumed:
        with pytest.raises(StreamError, match="does not hold"):
            protocol.receive(framed(GreetingMessage()) + framed(other))
    else:
        protocol.receive(framed(GreetingMessage()) + framed(other))
        mirror = protocol._client_state.mirror
        assert mirror is not None
        assert len(mirror) == 0
        assert mirror.complete is None


GOOD = [
    framed(message)
    for message in (
        blocks(body(counts=1), complete=1),
        blocks(body(-128, counts=0)),
        ResetMessage(map=MAP_INFO, revision=2),
        PoseMessage(**POSE),
        PathMessage(first=0, points=bytes(24)),
        ImageMessage(**IMAGE),
        SettingsMessage(facts={"a.b": {"value": 1}}),
        StatusMessage(stamp_ns=5, link={"left": 3}),
        ReturnsMessage(stamp_ns=1, ping_id=1, points=bytes(12), intensities=b"\x05"),
    )
]


@given(
    st.lists(st.sampled_from(GOOD), min_size=1, max_size=5),
    st.lists(st.tuples(st.integers(0), st.integers(0, 255)), max_size=4),
    st.binary(max_size=40),
)
@settings(max_examples=300, deadline=None)
@pytest.mark.slow
def test_spoiled_bytes_are_taken_or_refused(
    output: list[bytes], spoiled: list[tuple[int, int]], more: bytes
) -> None:
    protocol = a_protocol()
    stream = bytearray(b"".join(output))
    for at, value in spoiled:
        stream[at % len(stream)] = value
    try:
        protocol.receive(bytes(stream))
        protocol.receive(more)
    except StreamError:
        return
    assert len(protocol.outgoing()) < 100


@pytest.mark.slow
def test_memory_does_not_grow_through_thousands_of_rounds() -> None:
    protocol = a_protocol(most_blocks=100)
    served = Served()
    served.put((0, 0, 0), a_block(1))

    def rounds(number: int) -> None:
        for _ in range(number):
            protocol.receive(b"".join(GOOD))
            protocol.outgoing()
            try:
                protocol.receive(GOOD[0][:-3] + bytes(9))
            except StreamError:
                protocol._client_state.invalidate()
            protocol.end()
            protocol.begin()
            protocol.receive(framed(GreetingMessage()) + framed(WELCOME))

    rounds(20)
    tracemalloc.start()
    try:
        rounds(20)
        before, _ = tracemalloc.get_traced_memory()
        rounds(1000)
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 50_000
