"""A map of blocks that a test writes, a server of it, and a client that knows the messages."""

import asyncio
import socket
import ssl
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mapperd.server.listeners import Listener, open_tcp_listener, open_unix_listener
from mapperd.server.priority_queue import Part
from mapperd.server.state_feed import StateFeed
from mapperd.server.stream_server import StreamServer
from mapperd.wire.auth import Limits, proof_of
from mapperd.wire.blocks import CELLS, BlockSet, decode_blocks, encode_blocks
from mapperd.wire.framing import client_inbox, framed
from mapperd.wire.messages import (
    AckMessage,
    AskMessage,
    BlocksMessage,
    ByeMessage,
    FromClient,
    FromServer,
    GreetingMessage,
    HelloMessage,
    Interest,
    MapInfo,
    ResetMessage,
    Resume,
    Vector,
    WelcomeMessage,
)
from tests.support.control_server import TOKEN, FakeDaemon

if TYPE_CHECKING:
    from numpy.typing import NDArray

Key = tuple[int, int, int]


class PlainView:
    """Sends the blocks that changed since it sent them last, nearest first."""

    def __init__(self, source: "PlainSource", resume: Resume | None) -> None:
        self._source = source
        self._sent_to: dict[Key, int] = {}
        self.resumed = resume is not None and resume.map == source.map_id
        self.reason = "" if self.resumed else "fresh"
        if resume is not None and self.resumed:
            seen = source.seen.items()
            self._sent_to = {key: one[0] for key, one in seen if one[0] <= (resume.revision or 0)}
        self._map_id = source.map_id
        self._interest, self._again = Interest(), False

    def _due(self) -> list[Key]:
        return [key for key, one in self._source.seen.items() if self._sent_to.get(key) != one[0]]

    @property
    def left(self) -> int:
        return len(self._due())

    def change(self, interest: Interest) -> None:
        self._sent_to, self._interest, self._again = {}, interest, True

    def close(self) -> None:
        self._source.views.remove(self)

    number = 0

    def settle(self, _: int) -> None:
        pass

    def resume(self, _: Interest, __: int) -> bool:
        return False

    @property
    def near_left(self) -> int:
        return self.left

    def next(self, position_m: Vector | None, most_bytes: int, part: Part = "any") -> bytes | None:
        if part == "far":
            return None  # all of it is near
        source = self._source
        if source.map_id != self._map_id or self._again:
            self._map_id, self._sent_to, self._again = source.map_id, {}, False
            reset = ResetMessage(
                map=source.info(), revision=source.revision, interest=self._interest
            )
            return framed(reset)
        due = self._due()
        if not due:
            return None
        near = np.array(position_m or (0.0, 0.0, 0.0))
        due.sort(key=lambda key: float(np.linalg.norm(np.array(key) - near)))
        taken = due[: max(1, most_bytes // 600)]
        self._sent_to |= {key: source.seen[key][0] for key in taken}
        fault, source.reported_fault = source.reported_fault, None
        if fault is not None:
            raise fault
        keys = np.array(taken, np.int32)
        cells = np.stack([source.seen[key][1] for key in taken])
        body = encode_blocks(BlockSet(keys, np.zeros(len(keys), np.uint32), cells))
        left = len(due) - len(taken)
        complete = None if left else source.revision
        blocks = BlocksMessage(
            revision=source.revision, stamp_ns=1, left=left, complete=complete, body=body
        )
        return framed(blocks)


class PlainSource:
    """A map: `cells` is written by the test, `seen` is as of the last look."""

    def __init__(self) -> None:
        self.cells: dict[Key, tuple[int, NDArray[np.int8]]] = {}
        self.seen: dict[Key, tuple[int, NDArray[np.int8]]] = {}
        self.map_id, self.session = "m1", "s1"
        self.views: list[PlainView] = []
        self.revision = self.written = 0
        self.fault: Exception | None = None
        self.reported_fault: Exception | None = None

    def put(self, key: Key, value: int) -> None:
        noise = np.random.default_rng(abs(hash(key)) + value)
        self.written += 1
        self.cells = self.cells | {
            key: (self.written, noise.integers(-100, 100, CELLS).astype(np.int8))
        }

    def clear(self, map_id: str) -> None:
        self.cells, self.map_id = {}, map_id

    def info(self) -> MapInfo:
        return MapInfo(self.map_id, 0.1, 0.25, 0.8, 0.0)

    def fence(self) -> int:
        return 0

    def look(self, now_ns: int, _: Vector | None = None) -> None:
        assert now_ns > 0
        fault, self.fault = self.fault, None
        if fault is not None:
            raise fault
        self.seen, self.revision = self.cells, self.written

    def subscribe(self, _: Interest, resume: Resume | None = None) -> PlainView:
        self.views.append(PlainView(self, resume))
        return self.views[-1]


class Bed:
    """A server at a Unix socket, at TCP with and without a token, and perhaps at TLS."""

    def __init__(
        self,
        folder: Path,
        tls: ssl.SSLContext | None,
        limits: Limits | None,
        source: Any = None,
    ) -> None:
        self.daemon = FakeDaemon()
        self.daemon.settings.follow(["stream.rate"], lambda _: None)
        self.daemon.settings.apply({"stream.rate": 20.0}, "test")
        self.source: Any = source or PlainSource()
        self.feed = StateFeed(self.daemon, lambda: None, 1000)
        self.listeners = {
            "unix": open_unix_listener(folder / "map.sock", 0o600),
            "token": open_tcp_listener("127.0.0.1:0", TOKEN, None),
            "open": open_tcp_listener("127.0.0.1:0", None, None),
        }
        if tls is not None:
            self.listeners["tls"] = open_tcp_listener("127.0.0.1:0", TOKEN, tls)
        self.shift_s = 0.0
        self.watchers: list[Watcher] = []
        self.server = StreamServer(
            self.daemon,
            [*self.listeners.values()],
            self.feed,
            self.source,
            limits=limits,
            clock=lambda: time.monotonic() + self.shift_s,
        )

    @property
    def counters(self) -> Counter[str]:
        return Counter(self.server.status()["counters"])

    async def watcher(
        self, kind: str = "unix", trusted: ssl.SSLContext | None = None, size: int = 0
    ) -> "Watcher":
        """Connected and greeted."""
        listener = self.listeners[kind]
        plain = await asyncio.to_thread(_connected, listener, size)
        name = "localhost" if trusted else None
        streams = await (
            asyncio.open_unix_connection(sock=plain)
            if kind == "unix"
            else asyncio.open_connection(sock=plain, ssl=trusted, server_hostname=name)
        )
        watcher = Watcher(*streams)
        self.watchers.append(watcher)
        await watcher.until(lambda: watcher.greeting is not None)
        return watcher

    async def welcomed(self, kind: str = "unix", **hello: Any) -> "Watcher":
        watcher = await self.watcher(kind)
        await watcher.hello(**hello)
        return watcher


def _connected(listener: Listener, size: int) -> socket.socket:
    plain = socket.socket(listener.socket.family, socket.SOCK_STREAM)
    if size:
        plain.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, size)
    is_unix = listener.name.startswith("unix ")
    plain.connect(listener.name.removeprefix("unix ") if is_unix else listener.socket.getsockname())
    plain.settimeout(0)
    return plain


class Watcher:
    """Mirrors blocks in a dictionary, and acknowledges all that it has read."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer
        self.inbox = client_inbox()
        self.greeting: GreetingMessage | None = None
        self.welcome: WelcomeMessage | None = None
        self.bye: ByeMessage | None = None
        self.cells: dict[Key, bytes] = {}
        self.complete: int | None = None
        self.resets = 0
        self.newest: dict[type, FromServer] = {}
        self.heard: list[FromServer] = []
        self.acks = True

    def send(self, *messages: FromClient) -> None:
        self.writer.write(b"".join(map(framed, messages)))

    async def hello(self, token: bytes | None = None, **fields: Any) -> None:
        assert self.greeting is not None
        proof = "" if token is None else proof_of(token, self.greeting.challenge)
        self.send(HelloMessage(**{"version": 1, "proof": proof, "wants": ["map"], **fields}))
        await self.until(lambda: self.welcome is not None or self.bye is not None)

    async def ask(self, **ask: Any) -> Any:
        self.send(AskMessage(ask=msgspec.Raw(msgspec.msgpack.encode(ask))))
        await self.until(lambda: any(getattr(one, "id", None) == ask["id"] for one in self.heard))
        return next(one for one in self.heard if getattr(one, "id", None) == ask["id"])

    async def until(self, done: Callable[[], bool]) -> None:
        while not done():
            assert await self.read(), f"it hung up: {self.bye}"

    async def over(self) -> ByeMessage | None:
        while await self.read():
            pass
        self.writer.close()
        return self.bye

    async def read(self, size: int = 65536) -> bool:
        try:
            data = await self.reader.read(size)
        except OSError:
            return False
        for message in self.inbox.feed(data):
            self._take(message)
        if self.acks and data and self.welcome is not None:
            self.send(AckMessage(bytes=self.inbox.received))
        return bool(data)

    def _take(self, message: FromServer) -> None:
        match message:
            case GreetingMessage():
                self.greeting = message
            case WelcomeMessage():
                self.welcome = message
            case ByeMessage():
                self.bye = message
            case ResetMessage():
                self.cells, self.complete, self.resets = {}, None, self.resets + 1
            case BlocksMessage(body=body, complete=complete):
                blocks = decode_blocks(body, counts=False)
                for key, cells in zip(blocks.keys.tolist(), blocks.cells, strict=True):
                    self.cells[tuple(key)] = cells.tobytes()
                self.complete = complete if complete is not None else self.complete
            case _:
                self.newest[type(message)] = message
                self.heard.append(message)

    async def leave(self) -> None:
        self.writer.transport.abort()
        await asyncio.sleep(0)


def as_bytes(source: PlainSource) -> dict[Key, bytes]:
    return {key: cells.tobytes() for key, (_, cells) in source.cells.items()}


@asynccontextmanager
async def bed_of(
    folder: Path,
    tls: ssl.SSLContext | None = None,
    limits: Limits | None = None,
    source: Any = None,
) -> AsyncIterator[Bed]:
    bed = Bed(folder, tls, limits, source)
    try:
        async with bed.server:
            yield bed
    finally:
        for watcher in bed.watchers:
            watcher.writer.transport.abort()
        await asyncio.sleep(0)
