"""Viewers are admitted by origin and token; pages of other sites are not."""

import asyncio
import contextlib
import json
import socket
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import InvalidStatus

from mapperd.foxglove import proxy
from mapperd.foxglove.proxy import ViewerAccess, ViewerProxy, hidden_host
from mapperd.foxglove.server import serve
from tests.mapperd.foxglove.foxglove_fakes import FakeStream
from tests.support.waiting import until

pytestmark = pytest.mark.net

TOKEN = b"a-token-of-letters"
PROTOCOLS: Any = ["foxglove.sdk.v1"]


def served(act: Callable[[int], Awaitable[None]], access: ViewerAccess) -> None:
    """Serve viewers during an action."""

    async def run() -> None:
        ports: list[int] = []
        serving = asyncio.create_task(
            serve(FakeStream(), "127.0.0.1", 0, ports.append, access=access)
        )
        try:
            await until(lambda: ports or serving.done())
            await act(ports[0])
        finally:
            serving.cancel()
            await asyncio.wait((serving,))

    asyncio.run(run())


async def status(port: int, origin: str | None = None, path: str = "/") -> int:
    """HTTP status that a viewer gets; 101 after the server's first message."""
    try:
        async with viewer(port, origin, path) as link:
            assert json.loads(await link.recv())["op"] == "serverInfo"
            return 101
    except InvalidStatus as error:
        return error.response.status_code


def viewer(port: int, origin: str | None = None, path: str = "/") -> connect:
    url = f"ws://127.0.0.1:{port}{path}"
    return connect(url, origin=origin, subprotocols=PROTOCOLS, open_timeout=20)  # type: ignore[arg-type]


def test_pages_of_other_origins_are_refused() -> None:
    refused: list[str] = []

    async def act(port: int) -> None:
        assert await status(port) == 101, "no browser"
        for origin in ("https://app.foxglove.dev", "file://", "http://localhost:8080"):
            assert await status(port, origin) == 101
        assert refused == []
        for origin in (
            "https://elsewhere.example",
            "null",
            f"http://127.0.0.1:{port}",
            "https://app.foxglove.dev.elsewhere.example",
            "http://app.foxglove.dev",
        ):
            assert await status(port, origin) == 403
            assert refused.pop() == (
                "refused a viewer at 127.0.0.1: page of another origin; to admit it: "
                f"--allow-origin {origin}"
            )

    origins = (*proxy.ORIGINS, "http://localhost:8080")
    served(act, ViewerAccess(origins, report=refused.append))


def test_a_token_is_needed_where_one_is_set() -> None:
    refused: list[str] = []

    async def act(port: int) -> None:
        right = f"/?token={TOKEN.decode()}"
        assert await status(port, path=right) == 101
        assert await status(port, "https://elsewhere.example", right) == 403
        assert await status(port) == 401
        for _ in range(5):
            assert await status(port, path="/?token=a-token-of-lettert") == 401
        assert "wrong token" in refused[-1]
        assert await status(port, path=right) == 429, "it cannot be guessed"

    served(act, ViewerAccess(token=TOKEN, report=refused.append))


def test_the_server_behind_is_not_at_a_known_address() -> None:
    hosts = {hidden_host() for _ in range(100)}
    assert len(hosts) > 90
    assert all(host.startswith("127.") and host != "127.0.0.1" for host in hosts)

    async def act(port: int) -> None:
        async with viewer(port) as link:
            await link.recv()
            with socket.socket() as other, contextlib.suppress(ConnectionRefusedError):
                other.connect(("127.0.0.2", port))
                raise AssertionError("it listens on other addresses")

    served(act, ViewerAccess())


@pytest.mark.parametrize(
    "request_bytes",
    [
        b"GET / HTTP/1.1\r\nHost: x\r\n\r\n",
        b"POST / HTTP/1.1\r\nUpgrade: websocket\r\n\r\n",
        b"\r\n\r\n",
        b"\xff" * 100 + b"\r\n\r\n",
        b"a" * 20_000,
    ],
    ids=["no upgrade", "post", "empty", "bytes", "long"],
)
def test_other_requests_end_with_an_answer_or_the_connection(request_bytes: bytes) -> None:
    async def act(port: int) -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(request_bytes)
        answer = b""
        with contextlib.suppress(ConnectionError):
            answer = await asyncio.wait_for(reader.read(), 20)
        assert answer.startswith(b"HTTP/1.1 400 ") or answer == b""
        writer.close()
        assert await status(port) == 101

    served(act, ViewerAccess())


def test_a_silent_connection_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(proxy, "HEAD_TIMEOUT_S", 0.1)

    async def act(port: int) -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(b"GET / HTTP/1.1\r\n")
        assert await asyncio.wait_for(reader.read(), 20) == b""
        writer.close()

    served(act, ViewerAccess())


def test_viewers_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(proxy, "MAX_VIEWERS", 2)

    async def act(port: int) -> None:
        async with viewer(port), viewer(port):
            assert await status(port) == 503
        async with asyncio.timeout(20):
            while await status(port) != 101:
                pass

    served(act, ViewerAccess())


def test_viewers_are_cut_at_the_end() -> None:
    links: list[ClientConnection] = []

    async def run() -> None:
        ports: list[int] = []
        serving = asyncio.create_task(serve(FakeStream(), "127.0.0.1", 0, ports.append))
        await until(lambda: ports)
        links.append(await viewer(ports[0]))
        serving.cancel()
        await asyncio.wait((serving,))
        async with asyncio.timeout(20):
            await links[0].wait_closed()

    asyncio.run(run())


@pytest.mark.parametrize("steps", range(8))
def test_a_connection_cut_while_it_ends_leaves_no_socket_open(
    steps: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[asyncio.StreamWriter] = []

    async def run() -> None:
        behind = asyncio.Event()

        async def server_behind(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            await reader.readuntil(b"\r\n\r\n")  # unread, it would make the end a reset
            await behind.wait()
            writer.close()

        server = await asyncio.start_server(server_behind, "127.0.0.1", 0)
        connect_to = asyncio.open_connection

        async def open_connection(
            host: str, port: int
        ) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
            reader, writer = await connect_to(host, port)
            ended = reader.feed_eof

            def feed_eof() -> None:
                ended()
                asyncio.get_running_loop().create_task(cut())

            monkeypatch.setattr(reader, "feed_eof", feed_eof)
            opened.append(writer)
            return reader, writer

        async def cut() -> None:
            for _ in range(steps):
                await asyncio.sleep(0)
            leaving.set()

        leaving = asyncio.Event()
        async with ViewerProxy("127.0.0.1", 0, ViewerAccess()) as served:
            served.target = server.sockets[0].getsockname()[:2]
            _, writer = await connect_to("127.0.0.1", served.port)
            monkeypatch.setattr(asyncio, "open_connection", open_connection)
            writer.write(b"GET / HTTP/1.1\r\nUpgrade: websocket\r\n\r\n")
            await until(lambda: opened)
            behind.set()
            async with asyncio.timeout(20):
                await leaving.wait()
        writer.close()
        server.close()

    asyncio.run(run())
    assert opened[0].is_closing()
