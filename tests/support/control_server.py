"""A daemon that records requests, and a client that is independent of ours."""

import asyncio
import contextlib
import hashlib
import hmac
import socket
import ssl
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import msgpack

from mapperd.api import OperationError, PoseRequest, ReportedChanges
from mapperd.config.layers import Layered
from mapperd.config.live import ConfigStore
from mapperd.config.tree import Config
from mapperd.events import EventLog
from mapperd.server.listeners import Listener, open_tcp_listener, open_unix_listener
from mapperd.server.state_feed import StateFeed
from mapperd.server.stream_server import StreamServer
from mapperd.wire.auth import Limits
from mapperd.wire.messages import Interest, MapInfo
from tests.support.waiting import LIMIT_S, run

TOKEN = b"correct-horse-battery-staple"


class FakeDaemon:
    """Implements `mapperd.api.DaemonApi`; the next request raises `fault`."""

    def __init__(self, config: Config | None = None) -> None:
        self.settings = ConfigStore(Layered(config or Config()))
        self.settings.follow(["filtering"], lambda _: None)
        self.events = EventLog(lambda: 1_700_000_000_000_000_000)
        self.changes = ReportedChanges()
        self.done: list[tuple[str, ...]] = []
        self.poses: list[PoseRequest | None] = []
        self.fault: Exception | None = None
        self.resume = asyncio.Event()
        self.resume.set()

    def status(self) -> dict[str, Any]:
        self._fail()
        return {"phase": "mapping", "reason": "", "pings": {"total": 7}, "pose": None}

    async def save(self, name: str, origin: str) -> dict[str, Any]:
        return await self._do("save", name, origin, result={"path": f"/maps/{name}", "bytes": 9})

    async def reset(self, origin: str) -> dict[str, Any]:
        return await self._do("reset", origin, result={})

    async def reload(self, origin: str) -> dict[str, Any]:
        result = {"changed": {"filtering.min_range": [0.5, 1.0]}, "refused": {}, "waiting": []}
        return await self._do("reload", origin, result=result)

    async def snapshot(self, origin: str) -> dict[str, Any]:
        return await self._do("snapshot", origin, result={"bytes": 3, "seconds": 0.5})

    def localization(self, particles: int = 0) -> dict[str, Any]:
        self._fail()
        return {"mode": "off", "state": "off"} | ({"particles": particles} if particles else {})

    async def initial_pose(self, asked: PoseRequest, origin: str) -> dict[str, Any]:
        self.poses.append(asked)
        return await self._do("initial_pose", origin, result={})

    async def global_localization(self, origin: str) -> dict[str, Any]:
        return await self._do("global_localization", origin, result={})

    async def request_nomotion_update(self, origin: str) -> dict[str, Any]:
        return await self._do("request_nomotion_update", origin, result={})

    async def set_map(self, name: str, asked: PoseRequest | None, origin: str) -> dict[str, Any]:
        self.poses.append(asked)
        result = {"path": f"/maps/{name}"}
        return await self._do("set_map", name, origin, result=result)

    async def _do(self, *what: str, result: dict[str, Any]) -> dict[str, Any]:
        await self.resume.wait()
        self._fail()
        self.done.append(what)
        return result

    def _fail(self) -> None:
        fault, self.fault = self.fault, None
        if fault is not None:
            raise fault


def refusal(reason: str) -> OperationError:
    return OperationError(f"it cannot be: {reason}", reason)


@dataclass
class Served:
    """A server with sockets: `unix`, `tcp`, `tls`; `open` without a token; `map` for viewers."""

    daemon: FakeDaemon
    server: StreamServer
    listeners: dict[str, Listener]
    trusted: ssl.SSLContext | None = None

    @property
    def counters(self) -> Counter[str]:
        return Counter(self.server.status()["counters"])

    async def raw(self, kind: str) -> "Line":
        """Connect without sending hello."""
        listener = self.listeners[kind]
        at = listener.socket.getsockname()
        if listener.socket.family == socket.AF_UNIX:
            streams = await asyncio.open_unix_connection(listener.name.removeprefix("unix "))
        elif kind == "tls":
            streams = await asyncio.open_connection(
                at[0], at[1], ssl=self.trusted, server_hostname="localhost"
            )
        else:
            streams = await asyncio.open_connection(at[0], at[1])
        return Line(*streams)

    async def line(self, kind: str = "unix", token: bytes = TOKEN, **more: Any) -> "Line":
        """Connect and authenticate."""
        line = await self.raw(kind)
        welcome = await line.hello(token, **more)
        assert welcome["t"] == "welcome", welcome
        return line


class Line:
    """One connection, by msgpack alone."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader = reader
        self.writer = writer
        self.number = self.read = 0
        self.is_welcome = False

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self.writer.transport.abort()

    async def hear(self) -> dict[str, Any]:
        """The next message that is no heartbeat; it is acknowledged."""
        while True:
            async with asyncio.timeout(60):
                try:
                    head = await self.reader.readexactly(4)
                    body = await self.reader.readexactly(int.from_bytes(head, "big"))
                except asyncio.IncompleteReadError as error:
                    raise EOFError from error
            heard = msgpack.unpackb(body)
            assert isinstance(heard, dict)
            self.read += 4 + len(body)
            self.is_welcome |= heard["t"] == "welcome"
            if self.is_welcome:
                await self.send({"t": "ack", "bytes": self.read})
            if heard["t"] != "status":
                return heard

    async def send_bytes(self, data: bytes) -> None:
        self.writer.write(data)
        await self.writer.drain()

    async def send(self, message: dict[str, Any]) -> None:
        with contextlib.suppress(ConnectionError):  # what it has heard before counts
            await self.send_bytes(message_of(message))

    async def ask(self, do: str, **more: Any) -> dict[str, Any]:
        self.number += 1
        await self.send({"t": "ask", "ask": {"id": self.number, "do": do} | more})
        answer = await self.hear()
        assert answer["t"] == "bye" or answer["id"] == self.number
        return answer

    async def hello(self, token: bytes = TOKEN, **more: Any) -> dict[str, Any]:
        greeting = await self.hear()
        assert greeting["mapperd"] == "map stream"
        assert greeting["versions"] == [1]
        hello: dict[str, Any] = {"t": "hello", "version": 1}
        if greeting["challenge"]:
            text = b"mapperd-control-1 " + greeting["challenge"].encode()
            hello |= {"proof": hmac.new(token, text, hashlib.sha256).hexdigest()}
        await self.send(hello | more)
        return await self.hear()

    async def is_cut(self) -> bool:
        """Wait until the server disconnects; messages before that are dropped."""
        try:
            async with asyncio.timeout(60):
                while await self.reader.read(65536):
                    pass
        except ConnectionError:
            pass
        return True


def message_of(message: object) -> bytes:
    body: bytes = msgpack.packb(message)
    return len(body).to_bytes(4, "big") + body


class EmptyView:
    """A view of a map without blocks."""

    resumed, reason, number, left, near_left = False, "", 0, 0, 0

    def next(self, *_: object) -> None:
        return None

    def settle(self, _: int) -> None:
        pass

    def change(self, _: Interest) -> None:
        pass

    def resume(self, _: Interest, __: int) -> bool:
        return False

    def close(self) -> None:
        pass


class EmptySource:
    """A map without blocks."""

    session, revision = "s1", 0

    def info(self) -> MapInfo:
        return MapInfo("m1", 0.1, 0.25, 0.8, 0.0)

    def look(self, *_: object) -> None:
        pass

    def subscribe(self, *_: object) -> EmptyView:
        return EmptyView()


@asynccontextmanager
async def served(
    folder: Path,
    limits: Limits | None = None,
    kinds: Sequence[str] = ("unix", "tcp"),
    tls: tuple[ssl.SSLContext, ssl.SSLContext] | None = None,
) -> AsyncIterator[Served]:
    daemon = FakeDaemon()
    listeners = {"unix": open_unix_listener(folder / "mapperd.sock", 0o660)}
    if "tcp" in kinds:
        listeners["tcp"] = open_tcp_listener("127.0.0.1:0", TOKEN, None)
    if "open" in kinds:
        listeners["open"] = open_tcp_listener("127.0.0.1:0", None, None)
    if tls is not None:
        listeners["tls"] = open_tcp_listener("127.0.0.1:0", TOKEN, tls[0])
    feed = StateFeed(daemon, lambda: None, 1000)
    server = StreamServer(daemon, list(listeners.values()), feed, EmptySource(), limits=limits)
    async with server:
        yield Served(daemon, server, listeners, tls[1] if tls else None)


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def is_listening(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX) as probe:
        return probe.connect_ex(str(path)) == 0


FREE = Limits(asks_per_s=1e6, asks_at_once=10**6, connects_per_s=1e6, connects_at_once=10**6)

MALFORMED: list[Any] = [
    [],
    None,
    7,
    "status",
    {"id": 1},
    {"do": "status"},
    {"id": -1, "do": "status"},
    {"id": 1.5, "do": "status"},
    {"id": 9007199254740993, "do": "status"},
    {"id": 1, "do": "status", "do2": 1},
    {"id": 1, "do": "destroy"},
    {"id": 1, "do": "hello", "version": 1},
    {"id": 1, "do": ["status"]},
    {"id": 1, "do": "save"},
    {"id": 1, "do": "save", "name": 7},
    {"id": 1, "do": "set", "changes": {}},
    {"id": 1, "do": "set", "changes": [["a", 1]]},
    {"id": 1, "do": "get", "names": []},
    {"id": 1, "do": "events", "since": "0"},
    {"id": 1, "do": "events", "follow": True},
    {"id": 1, "do": "initial_pose"},
    {"id": 1, "do": "initial_pose", "pose": {"x_m": float("nan"), "y_m": 0, "yaw_rad": 0}},
    {"id": 1, "do": "initial_pose", "pose": {"x_m": float("inf"), "y_m": 0, "yaw_rad": 0}},
    {"id": 1, "do": "initial_pose", "pose": {"x_m": 1e7, "y_m": 0, "yaw_rad": 0}},
    {"id": 1, "do": "set_map", "pose": {"x_m": 1, "y_m": 0, "yaw_rad": 0}},
    {b"id": 1, b"do": b"status"},
    {"id": 1, "do": "set", "changes": {"a": b"\xff"}, "more": {}},
]


def go(
    work: Callable[[Served], Awaitable[None]],
    folder: Path,
    *,
    within_s: float = LIMIT_S,
    **more: Any,
) -> None:
    """Run a test against a server; nothing of it may be left over."""

    async def serving() -> None:
        async with served(folder, **more) as one:
            await work(one)

    run(serving(), within_s, nothing_left=True)
