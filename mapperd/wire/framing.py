"""Messages as bytes: the length of each, four bytes in big endian, before it."""

from typing import Generic, TypeVar

import msgspec

from mapperd.errors import MapperdError
from mapperd.wire.messages import MAX_FROM_CLIENT, MAX_FROM_SERVER, FromClient, FromServer

__all__ = ["Inbox", "StreamError", "client_inbox", "framed", "server_inbox"]

HEAD = 4

NO_MESSAGE = (msgspec.MsgspecError, ValueError, TypeError, OverflowError, RecursionError)
"""Texts that are no UTF-8 are a ValueError, keys of maps that are maps a TypeError."""

Message = TypeVar("Message")


class StreamError(MapperdError):
    """The other side said what it may not; the connection is of no more use.

    Attributes:
        reason: short and stable: `too_long`, `bad_message`, `bad_blocks`, ...
    """

    def __init__(self, message: str, reason: str) -> None:
        super().__init__(message)
        self.reason = reason


_ENCODER = msgspec.msgpack.Encoder()


def framed(message: FromClient | FromServer) -> bytes:
    """A message as it goes over the wire."""
    body = _ENCODER.encode(message)
    return len(body).to_bytes(HEAD, "big") + body


class Inbox(Generic[Message]):
    """Bytes of one connection, in any pieces, to messages.

    Args:
        decoder: of one message.
        limit: bytes of one message.

    Attributes:
        received: bytes of messages that were given.
    """

    def __init__(self, decoder: "msgspec.msgpack.Decoder[Message]", limit: int) -> None:
        self.received = 0
        self._decoder = decoder
        self._limit = limit
        self._held = bytearray()

    def __len__(self) -> int:
        """Bytes of a message that is not whole yet."""
        return len(self._held)

    def feed(self, data: bytes) -> list[Message]:
        """The messages that are whole with these bytes.

        Raises:
            StreamError: a message is too long, or none.
        """
        self._held += data
        messages = []
        at = 0
        while len(self._held) - at >= HEAD:
            size = int.from_bytes(self._held[at : at + HEAD], "big")
            if size > self._limit:
                raise StreamError(f"a message of {size} bytes; allowed: {self._limit}", "too_long")
            end = at + HEAD + size
            if len(self._held) < end:
                break
            messages.append(self._decoded(bytes(self._held[at + HEAD : end])))
            at = end
        del self._held[:at]
        self.received += at
        return messages

    def _decoded(self, body: bytes) -> Message:
        try:
            return self._decoder.decode(body)
        except NO_MESSAGE as error:
            raise StreamError(f"no message of this stream: {error}", "bad_message") from error


def client_inbox() -> Inbox[FromServer]:
    """Of a client: takes what a server says."""
    return Inbox(msgspec.msgpack.Decoder(FromServer), MAX_FROM_SERVER)


def server_inbox() -> Inbox[FromClient]:
    """Of a server: takes what a client says."""
    return Inbox(msgspec.msgpack.Decoder(FromClient), MAX_FROM_CLIENT)
