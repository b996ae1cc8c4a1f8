"""A second connection beside a client's first one, with asyncio."""

import asyncio
import ssl
import time
from collections.abc import Callable

from mapperd.client.connect import Attempts, Place, opened, read, reason_of, send
from mapperd.client.errors import EndedError
from mapperd.client.protocol import Line
from mapperd.client.state import Knowledge
from mapperd.wire.framing import StreamError
from mapperd.wire.messages import VERSION, Blocks, FromServer, Hello, Status, Welcome

__all__ = ["SecondDialogue", "SecondLine"]


class SecondDialogue(Line):
    """One second line, from its greeting to its end.

    Args:
        name: of the program, for people.
        knowledge: of the first connection, which is welcome and has a ticket; takes the blocks.
        token: that the daemon may ask for.
    """

    def __init__(self, name: str, knowledge: Knowledge, token: bytes | None) -> None:
        super().__init__(token)
        self._name = name
        self._knowledge = knowledge

    def end(self) -> None:
        """Nothing more is heard."""
        self.is_welcome = False
        self._knowledge.end_beside()

    def _hello(self, proof: str) -> Hello:
        # Not with the welcome: what the daemon says after this may be stuck, and be overtaken.
        self._knowledge.begin_beside()
        return Hello(version=VERSION, proof=proof, name=self._name, beside=self._knowledge.ticket)

    def _begin(self, welcome: Welcome) -> None:
        if not (welcome.resumed and self._knowledge.is_of_this(welcome)):
            raise StreamError("a second line of another connection", "bad_order")

    def _take_news(self, message: FromServer) -> None:
        if isinstance(message, Blocks):
            self._knowledge.take_beside(message)
        elif not isinstance(message, Status):
            what = f"a {type(message).__name__.lower()} on a second line"
            raise StreamError(what, "bad_order")


REFUSED = frozenset({"no_such_connection", "too_many_clients"})
"""Reasons that hold for as long as the first connection lives, beside those that always do."""


class SecondLine:
    """Connected, and connected again, for as long as the first connection lives.

    Whatever becomes of it, the first one goes on.

    Args:
        place: of the daemon.
        tls: encrypts TCP.
        dialogue: makes the one of each attempt.
        count: is told how many bytes came in.
        distrust: is called where the daemon said what it may not.
    """

    def __init__(
        self,
        place: Place,
        tls: ssl.SSLContext | None,
        dialogue: Callable[[], SecondDialogue],
        count: Callable[[int], None],
        distrust: Callable[[], None],
    ) -> None:
        self._place = place
        self._tls = tls
        self._new_dialogue = dialogue
        self._count = count
        self._distrust = distrust
        self._dialogue: SecondDialogue | None = None
        self._running: asyncio.Task[None] | None = None

    @property
    def is_welcome(self) -> bool:
        """It is in use."""
        return self._dialogue is not None and self._dialogue.is_welcome

    def open(self) -> None:
        """Have one, unless there is one already, or was refused beside this first connection."""
        if self._running is None:
            self._running = asyncio.create_task(self._stay_connected())

    async def close(self) -> None:
        """The first connection ended."""
        running, self._running = self._running, None
        if running is not None:
            running.cancel()
            await asyncio.wait([running])

    async def _stay_connected(self) -> None:
        attempts = Attempts()
        while True:
            began_s = time.monotonic()
            try:
                await self._connection()
            except EndedError as error:
                if error.is_final or error.reason in REFUSED:
                    return
            except StreamError:
                self._distrust()
                return
            await attempts.wait(time.monotonic() - began_s)

    async def _connection(self) -> None:
        """One connection from its beginning to its end.

        Raises:
            StreamError: because of what the daemon said, or how the connection was refused.
        """
        try:
            reader, writer = await opened(self._place, self._tls)
        except OSError as error:
            reason_of(error)  # raises where it is refused for good
            return
        self._dialogue = dialogue = self._new_dialogue()
        try:
            while data := await read(reader):
                self._count(len(data))
                dialogue.receive(data)
                send(writer, dialogue)
                # A read of bytes that are there already does not let others have their turn.
                await asyncio.sleep(0)
        except OSError as error:
            reason_of(error)  # as above
        finally:
            dialogue.end()
            writer.transport.abort()
