"""Messages as bytes: each follows its length, four bytes in big endian."""

from typing import Generic, TypeVar

import msgspec

from mapperd.errors import MapperdError
from mapperd.wire.messages import MAX_FROM_CLIENT, MAX_FROM_SERVER, FromClient, FromServer

__all__ = ["Inbox", "StreamError", "client_inbox", "framed", "server_inbox"]

HEAD = 4

NO_MESSAGE = (msgspec.MsgspecError, ValueError, TypeError, OverflowError, RecursionError)
"""Errors of decoding: invalid UTF-8 is a ValueError, a map as key of a map a TypeError."""

Message = TypeVar("Message")


class StreamError(MapperdError):
    """The other side broke the protocol; the connection cannot be used any more.

    Attributes:
        reason: short and stable: `too_long`, `bad_message`, `bad_blocks`, ...
    """

    def __init__(self, message: str, reason: str) -> None:
        super().__init__(message)
        self.reason = reason


_ENCODER = msgspec.msgpack.Encoder()
_FROM_SERVER = msgspec.msgpack.Decoder(FromServer)
"""Made at import, in one thread: msgspec crashes when two threads first use a type at once."""

_FROM_CLIENT = msgspec.msgpack.Decoder(FromClient)


def framed(message: FromClient | FromServer) -> bytes:
    """Encode a message with its length."""
    body = _ENCODER.encode(message)
    return len(body).to_bytes(HEAD, "big") + body


class Inbox(Generic[Message]):
    """Decodes the messages of one connection from bytes in any pieces.

    Args:
        decoder: of one message; may be shared by threads.
        limit: maximum bytes of one message.

    Attributes:
        received: bytes of all decoded messages.
    """

    def __init__(self, decoder: "msgspec.msgpack.Decoder[Message]", limit: int) -> None:
        self.received = 0
        self._decoder = decoder
        self._limit = limit
        self._held = bytearray()

    def __len__(self) -> int:
        """Return the bytes of an incomplete message."""
        return len(self._held)

    def feed(self, data: bytes) -> list[Message]:
        """Return the messages that these bytes complete.

        Raises:
            StreamError: a message is too long or invalid.
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
            raise StreamError(f"not a message of this protocol: {error}", "bad_message") from error


def client_inbox() -> Inbox[FromServer]:
    """Return the decoder for a client: of the server's messages."""
    return Inbox(_FROM_SERVER, MAX_FROM_SERVER)


def server_inbox() -> Inbox[FromClient]:
    """Return the decoder for a server: of the clients' messages."""
    return Inbox(_FROM_CLIENT, MAX_FROM_CLIENT)
