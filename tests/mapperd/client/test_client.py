"""`MapClient` against a small daemon on real sockets."""

import asyncio
import contextlib
import ssl
import subprocess
import sys
from collections.abc import AsyncIterator, Coroutine
from pathlib import Path
from typing import Any

import msgspec
import pytest

from mapperd.client import (
    AskError,
    EndedError,
    Interest,
    LinkChanged,
    MapChanged,
    MapClient,
    MapReset,
    connect,
)
from mapperd.wire.messages import ByeMessage, PoseMessage, StatusMessage
from tests.conftest import ROOT
from tests.support.stream_server import TOKEN, Served, Server, a_block
from tests.support.waiting import run, until

pytestmark = pytest.mark.net

POSE = PoseMessage(
    stamp_ns=1,
    position_m=(1.0, 2.0, 3.0),
    orientation_xyzw=(0.0, 0.0, 0.0, 1.0),
    sonar_position_m=(1.0, 2.0, 3.0),
    sonar_orientation_xyzw=(0.0, 0.0, 0.0, 1.0),
)


def go(work: Coroutine[Any, Any, None]) -> None:
    run(work, nothing_left=True)


@contextlib.asynccontextmanager
async def pair(served: Served, **options: Any) -> AsyncIterator[tuple[Server, MapClient]]:
    async with Server(served) as server, MapClient(server.address, **options) as client:
        yield server, client


def with_blocks(number: int) -> Served:
    served = Served()
    for index in range(number):
        served.put((index, 0, 0), a_block(index))
    return served


def test_map_grows_with_the_daemons(short: Path) -> None:
    async def grow() -> None:
        served = with_blocks(1)
        async with Server(served, short / "m.sock") as server, MapClient(server.address) as client:
            await client.complete(5)
            assert client.mirror is not None
            assert (client.mirror.blocks().cells == a_block(0)).all()
            reported = []
            async for change in client.changes():
                if isinstance(change, MapChanged):
                    reported.append(change.keys.tolist())
                    if len(reported) == 1:
                        served.put((-3, 4, 5), a_block(2))
                        server.publish()
                    elif [[-3, 4, 5]] in reported:
                        break
            assert reported[0] == [[0, 0, 0]]
            assert len(client.mirror) == 2
            await until(lambda: served.acked == served.sent)

    go(grow())


def test_client_goes_on_from_what_it_holds() -> None:
    async def break_off() -> None:
        served = with_blocks(50)
        async with pair(served) as (server, client):
            await client.complete(5)
            sent = served.sent
            server.cut()
            await until(lambda: client.link.state == "waiting")
            served.put((0, 0, 9), a_block(99))
            await until(lambda: client.link.connects == 2)
            await client.complete(5)
            resume = served.hellos[-1].resume
            assert resume is not None
            assert (resume.map, resume.session, resume.revision) == ("map-1", "s-1", 50)
            assert served.sent - sent < sent / 5
            assert client.mirror is not None
            assert len(client.mirror) == 51

    go(break_off())


def test_client_finds_a_daemon_that_began_again(short: Path) -> None:
    async def restart() -> None:
        served = with_blocks(5)
        path = short / "m.sock"
        async with MapClient(str(path)) as client:
            await until(lambda: client.link.state == "waiting")
            async with Server(served, path):
                await client.complete(5)
            path.unlink(missing_ok=True)
            await until(lambda: client.link.state != "connected")
            other = Served(session="s-2", info=served.info, blocks=served.blocks, revision=9)
            other.put((7, 7, 7), a_block(7))
            async with Server(other, path):
                await client.complete(5)
                assert other.hellos[0].resume is not None
                assert client.mirror is not None
                assert len(client.mirror) == 6

    go(restart())


def test_lie_about_the_map_starts_again() -> None:
    async def lie() -> None:
        served = with_blocks(3)
        async with pair(served) as (server, client):
            await client.complete(5)
            served.start_again("map-2")
            server.cut()
            await until(lambda: client.link.connects == 2)
            await client.complete(5)
            assert client.mirror is not None
            assert client.mirror.info.id == "map-2"
            assert client.mirror.keys().tolist() == [[0, 0, 0]]

    go(lie())


@pytest.mark.parametrize("token", [None, b"wrong-wrong-wrong-wrong"])
def test_without_the_right_token_it_ends_with_a_clear_error(token: bytes | None) -> None:
    async def refuse() -> None:
        async with pair(Served(token=TOKEN), token=token) as (_, client):
            with pytest.raises(EndedError, match="token") as caught:
                await client.complete(5)
            assert caught.value.reason == ("wrong_token" if token else "needs_token")
            with pytest.raises(EndedError):
                async for _ in client.changes():
                    pass
            assert client.link.state == "closed"
            with pytest.raises(AskError, match="token"):
                await client.ask("status")

    go(refuse())


def test_other_versions_and_other_services_end_it() -> None:
    async def refuse() -> None:
        async with pair(Served(versions=(2, 3))) as (_, client):
            with pytest.raises(EndedError, match="versions 2, 3, not 1"):
                await client.complete(5)

    go(refuse())


def test_right_token_and_tls_let_it_in(tls: tuple[ssl.SSLContext, ssl.SSLContext]) -> None:
    async def enter() -> None:
        async with (
            Server(Served(token=TOKEN), tls=tls[0]) as server,
            MapClient(server.address, token=TOKEN, tls=tls[1]) as client,
        ):
            await client.complete(5)
            async with MapClient(server.address, tls=ssl.create_default_context()) as other:
                with pytest.raises(EndedError, match="not trusted") as caught:
                    await other.complete(5)
                assert caught.value.reason == "not_trusted"

    go(enter())


def test_full_daemon_is_tried_again() -> None:
    async def wait() -> None:
        served = Served(refusal=ByeMessage(reason="too_many_clients", message="full"))
        async with pair(served) as (_, client):
            await until(lambda: client.link.reason == "full")
            served.refusal = None
            await client.complete(5)
            assert client.link.faults == 0

    go(wait())


def test_silent_link_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connect, "SILENCE_S", 0.1)

    async def listen() -> None:
        async with pair(Served(status_s=1000.0)) as (_, client):
            await until(lambda: client.link.connects == 2)

    go(listen())


def test_nonsense_is_counted_and_the_map_reported_again() -> None:
    async def spoil() -> None:
        served = with_blocks(3)
        async with pair(served) as (server, client):
            await client.complete(5)
            bad = msgspec.structs.replace(POSE, position_m=(float("nan"), 0.0, 0.0))
            server.connections[0].send(POSE, bad)
            await until(lambda: client.link.connects == 2)
            assert client.link.faults == 1
            assert client.pose == POSE
            assert served.hellos[-1].resume is None
            await client.complete(5)

    go(spoil())


def test_requests_are_answered_refused_or_lost() -> None:
    async def ask() -> None:
        served = Served()
        async with pair(served) as (server, client):
            with pytest.raises(AskError) as caught:
                await client.ask("status")
            assert caught.value.reason == "not_connected"
            await client.complete(5)
            assert await client.set({"filtering.min_range": 1.5}) == {"filtering.min_range": 1.5}
            assert served.asked[0]["do"] == "set"
            many = await asyncio.gather(*(client.ask("status") for _ in range(30)))
            assert many == [{"changed": {}}] * 30
            with pytest.raises(AskError) as caught:
                await client.ask("fail")
            assert caught.value.reason == "refused"
            with pytest.raises(AskError) as caught:
                await client.ask("wait", timeout_s=0.02)
            assert caught.value.reason == "no_answer"
            with pytest.raises(AskError) as caught:
                await client.ask("save", name="n" * 70_000)
            assert caught.value.reason == "too_long"
            with pytest.raises(AskError) as caught:
                await client.ask("set", changes={"a": object()})
            assert caught.value.reason == "bad_request"
            lost = asyncio.create_task(client.ask("wait"))
            await until(lambda: served.asked[-1]["do"] == "wait" and len(served.asked) == 34)
            server.cut()
            with pytest.raises(AskError) as caught:
                await lost
            assert caught.value.reason == "link_lost"

    go(ask())


def test_another_interest_is_reported_from_its_reset_on() -> None:
    async def change() -> None:
        served = with_blocks(3)
        async with pair(served) as (server, client):
            await client.complete(5)
            assert client.mirror is not None
            for level in (1, 2, 3):
                await client.change(interest=Interest(level=level))
            await client.complete(5)
            assert client.mirror.interest.level == 3
            assert server.connections[0].interest.level == 3
            server.cut()
            await until(lambda: client.link.connects == 2)
            assert served.hellos[-1].interest.level == 3
            with pytest.raises(ValueError, match="moon"):
                await client.change(wants=["moon"])  # type: ignore[list-item]

    go(change())


def test_reader_that_begins_late_is_reported_all_that_is_known() -> None:
    async def read() -> None:
        async with pair(with_blocks(3)) as (server, client):
            await client.complete(5)
            server.connections[0].send(POSE)
            await until(lambda: client.pose)
            reported: list[object] = []
            async for change in client.changes():
                reported.append(change)
                if change == POSE:
                    break
            kinds = [type(change) for change in reported if not isinstance(change, StatusMessage)]
            assert kinds == [LinkChanged, MapReset, MapChanged, PoseMessage]
            assert isinstance(reported[2], MapChanged)
            assert len(reported[2].keys) == 3

    go(read())


def test_map_that_is_too_large_ends_it() -> None:
    async def overflow() -> None:
        async with pair(with_blocks(9), most_blocks=8) as (_, client):
            with pytest.raises(EndedError, match="more than 8 blocks"):
                await client.complete(5)

    go(overflow())


@pytest.mark.parametrize(
    "options",
    [
        {"address": "nowhere"},
        {"address": "host:0"},
        {"wants": ["moon"]},
        {"interest": Interest(level=9)},
        {"interest": Interest(radius_m=float("nan"))},
        {"name": "n" * 101},
        {"bytes_per_s": -1},
    ],
)
def test_what_nobody_can_want_is_refused_at_once(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 each has its own message
        MapClient(**options)


def test_package_is_imported_without_the_daemon_and_its_core() -> None:
    code = (
        "import sys, mapperd.client; print(sorted({m for m in sys.modules if "
        "m in ('mapperd._core', 'mapperd.config.tree', 'mapperd.daemon.daemon', 'viser', "
        "'matplotlib')}))"
    )
    done = subprocess.run(  # noqa: S603 our own line
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_example_runs_as_it_is(tmp_path: Path) -> None:
    async def watch() -> None:
        async with Server(with_blocks(3)) as server:
            running = await asyncio.create_subprocess_exec(
                sys.executable,
                ROOT / "examples" / "watch_map.py",
                server.address,
                "0.5",
                cwd=tmp_path,
                stdout=subprocess.PIPE,
            )
            await until(lambda: server.connections)
            server.connections[0].send(POSE)
            output, _ = await running.communicate()
        assert running.returncode == 0
        assert b"connected" in output
        assert b"in 3 blocks, 0 left" in output
        assert (tmp_path / "watched.map").stat().st_size > 0

    go(watch())
