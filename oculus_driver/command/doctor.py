"""`oculus doctor`: the first thing between a sonar and its pings that fails."""

from __future__ import annotations

import asyncio
from dataclasses import asdict
from typing import TYPE_CHECKING, Final

from oculus_driver.checkup import Evidence, Layer, first_failure, judge
from oculus_driver.command.discover import add_status_arguments
from oculus_driver.command.say import Exit, Say
from oculus_driver.command.values import address, port, positive
from oculus_driver.discovery import Discovery
from oculus_driver.errors import DiscoveryError
from oculus_driver.own_addresses import addresses_towards
from oculus_driver.ping import Ping, decode_ping
from oculus_driver.sequence import PingSequence
from oculus_driver.settings import FireSettings, PingRate
from oculus_driver.stream import StreamParser
from oculus_driver.wire import TCP_PORT, MessageId

if TYPE_CHECKING:
    import argparse

    from oculus_driver.stream import Message

NAME = "doctor"
HELP = "check address, port, bytes, frames and pings; name the first that fails and what to do"

_CONNECT_S: Final = 3.0
_LARGEST_READ: Final = 1 << 16
_KEEP_ALIVE_S: Final = 1.0
_MARKS: Final = {"ok": "ok  ", "doubtful": "?   ", "failed": "FAIL", "not tested": "-   "}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what may be said."""
    add = parser.add_argument
    add("host", metavar="ADDRESS", nargs="?", type=address, help="(default: the first one heard)")
    add("--port", type=port, default=TCP_PORT, help="TCP port (default: %(default)s)")
    add("--seconds", metavar="S", type=positive, default=4.0, help="for each step (default: 4)")
    add("--ping", action="store_true", help="ask for pings, then for standby: only under water")
    add("--version", type=int, choices=(1, 2), default=2, help="of fire messages")
    add_status_arguments(parser)


def run(said: argparse.Namespace, say: Say) -> Exit:
    """Look, judge, tell."""
    evidence = asyncio.run(_examine(said))
    layers = judge(evidence)
    failure = first_failure(layers)
    facts = {
        "address": evidence.address,
        "layers": [asdict(layer) for layer in layers],
        "first_failure": None if failure is None else failure.name,
        "findings": [asdict(finding) for finding in evidence.findings],
    }
    notes = [f"note: {finding.text}" for finding in evidence.findings]
    say.report(facts, "\n".join([*map(_line, layers), *notes]))
    return Exit.OK if failure is None else Exit.FAULT


def _line(layer: Layer) -> str:
    return f"{_MARKS[layer.verdict]} {layer.name:<8} {layer.text}"


async def _examine(said: argparse.Namespace) -> Evidence:
    evidence = Evidence(said.host, status_port=said.status_port, port=said.port)
    await _listen(said, evidence)
    if evidence.address is None:
        return evidence
    evidence.own_addresses = tuple(addresses_towards(evidence.address))
    try:
        async with asyncio.timeout(_CONNECT_S):
            reader, writer = await asyncio.open_connection(evidence.address, said.port)
    except OSError as error:
        evidence.connect_error = error
        return evidence
    evidence.connected = True
    try:
        await _converse(said, evidence, reader, writer)
    except ConnectionError:
        evidence.ended = True
    finally:
        writer.close()
    return evidence


async def _listen(said: argparse.Namespace, evidence: Evidence) -> None:
    """Wait for a status of the sonar that is meant."""
    try:
        async with asyncio.timeout(said.seconds), Discovery(said.status_port, said.listen) as ears:
            async for sighting in ears.sightings():
                if said.host in (None, sighting.address):
                    evidence.address = sighting.address
                    evidence.sighting = sighting
                    return
    except DiscoveryError as error:
        evidence.listening_fault = str(error)
    except TimeoutError:
        pass


async def _converse(
    said: argparse.Namespace,
    evidence: Evidence,
    reader: asyncio.StreamReader,
    writer: asyncio.StreamWriter,
) -> None:
    """Take what comes, and keep asking for pings or, where nothing comes, for a sign of life."""
    quiet = FireSettings(ping_rate=PingRate.STANDBY).encode(said.version)
    asked = FireSettings(ping_rate=PingRate.LOWEST).encode(said.version) if said.ping else quiet
    evidence.asked_for_pings = said.ping
    listener = _Listener(evidence)
    loop = asyncio.get_running_loop()
    began_s = asked_s = loop.time()
    if said.ping:
        writer.write(asked)
    while (now_s := loop.time()) < began_s + said.seconds and not evidence.ended:
        if now_s >= asked_s + _KEEP_ALIVE_S and (said.ping or not evidence.bytes_received):
            writer.write(asked)
            asked_s = now_s
        data = await _next(reader, min(_KEEP_ALIVE_S, began_s + said.seconds - now_s))
        if data is not None:
            evidence.ended = not data
            listener.feed(data)
    evidence.listened_s = loop.time() - began_s
    if said.ping and not evidence.ended:
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
