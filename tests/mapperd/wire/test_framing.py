"""Messages in any pieces, and bytes that are no messages."""

import contextlib
import subprocess
import sys
import tracemalloc
import typing

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapperd.wire.framing import StreamError, client_inbox, framed, server_inbox
from mapperd.wire.messages import (
    MAX_FROM_CLIENT,
    MAX_FROM_SERVER,
    AckMessage,
    AskMessage,
    ChangeMessage,
    FromClient,
    FromServer,
    HelloMessage,
    Interest,
    StatusMessage,
)


@given(st.data())
@settings(max_examples=30, deadline=None)
def test_messages_come_out_however_the_bytes_are_cut(data: st.DataObject) -> None:
    output: list[FromClient] = [
        AckMessage(bytes=5),
        ChangeMessage(interest=Interest(level=2)),
        HelloMessage(version=1, name="me"),
    ]
    stream = b"".join(map(framed, output))
    inbox = server_inbox()
    heard = []
    while stream:
        size = data.draw(st.integers(1, len(stream)))
        heard += inbox.feed(stream[:size])
        stream = stream[size:]
    assert heard == output
    assert inbox.received == sum(len(framed(message)) for message in output)


@pytest.mark.parametrize("limit", [MAX_FROM_CLIENT, MAX_FROM_SERVER])
def test_long_message_is_refused_by_its_length_alone(limit: int) -> None:
    inbox = server_inbox() if limit == MAX_FROM_CLIENT else client_inbox()
    assert inbox.feed(limit.to_bytes(4, "big")) == []
    with pytest.raises(StreamError, match="allowed") as caught:
        (server_inbox() if limit == MAX_FROM_CLIENT else client_inbox()).feed(
            (limit + 1).to_bytes(4, "big")
        )
    assert caught.value.reason == "too_long"


@pytest.mark.parametrize(
    "message",
    [
        {"t": "hello"},
        {"t": "hello", "version": 1, "wants": ["moon"]},
        {"t": "hello", "version": 1, "wants": ["map"] * 33},
        {"t": "hello", "version": 1, "interest": {"level": 4}},
        {"t": "hello", "version": 1, "interest": {"levels": 1}},
        {"t": "hello", "version": 1, "interest": {"radius_m": -1.0}},
        {"t": "hello", "version": 1, "interest": {"radius_m": float("nan")}},
        {"t": "hello", "version": 1, "bytes_per_s": -1},
        {"t": "hello", "version": 1, "name": "n" * 101},
        {"t": "hello", "version": 1, "resume": {"map": "m", "session": "s", "revision": -1}},
        {"t": "ack", "bytes": -1},
        {"t": "ack", "bytes": 2**63},
        {"t": "welcome"},
        {"t": "bye", "reason": "x"},
        [],
        None,
    ],
)
def test_what_no_client_may_report_is_refused(message: object) -> None:
    body = msgspec.msgpack.encode(message)
    with pytest.raises(StreamError) as caught:
        server_inbox().feed(len(body).to_bytes(4, "big") + body)
    assert caught.value.reason == "bad_message"


def test_keys_of_later_versions_are_passed_over() -> None:
    body = msgspec.msgpack.encode({"t": "ack", "bytes": 3, "colour": "red"})
    assert server_inbox().feed(len(body).to_bytes(4, "big") + body) == [AckMessage(bytes=3)]


def test_every_kind_has_another_name() -> None:
    tags = [kind.__struct_config__.tag for kind in typing.get_args(FromServer)]
    assert len(set(tags)) == len(tags)


@given(st.binary(max_size=200))
@settings(max_examples=300, deadline=None)
def test_any_bytes_are_messages_or_refused(data: bytes) -> None:
    for inbox in (client_inbox(), server_inbox()):
        with contextlib.suppress(StreamError):
            inbox.feed(data)
            inbox.feed(len(data).to_bytes(4, "big") + data)


@pytest.mark.parametrize(
    "value", [b"\xa1\xff", b"\x81\x80\x00", b"\x81\x91\x80\x00", b"\xd4\xff\x00"]
)
def test_values_that_are_invalid_are_refused(value: bytes) -> None:
    body = b"\x83\xa1t\xa6status\xa8stamp_ns\x01\xa6status\x81\xa1a" + value
    with pytest.raises(StreamError) as caught:
        client_inbox().feed(len(body).to_bytes(4, "big") + body)
    assert caught.value.reason == "bad_message"


def test_deep_nesting_is_refused() -> None:
    body = b"\x82\xa1t\xa6status\xa6status\x81\xa1a" + b"\x91" * 100_000 + b"\xc0"
    with pytest.raises(StreamError):
        client_inbox().feed(len(body).to_bytes(4, "big") + body)


def test_memory_does_not_grow_with_what_was_reported() -> None:
    stream = framed(StatusMessage(stamp_ns=1, status={"a": list(range(100))})) * 50
    asks = framed(AskMessage(ask=msgspec.Raw(b"\xc0"))) * 50
    inboxes = client_inbox(), server_inbox()

    def rounds(number: int) -> None:
        for _ in range(number):
            inboxes[0].feed(stream[:-1])
            inboxes[0].feed(stream[-1:])
            inboxes[1].feed(asks)

    rounds(10)
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        rounds(100)
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 100_000


FIRST_USE = """
from msgspec import _utils
from mapperd.wire.framing import client_inbox, framed, server_inbox
from mapperd.wire.messages import GreetingMessage, HelloMessage


def refuse(*words, **named):
    raise AssertionError("a type is used for the first time")


_utils._eval_type = refuse
assert server_inbox().feed(framed(HelloMessage(version=1)))
assert client_inbox().feed(framed(GreetingMessage()))
"""


def test_types_are_ready_before_several_threads_use_them() -> None:
    """msgspec crashes when one thread decodes a type that another one uses for the first time."""
    done = subprocess.run(  # noqa: S603 our own text
        [sys.executable, "-c", FIRST_USE], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
