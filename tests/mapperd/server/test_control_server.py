"""Requests are done, on every socket, and what cannot be done is reported."""

import asyncio
import ssl
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mapperd.config.catalog import parameters
from mapperd.config.tree import Config
from mapperd.events import Severity
from mapperd.server.connection import EVENTS_AT_ONCE
from mapperd.wire.auth import Limits
from mapperd.wire.requests import Request
from tests.support.control_server import FREE, Line, Served, go, message_of, refusal, served
from tests.support.waiting import until

pytestmark = pytest.mark.net

Contexts = tuple[ssl.SSLContext, ssl.SSLContext]
KINDS = ["unix", "tcp", "tls"]


@pytest.mark.parametrize("kind", KINDS)
def test_everything_can_be_asked(short: Path, tls: Contexts, kind: str) -> None:
    async def work(one: Served) -> None:
        line = await one.line(kind)
        assert (await line.ask("status"))["result"]["pings"] == {"total": 7}
        assert (await line.ask("save", name="a.ply"))["result"]["path"] == "/maps/a.ply"
        assert (await line.ask("reset"))["result"] == {}
        assert (await line.ask("reload"))["result"]["waiting"] == []
        assert (await line.ask("snapshot"))["result"] == {"bytes": 3, "seconds": 0.5}
        assert (await line.ask("params"))["result"].keys() == parameters().keys()
        name = "filtering.intensity_threshold"
        assert (await line.ask("get", names=[name]))["result"] == {name: 35.0}
        changed = (await line.ask("set", changes={name: 50.0}))["result"]
        assert changed == {"changed": {name: [35.0, 50.0]}}
        facts = (await line.ask("params", names=["filtering"]))["result"]
        assert facts[name]["value"] == 50.0
        assert facts[name]["origin"].startswith("control, ")
        assert (await line.ask("events"))["result"] == {"events": [], "missed": 0, "more": False}
        origins = {what[-1] for what in one.daemon.done}
        assert origins == {"control, 127.0.0.1"} or kind == "unix"
        line.close()

    go(work, short, tls=tls)


def test_user_of_the_unix_socket_is_known(short: Path) -> None:
    import os  # noqa: PLC0415 only here

    async def work(one: Served) -> None:
        async with await one.line() as line:
            await line.ask("reset")
        assert one.daemon.done == [("reset", f"control, user {os.getuid()}")]

    go(work, short)


@pytest.mark.parametrize("reason", ["bad_name", "bad_format", "cannot_write", "no_store", "busy"])
def test_what_the_daemon_refuses_is_an_answer(short: Path, reason: str) -> None:
    async def work(one: Served) -> None:
        async with await one.line() as line:
            one.daemon.fault = refusal(reason)
            answer = await line.ask("save", name="a.ply")
            assert answer["error"]["reason"] == reason
            assert answer["error"]["message"] == f"it cannot be: {reason}"
            assert "result" not in answer
            assert "result" in await line.ask("save", name="a.ply")

    go(work, short)


def test_fault_of_ours_is_reported_and_the_daemon_goes_on(short: Path) -> None:
    async def work(one: Served) -> None:
        async with await one.line() as line:
            one.daemon.fault = ZeroDivisionError("oh")
            assert (await line.ask("status"))["error"]["reason"] == "failed"
            assert "result" in await line.ask("status")
        assert one.counters["failed"] == 1
        (event,) = one.daemon.events.since(0)[0]
        assert (event.severity, event.code) == (Severity.ERROR, "stream_failed")
        assert event.text == "status: ZeroDivisionError: oh"

    go(work, short)


@pytest.mark.parametrize(
    ("changes", "name", "because"),
    [
        ({"filtering.min_range": -1}, "filtering.min_range", "is not allowed"),
        ({"octree.voxel_resolution": 1.0}, "octree.voxel_resolution", "needs a restart"),
        ({"mapping.detail": 2.0}, "mapping.detail", "nothing that runs follows"),
        ({"filtering.min_rnge": 1}, "filtering.min_rnge", "did you mean filtering.min_range?"),
    ],
)
def test_refused_change_changes_nothing(
    short: Path, changes: dict[str, object], name: str, because: str
) -> None:
    async def work(one: Served) -> None:
        async with await one.line() as line:
            more = {"filtering.intensity_threshold": 77.0}
            error = (await line.ask("set", changes=changes | more))["error"]
            assert error["reason"] == "refused"
            assert because in error["details"]["reasons"][name]
            assert because in error["message"]
        assert one.daemon.settings.current.filtering.intensity_threshold == 35.0

    go(work, short)


@pytest.mark.parametrize("do", ["get", "params"])
def test_unknown_setting_is_refused(short: Path, do: str) -> None:
    async def work(one: Served) -> None:
        async with await one.line() as line:
            error = (await line.ask(do, names=["filtering", "octre"]))["error"]
            assert error["reason"] == "unknown_setting"
            assert "'octre'" in error["message"]

    go(work, short)


def test_events_are_sent_as_they_happen(short: Path) -> None:
    async def work(one: Served) -> None:
        log = one.daemon.events
        log.add(Severity.INFO, "old", "before")
        async with await one.line() as line, await one.line("tcp") as other:
            first = (await line.ask("events"))["result"]
            assert [event["code"] for event in first["events"]] == ["old"]
            await line.send({"t": "change", "wants": ["events"]})
            await asyncio.to_thread(log.add, Severity.NOTICE, "new", "then", depth_m=3.5)
            assert (await line.hear())["event"] == {
                "number": 2,
                "t_s": 1_700_000_000.0,
                "severity": "notice",
                "code": "new",
                "text": "then",
                "facts": {"depth_m": 3.5},
                "count": 1,
                "first_s": 1_700_000_000.0,
            }
            assert (await line.ask("status"))["result"]["phase"] == "mapping"
            assert (await other.ask("events", since=1))["result"]["events"][0]["number"] == 2

    go(work, short)


def test_facts_that_are_not_plain_are_answered_all_the_same(short: Path) -> None:
    async def work(one: Served) -> None:
        async with await one.line() as line:
            odd = {"path": Path("/a"), "depth_m": np.float32(1.5), "nothing": float("nan")}
            one.daemon.events.add(Severity.INFO, "odd", "odd", **odd)
            facts = (await line.ask("events"))["result"]["events"][0]["facts"]
            assert facts == {"path": "/a", "depth_m": 1.5, "nothing": None}

    go(work, short)


def test_events_come_in_parts_and_those_that_are_missed_are_counted(short: Path) -> None:
    async def work(one: Served) -> None:
        for number in range(5000):
            one.daemon.events.add(Severity.DEBUG, "flood", str(number))
        async with await one.line() as line:
            heard: list[int] = []
            missed, more = 0, True
            while more:
                part = (await line.ask("events", since=heard[-1] if heard else 0))["result"]
                assert len(part["events"]) == EVENTS_AT_ONCE
                missed, more = missed + part["missed"], part["more"]
                heard += [event["number"] for event in part["events"]]
            assert missed == 4000
            assert heard == list(range(4001, 5001))
            # Of a daemon that was started again the client may know a later event.
            last = (await line.ask("events", since=9000))["result"]
            assert last == {"events": [], "missed": 0, "more": False}

    go(work, short)


def test_requests_may_be_sent_ahead_and_are_answered_in_order(short: Path) -> None:
    async def work(one: Served) -> None:
        async with await one.line() as line:
            asks = [{"id": 10 + k, "do": ("status", "reset")[k % 2]} for k in range(8)]
            await line.send_bytes(b"".join(message_of({"t": "ask", "ask": ask}) for ask in asks))
            assert [(await line.hear())["id"] for _ in asks] == [ask["id"] for ask in asks]

    go(work, short)


def test_nobody_waits_for_a_slow_save(short: Path) -> None:
    async def work(one: Served) -> None:
        async with await one.line() as line, await one.line() as other:
            one.daemon.resume.clear()
            saving = asyncio.create_task(line.ask("save", name="a.ply"))
            await asyncio.sleep(0)
            assert "result" in await other.ask("status")
            assert not saving.done()
            one.daemon.resume.set()
            assert "result" in await saving

    go(work, short)


def test_as_many_as_allowed_are_let_in(short: Path) -> None:
    async def work(one: Served) -> None:
        lines = [await one.line() for _ in range(3)]
        refused = await one.raw("unix")
        answer = await refused.hello()
        assert answer["reason"] == "too_many_clients"
        assert await refused.is_cut()
        lines.pop().close()
        await until(lambda: one.server.status()["clients"] == 2)
        lines.append(await one.line())
        assert one.server.status()["counters"]["refused_too_many_clients"] == 1
        for line in (*lines, refused):
            line.close()

    go(work, short, limits=Limits(operators=3))


def test_viewers_do_not_keep_out_operators(short: Path) -> None:
    async def work(one: Served) -> None:
        viewers = [await one.line(kind, wants=["map"]) for kind in ("unix", "open")]
        for kind in ("unix", "tcp", "open"):
            refused = await one.raw(kind)
            assert (await refused.hello(wants=["pose"]))["reason"] == "too_many_clients"
            refused.close()
        async with await one.line("unix") as good, await one.line("tcp") as other:
            assert "result" in await good.ask("reset")
            assert "result" in await other.ask("reset")
        for line in viewers:
            line.close()

    go(work, short, limits=Limits(clients=2), kinds=("unix", "tcp", "open"))


FIELDS: dict[str, dict[str, Any]] = {
    "get": {"names": ["filtering"]},
    "set": {"changes": {"filtering.min_range": 1.5}},
    "save": {"name": "a.ply"},
    "initial_pose": {"pose": {"x_m": 1.0, "y_m": 2.0, "yaw_rad": 0.0}},
    "set_map": {"name": "pool.yaml"},
    "report": {"changes": []},
}


def test_without_a_token_only_looking_is_allowed(short: Path) -> None:
    async def work(one: Served) -> None:
        allowed = set()
        async with await one.line("open") as line:
            for kind in Request.__args__:
                do = str(kind.__struct_config__.tag)
                answer = await line.ask(do, **FIELDS.get(do, {}))
                if "result" in answer:
                    allowed.add(do)
                else:
                    assert answer["error"]["reason"] == "needs_token", do
        assert allowed == {"status", "params", "get", "localization", "events"}
        assert one.daemon.done == []
        assert one.daemon.settings.current == Config()

    go(work, short, limits=FREE, kinds=("open",))


@pytest.mark.parametrize(
    ("more", "reason"),
    [({"version": 2}, "bad_version"), ({"version": "1"}, "bad_message")],
)
def test_hello_that_makes_no_sense_is_refused(
    short: Path, more: dict[str, Any], reason: str
) -> None:
    async def work(one: Served) -> None:
        line = await one.raw("unix")
        assert (await line.hello(**more))["reason"] == reason
        assert await line.is_cut()
        line.close()

    go(work, short)


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_done_before_hello(short: Path, tls: Contexts, kind: str) -> None:
    async def work(one: Served) -> None:
        line: Line = await one.raw(kind)
        await line.hear()
        assert (await line.ask("reset"))["reason"] == "no_hello"
        assert await line.is_cut()
        assert one.daemon.done == []
        line.close()

    go(work, short, tls=tls)


def test_server_that_ends_lets_go_of_clients_and_of_the_socket(short: Path) -> None:
    async def run() -> None:
        async with served(short) as one:
            lines = [await one.line(), await one.line("tcp"), await one.raw("tcp")]
        for line in lines:
            assert await line.is_cut()
            line.close()
        assert not (short / "mapperd.sock").exists()

    asyncio.run(run(), debug=True)
