"""A small server of the map stream that sends what a test sets."""

import asyncio
import contextlib
import ssl
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

import msgspec
import numpy as np
from numpy.typing import NDArray

from mapperd.wire.auth import is_proof
from mapperd.wire.blocks import CELLS, UNKNOWN, BlockSet, encode_blocks
from mapperd.wire.framing import Inbox, framed, server_inbox
from mapperd.wire.messages import (
    AckMessage,
    AnswerMessage,
    AskMessage,
    BlocksMessage,
    ByeMessage,
    ChangeMessage,
    FromClient,
    FromServer,
    GreetingMessage,
    HelloMessage,
    Interest,
    MapInfo,
    PathMessage,
    ResetMessage,
    StatusMessage,
    Want,
    WelcomeMessage,
)

TOKEN = b"correct-horse-battery"

MAP_INFO = MapInfo("map-1", 0.1, 0.25, 0.6, -1.4)


def a_block(value: int, *, holes: bool = True) -> NDArray[np.int8]:
    """Return cells that are unique to this value."""
    cells = np.random.default_rng(value).integers(-127, 127, CELLS).astype(np.int8)
    if holes:
        cells[::7] = UNKNOWN
    return cells


@dataclass
class Served:
    """The map and the requests of a daemon; tests change it in the server's event loop."""

    info: MapInfo = MAP_INFO
    session: str = "s-1"
    blocks: dict[tuple[int, int, int], tuple[int, NDArray[np.int8]]] = field(default_factory=dict)
    revision: int = 0
    token: bytes | None = None
    refusal: ByeMessage | None = None
    path: PathMessage | None = None
    versions: tuple[int, ...] = (1,)
    status_s: float = 1.0
    ticket: str = ""
    link: dict[str, object] = field(default_factory=dict)
    hellos: list[HelloMessage] = field(default_factory=list)
    asked: list[dict[str, object]] = field(default_factory=list)
    acked: int = 0
    sent: int = 0

    def put(self, key: tuple[int, int, int], cells: NDArray[np.int8]) -> None:
        """Replace a block in a new revision."""
        self.revision += 1
        self.blocks[key] = (self.revision, cells)

    def forget(self, key: tuple[int, int, int]) -> None:
        """Make a block unknown in a new revision."""
        self.put(key, np.full(CELLS, UNKNOWN, np.int8))

    def start_again(self, name: str) -> None:
        """Start a new map with one block."""
        self.info = msgspec.structs.replace(self.info, id=name)
        self.blocks.clear()
        self.put((0, 0, 0), a_block(5))

    def since(self, revision: int) -> BlockSet:
        """Return the blocks that changed after a revision."""
        reported = {key: cells for key, (at, cells) in self.blocks.items() if at > revision}
        cells = np.array(list(reported.values()), np.int8).reshape(-1, CELLS)
        return BlockSet(
            np.array(list(reported), np.int32).reshape(-1, 3),
            np.zeros(len(reported), np.uint32),
            cells,
        )

    def can_resume(self, hello: HelloMessage) -> bool:
        """Return whether the client's resume state is valid."""
        held = hello.resume
        if held is None or held.revision is None:
            return False
        return held.map == self.info.id and held.revision <= self.revision


class Connection:
    """One client of a served map."""

    def __init__(
        self, served: Served, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        self.served = served
        self.reader = reader
        self.writer = writer
        self.inbox: Inbox[FromClient] = server_inbox()
        self.interest = Interest()
        self.reported = 0
        self.sent = self.acked = 0
        self.quiet = False
        self.wants: list[Want] = []

    def send(self, *messages: FromServer) -> None:
        output = b"".join(map(framed, messages))
        self.sent += len(output)
        self.served.sent += len(output)
        self.writer.write(output)

    async def serve(self) -> None:
        served = self.served
        challenge = "" if served.token is None else "a challenge"
        self.send(GreetingMessage(versions=served.versions, challenge=challenge))
        beating: asyncio.Task[None] | None = None
        try:
            while data := await self.reader.read(65536):
                for message in self.inbox.feed(data):
                    if not isinstance(message, HelloMessage):
                        self.hear(message)
                    elif self.welcome(message, challenge):
                        beating = asyncio.create_task(self.beat())
                    else:
                        return
        finally:
            if beating is not None:
                beating.cancel()

    def welcome(self, hello: HelloMessage, challenge: str) -> bool:
        served = self.served
        served.hellos.append(hello)
        if served.token is not None and not is_proof(hello.proof, served.token, challenge):
            self.send(ByeMessage(reason="wrong_token", message="that is not the token"))
            return False
        if served.refusal is not None:
            self.send(served.refusal)
            return False
        is_resumed = served.can_resume(hello)
        held = hello.resume.revision if hello.resume and is_resumed else 0
        self.reported = held or 0
        self.interest, self.wants = hello.interest, hello.wants
        self.send(self.welcomed(resumed=is_resumed, ticket=served.ticket))
        self.publish()
        return True

    def welcomed(self, *, resumed: bool, ticket: str = "") -> WelcomeMessage:
        served = self.served
        return WelcomeMessage(
            version=1,
            server="test",
            vehicle="diver",
            session=served.session,
            map=served.info,
            revision=served.revision,
            resumed=resumed,
            may_change=True,
            ticket=ticket,
        )

    def hear(self, message: FromClient) -> None:
        if isinstance(message, AckMessage):
            self.acked = message.bytes
            self.served.acked = message.bytes
        elif isinstance(message, ChangeMessage) and message.wants is not None:
            self.wants = message.wants
            self.publish()
        elif isinstance(message, ChangeMessage) and message.interest is not None:
            self.interest = message.interest
            self.reported = 0
            self.send(
                ResetMessage(
                    map=self.served.info,
                    revision=self.served.revision,
                    interest=self.interest,
                )
            )
            self.publish()
        elif isinstance(message, AskMessage):
            ask = msgspec.msgpack.decode(message.ask)
            self.served.asked.append(ask)
            if ask["do"] == "fail":
                self.send(AnswerMessage(id=ask["id"], error={"reason": "refused", "message": "no"}))
            elif ask["do"] != "wait":
                self.send(AnswerMessage(id=ask["id"], result={"changed": ask.get("changes", {})}))

    def publish(self) -> None:
        """Send what changed, as a complete revision."""
        served = self.served
        if "map" not in self.wants:
            return
        blocks = served.since(self.reported)
        self.reported = served.revision
        if served.path is not None:
            self.send(served.path)
        self.send(
            BlocksMessage(
                revision=served.revision,
                stamp_ns=10**18,
                complete=served.revision,
                body=encode_blocks(blocks) if len(blocks) else b"",
            )
        )

    async def beat(self) -> None:
        while not self.quiet:
            self.send(StatusMessage(stamp_ns=10**18, link=self.served.link))
            await asyncio.sleep(self.served.status_s)


class Server:
    """Serves a map on real sockets, `async with`."""

    def __init__(
        self,
        served: Served,
        path: Path | None = None,
        port: int = 0,
        tls: ssl.SSLContext | None = None,
    ) -> None:
        self.served = served
        self.connections: list[Connection] = []
        self.tls = tls
        self._path = path
        self._port = port
        self._tasks: set[asyncio.Task[None]] = set()

    @property
    def port(self) -> int:
        return self._port

    @property
    def address(self) -> str:
        return f"127.0.0.1:{self._port}" if self._path is None else str(self._path)

    async def __aenter__(self) -> Self:
        if self._path is not None:
            self._server = await asyncio.start_unix_server(self._serve, self._path)
        else:
            self._server = await asyncio.start_server(
                self._serve, "127.0.0.1", self._port, ssl=self.tls
            )
            self._port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()
        self.cut()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._server.wait_closed()

    def cut(self) -> None:
        """Disconnect all clients."""
        for connection in self.connections:
            connection.writer.transport.abort()

    def publish(self) -> None:
        """Send the changes to all clients."""
        for connection in self.connections:
            connection.publish()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        connection = Connection(self.served, reader, writer)
        self.connections.append(connection)
        try:
            with contextlib.suppress(ConnectionError):
                await connection.serve()
        finally:
            self.connections.remove(connection)
            writer.close()
