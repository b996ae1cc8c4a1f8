"""Probe of one sonar: observe it for a while, then find the first layer that fails.

Each layer needs the ones before it: address, port, bytes, frames, pings.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, Literal

from oculus_driver.discovery.diagnosis import (
    connection_finding,
    discovery_findings,
    silence_finding,
)
from oculus_driver.discovery.listener import ANY_HOST, Discovery, addresses_towards
from oculus_driver.errors import DiscoveryError
from oculus_driver.ping import Ping, PingSequence, decode_ping
from oculus_driver.settings import FireSettings, PingRate
from oculus_driver.stream import StreamParser
from oculus_driver.wire import STATUS_PORT, TCP_PORT, MessageId

if TYPE_CHECKING:
    from ipaddress import IPv4Address

    from oculus_driver.discovery.diagnosis import Finding
    from oculus_driver.discovery.state import DiscoveredSonar
    from oculus_driver.stream import Message


Verdict = Literal["ok", "doubtful", "failed", "not tested"]

LAYERS: Final = ("address", "port", "bytes", "frames", "pings")

_UNREACHABLE: Final = ("wrong_subnet",)
_IN_USE: Final = ("held",)
_NO_PINGS: Final = ("boot_loader", "booting", "overheated", "transmitter_failed")


@dataclass(frozen=True, slots=True)
class Layer:
    """One layer: its verdict, and the remedy if it failed."""

    name: str
    verdict: Verdict
    text: str


@dataclass(slots=True)
class ProbeResult:
    """Observations of one sonar.

    Attributes:
        address: of the sonar, None if unknown.
        sonar: its status before the connection, None if none was received.
        own_addresses: addresses of this host towards the sonar.
        status_port, port: the ports in use.
        listen_error: why the status port could not be opened, or None.
        connect_error: why the connection failed, None if it did not fail or was not tried.
        connected: whether the connection was established.
        ended: whether the sonar closed the connection.
        listened_s: time spent waiting for bytes.
        bytes_received, bytes_rejected: from the sonar; those outside messages.
        messages: complete messages by id.
        pings: valid pings; ping_rejects: unusable pings by reason.
        lost_pings: by the ping ids.
        asked_for_pings: whether pings were requested.
    """

    address: str | None = None
    sonar: DiscoveredSonar | None = None
    own_addresses: tuple[IPv4Address, ...] = ()
    status_port: int = 0
    port: int = TCP_PORT
    listen_error: str | None = None
    connect_error: OSError | None = None
    connected: bool = False
    ended: bool = False
    listened_s: float = 0.0
    bytes_received: int = 0
    bytes_rejected: int = 0
    messages: Counter[int] = field(default_factory=Counter)
    pings: int = 0
    ping_rejects: Counter[str] = field(default_factory=Counter)
    lost_pings: int = 0
    asked_for_pings: bool = False

    @property
    def findings(self) -> list[Finding]:
        """Problems in the sonar's status, most severe first."""
        if self.sonar is None:
            return []
        return discovery_findings(self.sonar, self.own_addresses)


def evaluate(result: ProbeResult) -> list[Layer]:
    """Return all five layers; those after the first failure are not tested."""
    layers: list[Layer] = []
    for name, check in zip(LAYERS, (_address, _port, _bytes, _frames, _pings), strict=True):
        if any(layer.verdict == "failed" for layer in layers):
            layers.append(Layer(name, "not tested", f"needs {layers[-1].name}"))
        else:
            layers.append(Layer(name, *check(result)))
    return layers


def first_failure(layers: list[Layer]) -> Layer | None:
    """Return the first layer that failed, None if all passed."""
    return next((layer for layer in layers if layer.verdict == "failed"), None)


def _finding(result: ProbeResult, codes: tuple[str, ...]) -> str | None:
    return next((one.text for one in result.findings if one.code in codes), None)


def _address(result: ProbeResult) -> tuple[Verdict, str]:
    if result.address is None:
        return "failed", result.listen_error or silence_finding(result.status_port).text
    unreachable = _finding(result, _UNREACHABLE)
    if unreachable is not None and not result.connected:
        return "failed", unreachable
    if result.sonar is None:
        why = result.listen_error or f"no status on UDP port {result.status_port}"
        return "doubtful", f"{result.address} (given); {why}"
    status = result.sonar.status
    who = f"{status.model.name}, serial number {status.device_id}, {status.master_state}"
    return "ok", f"{result.address}: {who}"


def _port(result: ProbeResult) -> tuple[Verdict, str]:
    where = f"TCP port {result.port} of {result.address}"
    if result.connected:
        return "ok", f"{where} accepts connections"
    in_use = _finding(result, _IN_USE)
    if in_use is not None:
        return "failed", in_use
    if result.connect_error is None:
        return "failed", f"{where} was not tried"
    finding = connection_finding(result.connect_error, str(result.address), result.port)
    return "failed", finding.text


def _bytes(result: ProbeResult) -> tuple[Verdict, str]:
    if result.bytes_received:
        return "ok", f"{result.bytes_received} bytes in {result.listened_s:.1f} s"
    in_use = _finding(result, _IN_USE)
    if result.ended:
        why = in_use or "another client uses the sonar; close it"
        return "failed", f"the sonar closed the connection at once: {why}"
    reason = (
        in_use
        or _finding(result, _NO_PINGS)
        or (
            "another client may use the sonar, or it hangs: close other programs, then switch its "
            "power off for ten seconds"
        )
    )
    return "failed", f"connected, but nothing received for {result.listened_s:.1f} s: {reason}"


def _frames(result: ProbeResult) -> tuple[Verdict, str]:
    total, rejected = result.bytes_received, result.bytes_rejected
    if not result.messages:
        if total - rejected > 0 and not result.ended:
            text = f"no complete message in {result.listened_s:.1f} s: allow a slow link more time"
            return "doubtful", text
        text = f"{total} bytes contain no Oculus message: check that {result.address} is a sonar"
        return "failed", text
    count = result.messages.total()
    if rejected:
        text = f"{count} messages; {rejected} of {total} bytes outside messages: check the cable"
        return "doubtful", text
    return "ok", f"{count} messages, no invalid bytes"


def _pings(result: ProbeResult) -> tuple[Verdict, str]:
    rejects = ", ".join(f"{reason} {count}" for reason, count in result.ping_rejects.items())
    if result.pings:
        text = f"{result.pings} pings"
        if not rejects and not result.lost_pings:
            return "ok", text
        return "doubtful", f"{text}; rejected: {rejects or 'none'}; lost: {result.lost_pings}"
    if rejects:
        text = f"pings arrive, but all are unusable ({rejects}): record them with `oculus log`"
        return "failed", f"{text} and send us the file"
    reason = _full_pings(result) or _finding(result, _NO_PINGS)
    if reason is not None:
        return "failed", reason
    if not result.asked_for_pings:
        standby = result.messages[MessageId.DUMMY] > 0
        state = "the sonar is in standby" if standby else "no ping without a request"
        return "not tested", f"{state}: put it under water and use --ping"
    return "failed", "no ping after a request: try --version 1, then check the power supply"


def _full_pings(result: ProbeResult) -> str | None:
    count = result.messages[MessageId.FULL_PING_RESULT]
    if not count:
        return None
    text = f"{count} full ping results, which are not mapped: another program requested them"
    return f"{text}; switch the sonar off and on"


_CONNECT_TIMEOUT_S: Final = 3.0
_MAX_READ: Final = 1 << 16
_KEEP_ALIVE_S: Final = 1.0


@dataclass(frozen=True, slots=True)
class ProbeOptions:
    """Options of a probe.

    Attributes:
        host: of the sonar, None for the first one discovered.
        port: of its data connection.
        seconds: duration of each step.
        ping: request pings, then standby: only under water.
        version: of fire messages.
        status_port, listen: where to listen for statuses.
    """

    host: str | None = None
    port: int = TCP_PORT
    seconds: float = 4.0
    ping: bool = False
    version: int = 2
    status_port: int = STATUS_PORT
    listen: str = ANY_HOST


async def probe(options: ProbeOptions) -> ProbeResult:
    """Wait for a status, connect to the sonar, and receive for a while."""
    result = ProbeResult(options.host, status_port=options.status_port, port=options.port)
    await _listen(options, result)
    if result.address is None:
        return result
    result.own_addresses = tuple(addresses_towards(result.address))
    try:
        async with asyncio.timeout(_CONNECT_TIMEOUT_S):
            reader, writer = await asyncio.open_connection(result.address, options.port)
    except OSError as error:
        result.connect_error = error
        return result
    result.connected = True
    try:
        await _exchange(options, result, reader, writer)
    except ConnectionError:
        result.ended = True
    finally:
        writer.close()
    return result


async def _listen(options: ProbeOptions, result: ProbeResult) -> None:
    """Wait for a status of the selected sonar."""
    try:
        async with (
            asyncio.timeout(options.seconds),
            Discovery(options.status_port, options.listen) as ears,
        ):
            async for sonar in ears.updates():
                if options.host in (None, sonar.address):
                    result.address = sonar.address
                    result.sonar = sonar
                    return
    except DiscoveryError as error:
        result.listen_error = str(error)
    except TimeoutError:
        pass


async def _exchange(
    options: ProbeOptions,
    result: ProbeResult,
    reader: asyncio.StreamReader,
    writer: asyncio.StreamWriter,
) -> None:
    """Receive, and keep requesting pings or, while nothing arrives, a sign of life."""
    quiet = FireSettings(ping_rate=PingRate.STANDBY).encode(options.version)
    asked = (
        FireSettings(ping_rate=PingRate.LOWEST).encode(options.version) if options.ping else quiet
    )
    result.asked_for_pings = options.ping
    counter = _StreamCounter(result)
    loop = asyncio.get_running_loop()
    began_s = asked_s = loop.time()
    if options.ping:
        writer.write(asked)
    while (now_s := loop.time()) < began_s + options.seconds and not result.ended:
        if now_s >= asked_s + _KEEP_ALIVE_S and (options.ping or not result.bytes_received):
            writer.write(asked)
            asked_s = now_s
        data = await _read(reader, min(_KEEP_ALIVE_S, began_s + options.seconds - now_s))
        if data is not None:
            result.ended = not data
            counter.feed(data)
    result.listened_s = loop.time() - began_s
    if options.ping and not result.ended:
        writer.write(quiet)
        await _read_until_standby(reader, counter)
    counter.finish()


async def _read_until_standby(reader: asyncio.StreamReader, counter: _StreamCounter) -> None:
    """Read on until the sonar is in standby; closing earlier could lose the request."""
    loop = asyncio.get_running_loop()
    end_s = loop.time() + _KEEP_ALIVE_S
    before = counter.dummies
    while counter.dummies == before and (left_s := end_s - loop.time()) > 0.0:
        data = await _read(reader, left_s)
        if not data:
            break
        counter.feed(data)


async def _read(reader: asyncio.StreamReader, limit_s: float) -> bytes | None:
    """Return the next bytes, empty at the end of the stream, None on a timeout."""
    try:
        async with asyncio.timeout(limit_s):
            return await reader.read(_MAX_READ)
    except TimeoutError:
        return None


class _StreamCounter:
    """Counts the content of a stream."""

    def __init__(self, result: ProbeResult) -> None:
        self._evidence = result
        self._parser = StreamParser()
        self._sequence = PingSequence()

    @property
    def dummies(self) -> int:
        """Number of dummy messages."""
        return self._parser.counters.messages[MessageId.DUMMY]

    def feed(self, data: bytes) -> None:
        """Add received bytes."""
        self._evidence.bytes_received += len(data)
        self._count(self._parser.feed(data))

    def finish(self) -> None:
        """Store the final counts; an incomplete message at the end is not an error."""
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
