"""Observe one sonar for a while; `oculus_driver.discovery.checkup` evaluates the result."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from oculus_driver.discovery.checkup import Evidence
from oculus_driver.discovery.listener import ANY_HOST, Discovery
from oculus_driver.discovery.own_addresses import addresses_towards
from oculus_driver.errors import DiscoveryError
from oculus_driver.ping import Ping, decode_ping
from oculus_driver.sequence import PingSequence
from oculus_driver.settings import FireSettings, PingRate
from oculus_driver.stream import StreamParser
from oculus_driver.wire import STATUS_PORT, TCP_PORT, MessageId

if TYPE_CHECKING:
    from oculus_driver.stream import Message

_CONNECT_S: Final = 3.0
_LARGEST_READ: Final = 1 << 16
_KEEP_ALIVE_S: Final = 1.0


@dataclass(frozen=True, slots=True)
class Examination:
    """How to look.

    Attributes:
        host: of the sonar, None for the first one heard.
        port: of its data connection.
        seconds: for each step.
        ping: ask for pings, then for standby: only under water.
        version: of fire messages.
        status_port, listen: where statuses are listened for.
    """

    host: str | None = None
    port: int = TCP_PORT
    seconds: float = 4.0
    ping: bool = False
    version: int = 2
    status_port: int = STATUS_PORT
    listen: str = ANY_HOST


async def examine(how: Examination) -> Evidence:
    """Listen for the sonar, connect to it, and take what comes for a while."""
    evidence = Evidence(how.host, status_port=how.status_port, port=how.port)
    await _listen(how, evidence)
    if evidence.address is None:
        return evidence
    evidence.own_addresses = tuple(addresses_towards(evidence.address))
    try:
        async with asyncio.timeout(_CONNECT_S):
            reader, writer = await asyncio.open_connection(evidence.address, how.port)
    except OSError as error:
        evidence.connect_error = error
        return evidence
    evidence.connected = True
    try:
        await _converse(how, evidence, reader, writer)
    except ConnectionError:
        evidence.ended = True
    finally:
        writer.close()
    return evidence


async def _listen(how: Examination, evidence: Evidence) -> None:
    """Wait for a status of the sonar that is meant."""
    try:
        async with asyncio.timeout(how.seconds), Discovery(how.status_port, how.listen) as ears:
            async for sighting in ears.sightings():
                if how.host in (None, sighting.address):
                    evidence.address = sighting.address
                    evidence.sighting = sighting
                    return
    except DiscoveryError as error:
        evidence.listening_fault = str(error)
    except TimeoutError:
        pass


async def _converse(
    how: Examination,
    evidence: Evidence,
    reader: asyncio.StreamReader,
    writer: asyncio.StreamWriter,
) -> None:
    """Take what comes, and keep asking for pings or, where nothing comes, for a sign of life."""
    quiet = FireSettings(ping_rate=PingRate.STANDBY).encode(how.version)
    asked = FireSettings(ping_rate=PingRate.LOWEST).encode(how.version) if how.ping else quiet
    evidence.asked_for_pings = how.ping
    listener = _Listener(evidence)
    loop = asyncio.get_running_loop()
    began_s = asked_s = loop.time()
    if how.ping:
        writer.write(asked)
    while (now_s := loop.time()) < began_s + how.seconds and not evidence.ended:
        if now_s >= asked_s + _KEEP_ALIVE_S and (how.ping or not evidence.bytes_received):
            writer.write(asked)
            asked_s = now_s
        data = await _next(reader, min(_KEEP_ALIVE_S, began_s + how.seconds - now_s))
        if data is not None:
            evidence.ended = not data
            listener.feed(data)
    evidence.listened_s = loop.time() - began_s
    if how.ping and not evidence.ended:
        writer.write(quiet)
        await _until_quiet(reader, listener)
    listener.finish()


async def _until_quiet(reader: asyncio.StreamReader, listener: _Listener) -> None:
    """Read on until the sonar is in standby; to close before that could lose the request."""
    loop = asyncio.get_running_loop()
    end_s = loop.time() + _KEEP_ALIVE_S
    before = listener.signs_of_life
    while listener.signs_of_life == before and (left_s := end_s - loop.time()) > 0.0:
        data = await _next(reader, left_s)
        if not data:
            break
        listener.feed(data)


async def _next(reader: asyncio.StreamReader, limit_s: float) -> bytes | None:
    """Return the next bytes, none at the end of the stream, None where none come in time."""
    try:
        async with asyncio.timeout(limit_s):
            return await reader.read(_LARGEST_READ)
    except TimeoutError:
        return None


class _Listener:
    """Counts what a stream holds."""

    def __init__(self, evidence: Evidence) -> None:
        self._evidence = evidence
        self._parser = StreamParser()
        self._sequence = PingSequence()

    @property
    def signs_of_life(self) -> int:
        """Dummies so far."""
        return self._parser.counters.messages[MessageId.DUMMY]

    def feed(self, data: bytes) -> None:
        """Take bytes as they came."""
        self._evidence.bytes_received += len(data)
        self._count(self._parser.feed(data))

    def finish(self) -> None:
        """Bring the counts to the end; a message that was still under way is no fault."""
        counters = self._parser.counters
        self._evidence.bytes_rejected = counters.bytes_rejected
        self._evidence.messages = counters.messages
        self._evidence.lost_pings = self._sequence.lost_pings

    def _count(self, messages: list[Message]) -> None:
        for message in messages:
            if message.message_id != MessageId.PING_RESULT:
                continue
            ping = decode_ping(message)
            if isinstance(ping, Ping):
                self._evidence.pings += self._sequence.accept(ping.ping_id)
            else:
                self._evidence.ping_rejects[ping.reason] += 1
