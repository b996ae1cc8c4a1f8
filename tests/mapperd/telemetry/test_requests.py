import asyncio
import json
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapperd.config.tree import AmclConfig
from mapperd.telemetry.broker import Kind, Outbox
from mapperd.telemetry.telemetry import TelemetryRequests
from mapperd.telemetry.topics import Topics
from tests.mapperd.telemetry.conftest import ROOT, FakeVehicle, drained

SET = "config/filtering.min_range/set"
RESULT = "config/filtering.min_range/result"


class Asker:
    """Sends requests and collects the answers."""

    def __init__(self, daemon: FakeVehicle, amcl: AmclConfig | None = None) -> None:
        self.outbox = Outbox(1000)
        config = daemon.settings.current
        topics = Topics.of(config.mqtt, amcl or config.amcl)
        self.requests = TelemetryRequests(daemon, topics, self.outbox.put)

    def ask(self, below: str, body: Any, *, retained: bool = False) -> dict[str, list[Any]]:
        payload = body if isinstance(body, bytes) else json.dumps(body).encode()
        self.requests.offer(f"{ROOT}/{below}", payload, retained=retained)
        return self.answers()

    def answers(self) -> dict[str, list[Any]]:
        async def work() -> None:
            task = asyncio.create_task(self.requests.work())
            for _ in range(100):
                await asyncio.sleep(0)
            await asyncio.get_running_loop().shutdown_default_executor()  # settings, in a thread
            for _ in range(100):
                await asyncio.sleep(0)
            task.cancel()

        asyncio.run(work())
        return drained(self.outbox)


@pytest.fixture
def asker(daemon: FakeVehicle) -> Asker:
    return Asker(daemon)


def test_commands_are_obeyed_and_answered(daemon: FakeVehicle, asker: Asker) -> None:
    assert asker.ask("cmd/save", {"id": "a", "name": "map.bt"}) == {
        "cmd/save/result": [
            {
                "id": "a",
                "ok": True,
                "result": {"path": "/state/map.bt", "bytes": 5, "seconds": 0.1},
            }
        ]
    }
    for name in ("snapshot", "reset", "clear"):
        (answer,) = asker.ask(f"cmd/{name}", {"id": 7})[f"cmd/{name}/result"]
        assert (answer["id"], answer["ok"]) == (7, True)
    assert daemon.asked == [
        ("save", "map.bt", "mqtt"),
        ("snapshot", "mqtt"),
        ("reset", "mqtt"),
        ("reset", "mqtt"),
    ]
    assert asker.requests.counts == {"done": 4}


def test_a_request_that_comes_twice_is_done_once(daemon: FakeVehicle, asker: Asker) -> None:
    first = asker.ask("cmd/reset", {"id": "x"})
    assert asker.ask("cmd/reset", {"id": "x"}) == first
    assert daemon.asked == [("reset", "mqtt")]
    asker.ask("cmd/snapshot", {"id": "x"})  # another command: another request
    assert len(daemon.asked) == 2
    assert asker.requests.counts == {"done": 2, "repeated": 1}


def test_a_setting_is_changed_with_and_without_an_id(daemon: FakeVehicle, asker: Asker) -> None:
    assert asker.ask(SET, 2.5) == {RESULT: [{"id": None, "ok": True, "value": 2.5}]}
    assert asker.ask(SET, {"id": 1, "value": 3})[RESULT] == [{"id": 1, "ok": True, "value": 3}]
    assert daemon.settings.current.filtering.min_range == 3.0
    assert daemon.settings.origin_of("filtering.min_range") == "mqtt"
    asker.ask(SET, 2.5)
    assert daemon.settings.current.filtering.min_range == 2.5  # no id, no memory


@pytest.mark.parametrize(
    ("below", "body", "reason", "words"),
    [
        (SET, -1, "refused", ">= 0"),
        (SET, "far", "refused", "number"),
        ("config/octree.voxel_resolution/set", 0.1, "refused", "needs a restart"),
        ("config/filtering.min_rang/set", 1, "refused", "did you mean filtering.min_range"),
        ("config/mqtt/set", {}, "refused", "no such setting"),
        (SET, {"value": 1, "if": "x"}, "bad_request", "if: is not known"),
        (SET, b"\xff", "bad_request", "not JSON"),
        ("cmd/save", {"id": 1, "name": "../map.bt"}, "bad_name", "without a folder"),
        ("cmd/save", {"id": 1}, "bad_request", "name: expected a string"),
        ("cmd/save", {"id": 1, "name": 5}, "bad_request", "name: expected a string"),
        ("cmd/reset", {"id": 1, "force": True}, "bad_request", "force: is not known"),
        ("cmd/reset", {}, "bad_request", 'an object with an "id"'),
        ("cmd/reset", [1], "bad_request", "an object"),
        ("cmd/reset", {"id": True}, "bad_request", "id: a text or"),
        ("cmd/reset", {"id": 2**70}, "bad_request", "id: "),
        ("cmd/reset", {"id": "x" * 65}, "bad_request", "id: at most"),
        ("cmd/reset", b'{"id": "' + b"x" * 5000 + b'"}', "bad_request", "at most 4096"),
        ("cmd/reset", b"[" * 4000, "bad_request", "not JSON"),
        ("cmd/reload", {"id": 1}, "internal_error", "RuntimeError: a fault, found by mqtt"),
        (
            "cmd/start-log",
            {"id": 1},
            "unknown_command",
            "there are save, initial_pose, set_map",
        ),
    ],
)
def test_what_cannot_be_done_is_answered_with_a_reason(  # noqa: PLR0917 a table
    daemon: FakeVehicle, asker: Asker, below: str, body: Any, reason: str, words: str
) -> None:
    before = daemon.settings.current
    ((answer,),) = asker.ask(below, body).values()
    assert (answer["ok"], answer["reason"]) == (False, reason)
    assert words in answer["text"]
    assert ("reset", "mqtt") not in daemon.asked
    assert daemon.settings.current is before
    assert asker.requests.counts == {"refused": 1}


def test_a_broker_s_memory_is_no_wish(daemon: FakeVehicle, asker: Asker) -> None:
    assert asker.ask("cmd/reset", {"id": 1}, retained=True) == {}
    assert asker.ask("status", b"online") == {}
    assert daemon.asked == []
    asker.requests.offer(f"{ROOT}/cmd/reset", b"", retained=False)  # takes a retained one away
    assert asker.requests.counts == {"retained": 2, "no_request": 1}


def test_a_flood_is_cut_off_and_memory_is_bounded(asker: Asker) -> None:
    for k in range(1000):
        asker.requests.offer(f"{ROOT}/cmd/snapshot", b'{"id": %d}' % k, retained=False)
    assert len(asker.answers()["cmd/snapshot/result"]) == 16
    assert asker.requests.counts == {"too_many": 984, "done": 16}
    for k in range(200):
        asker.ask("cmd/snapshot", {"id": f"late {k}"})
    assert len(asker.requests._answers) == 64


TEXT = st.text(max_size=20)
ANYTHING = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | TEXT,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXT, inner, max_size=3),
)
PAYLOADS = st.binary(max_size=60) | ANYTHING.map(lambda one: json.dumps(one).encode())


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(TEXT, st.sampled_from(("cmd/reset", SET, "cmd/save")), PAYLOADS)
def test_any_payload_is_answered_and_does_no_harm(name: str, below: str, payload: bytes) -> None:
    daemon = FakeVehicle()
    asker = Asker(daemon)
    asker.requests.offer(f"{ROOT}/cmd/{name}", payload, retained=False)
    asker.requests.offer(f"{ROOT}/{below}", payload, retained=False)
    asker.answers()
    assert asker.requests.counts.total() == 2
    assert asker.outbox.take(Kind.ANSWER) is None
