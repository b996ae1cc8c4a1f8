"""Whatever a client sends is answered or cut, and the next one is served."""

import math
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from mapperd.wire.requests import Fault, decode_request
from tests.support.control_server import FREE, MALFORMED, Served, go

pytestmark = pytest.mark.net


@pytest.mark.parametrize("request_", MALFORMED, ids=range(len(MALFORMED)))
def test_malformed_request_is_an_answer(short: Path, request_: object) -> None:
    async def work(one: Served) -> None:
        for kind in ("unix", "tcp"):
            async with await one.line(kind) as line:
                await line.send({"t": "ask", "ask": request_})
                assert (await line.hear())["error"]["reason"] == "bad_request"
                assert "result" in await line.ask("status")
        assert one.daemon.done == []

    go(work, short, limits=FREE)


@pytest.mark.parametrize("text", [b"\xff\xfe", b"\xc0\x80", b"\xed\xa0\x80"])
def test_request_that_is_not_utf8_is_refused(text: bytes) -> None:
    packed = bytes([0xA0 + len(text)]) + text
    for raw in (packed, b"\x81\xa2do" + packed, b"\x81" + packed + b"\x01"):
        fault, number = decode_request(raw)
        assert isinstance(fault, Fault)
        assert (fault.reason, number) == ("bad_request", None)
        assert "utf-8" in fault.message.lower()


INTEGERS = st.integers(-(2**63), 2**64 - 1)  # of MessagePack
VALUES = st.recursive(
    st.none() | st.booleans() | st.floats() | INTEGERS | st.text(max_size=9),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=6,
)


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(value=VALUES)
@example(value=math.inf)
@example(value=[math.nan])
@example(value=1.7e308)
@pytest.mark.parametrize("name", ["filtering.intensity_threshold", "control.mode", "odometry"])
def test_any_value_is_taken_or_refused(short: Path, name: str, value: object) -> None:
    async def work(one: Served) -> None:
        async with await one.line() as line:
            answer = await line.ask("set", changes={name: value})
            assert "result" in answer or answer["error"]["reason"] in ("refused", "bad_request")
            assert "result" in await line.ask("status")
        assert one.counters["failed"] == 0

    go(work, short, limits=FREE)
