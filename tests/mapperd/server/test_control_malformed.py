"""Whatever a client says is answered or cut, and the next one is served."""

import json
import math
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from tests.support.control_server import FREE, MALFORMED, Served, go, until

pytestmark = pytest.mark.net


@pytest.mark.parametrize("data", MALFORMED, ids=range(len(MALFORMED)))
def test_malformed_request_is_an_answer(short: Path, data: bytes) -> None:
    async def work(one: Served) -> None:
        for kind in ("unix", "tcp"):
            async with await one.line(kind) as line:
                await line.say(data)
                assert (await line.hear())["error"]["reason"] == "bad_request"
                assert "result" in await line.ask("status")
                await line.say(data * 9)
                assert await line.is_cut()
        await until(lambda: one.counters["cut_malformed"] == 2)
        assert one.counters["malformed"] == 20

    go(work, short, limits=FREE)


@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    data=st.lists(
        st.binary(max_size=60)
        | st.recursive(
            st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=8),
            lambda inner: (
                st.lists(inner, max_size=3)
                | st.dictionaries(st.sampled_from(["id", "do", "names", "changes", "name"]), inner)
            ),
            max_leaves=8,
        ).map(lambda value: json.dumps(value).encode()),
        max_size=12,
    ).map(b"\n".join)
)
def test_any_bytes_are_answered_or_cut(short: Path, data: bytes) -> None:
    async def work(one: Served) -> None:
        line = await one.line()
        await line.say(data + b"\n")
        line.writer.write_eof()
        assert await line.is_cut()
        line.close()
        async with await one.line() as other:
            assert "result" in await other.ask("status")

    go(work, short, limits=FREE)


VALUES = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=9),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=6,
)


def is_json(value: object) -> bool:
    """Whether no number in it is infinite or none: JSON has no such numbers, Python writes them."""
    try:
        json.dumps(value, allow_nan=False)
    except ValueError:
        return False
    return True


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
            if is_json(value):
                answer = await line.ask("set", changes={name: value})
                assert "result" in answer or answer["error"]["reason"] in ("refused", "bad_request")
            else:  # nor is the line, so that its id cannot be read
                await line.say(
                    json.dumps({"id": 1, "do": "set", "changes": {name: value}}).encode()
                )
                await line.say(b"\n")
                answer = await line.hear()
                assert (answer["id"], answer["error"]["reason"]) == (None, "bad_request")
            assert "result" in await line.ask("status")
        assert one.counters["failed"] == 0

    go(work, short, limits=FREE)
