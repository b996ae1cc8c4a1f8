"""What is said alike on each connection of a client: bytes in, bytes out; no sockets, no clocks."""

from abc import ABC, abstractmethod

from mapperd.client.errors import EndedError
from mapperd.wire.auth import proof_of
from mapperd.wire.framing import StreamError, client_inbox, framed
from mapperd.wire.messages import (
    VERSION,
    Ack,
    Bye,
    FromClient,
    FromServer,
    Greeting,
    Hello,
    Welcome,
)

__all__ = ["Line"]

STREAM = "map stream"


class Line(ABC):
    """Greeting and hello, welcome, acknowledgements and good-bye.

    Args:
        token: that the daemon may ask for.

    Attributes:
        is_greeted: the daemon has said something on this connection, or on the one that ended.
        is_welcome: the connection has come about.
    """

    def __init__(self, token: bytes | None) -> None:
        self._token = token
        self._begin_line()

    def _begin_line(self) -> None:
        """A connection is there."""
        self._inbox = client_inbox()
        self._acknowledged = 0
        self._outgoing = bytearray()
        self.is_greeted = False
        self.is_welcome = False

    def receive(self, data: bytes) -> None:
        """Take what came in; what it changes is told on the way.

        Raises:
            StreamError: it is nothing that a daemon may say; an `EndedError` if it says good-bye.
        """
        for message in self._inbox.feed(data):
            self._take(message)

    def outgoing(self, *, acknowledge: bool = True) -> bytes:
        """What is to be sent now, once."""
        if acknowledge and self.is_welcome and self._inbox.received > self._acknowledged:
            self._acknowledged = self._inbox.received
            self._say(Ack(bytes=self._acknowledged))
        said = bytes(self._outgoing)
        self._outgoing.clear()
        return said

    @abstractmethod
    def _hello(self, proof: str) -> Hello:
        """The first message of ours."""

    @abstractmethod
    def _begin(self, welcome: Welcome) -> None:
        """The connection has come about."""

    @abstractmethod
    def _take_news(self, message: FromServer) -> None:
        """Take what is told after the welcome."""

    def _say(self, message: FromClient) -> None:
        self._outgoing += framed(message)

    def _take(self, message: FromServer) -> None:
        if isinstance(message, Bye):
            raise EndedError(message.message or message.reason, message.reason)
        if isinstance(message, Greeting):
            self._take_greeting(message)
        elif isinstance(message, Welcome):
            self._take_welcome(message)
        elif not self.is_welcome:
            raise StreamError("news before a welcome", "bad_order")
        else:
            self._take_news(message)

    def _take_greeting(self, greeting: Greeting) -> None:
        if self.is_greeted:
            raise StreamError("a second greeting", "bad_order")
        self.is_greeted = True
        if greeting.mapperd != STREAM:
            raise EndedError(f"this is no {STREAM} but a {greeting.mapperd!r:.50}", "bad_version")
        if VERSION not in greeting.versions:
            spoken = ", ".join(map(str, greeting.versions[:10]))
            raise EndedError(f"the daemon speaks versions {spoken}, not {VERSION}", "bad_version")
        proof = ""
        if greeting.challenge:
            if self._token is None:
                raise EndedError("the daemon wants a token", "needs_token")
            proof = proof_of(self._token, greeting.challenge)
        self._say(self._hello(proof))

    def _take_welcome(self, welcome: Welcome) -> None:
        if not self.is_greeted or self.is_welcome:
            raise StreamError("a welcome out of turn", "bad_order")
        if welcome.version != VERSION:
            raise StreamError(f"a welcome to version {welcome.version}", "bad_version")
        self._begin(welcome)
        self.is_welcome = True
