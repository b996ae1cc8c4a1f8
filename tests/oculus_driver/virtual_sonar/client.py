"""A client of a played sonar, for the tests of it."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Self

from oculus_driver import (
    Ping,
    PlaybackSonar,
    StreamParser,
    decode_ping,
    encode_fire,
)

if TYPE_CHECKING:
    from oculus_driver import Message

FIRE = encode_fire()
STANDBY = encode_fire(ping_rate=5)


class Client:
    """A peer of the played sonar: a socket and a parser."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer
        self.parser = StreamParser()
        self.data = b""
        self.ready: list[Message] = []

    @classmethod
    async def of(cls, sonar: PlaybackSonar) -> Client:
        return await cls.of_address(sonar.host, sonar.port)

    @classmethod
    async def of_address(cls, host: str, port: int) -> Client:
        return cls(*await asyncio.open_connection(host, port))

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.writer.close()

    async def messages(self, count: int) -> list[Message]:
        """The next messages; fewer if the connection ends."""
        while len(self.ready) < count and (data := await self.reader.read(1 << 16)):
            self.data += data
            self.ready += self.parser.feed(data)
        found, self.ready = self.ready[:count], self.ready[count:]
        return found

    async def to_the_end(self) -> list[Message]:
        return await self.messages(1 << 30)

    async def until(self, message_id: int) -> Message:
        while True:
            for message in await self.messages(1):
                if message.message_id == message_id:
                    return message

    async def ids(self, count: int) -> list[int]:
        pings: list[int] = []
        while len(pings) < count:
            for message in await self.messages(1):
                ping = decode_ping(message)
                if isinstance(ping, Ping):
                    pings.append(ping.ping_id)
        return pings
