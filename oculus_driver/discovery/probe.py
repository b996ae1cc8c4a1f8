"""Observe one sonar for a while; `oculus_driver.discovery.probe` evaluates the result."""

from __future__ import annotations

import asyncio
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, Literal

from oculus_driver.discovery.diagnosis import connection_finding, sighting_findings, silence_finding
from oculus_driver.discovery.listener import ANY_HOST, Discovery, addresses_towards
from oculus_driver.errors import DiscoveryError
from oculus_driver.ping import Ping, PingSequence, decode_ping
from oculus_driver.settings import FireSettings, PingRate
from oculus_driver.stream import StreamParser
from oculus_driver.wire import STATUS_PORT, TCP_PORT, MessageId

if TYPE_CHECKING:
    from ipaddress import IPv4Address

    from oculus_driver.discovery.diagnosis import Finding
    from oculus_driver.discovery.state import Sighting
    from oculus_driver.stream import Message


Verdict = Literal["ok", "doubtful", "failed", "not tested"]

LAYERS: Final = ("address", "port", "bytes", "frames", "pings")

_UNREACHABLE: Final = ("wrong_subnet",)
_TAKEN: Final = ("held",)
_NO_PINGS: Final = ("boot_loader", "booting", "overheated", "transmitter_failed")


@dataclass(frozen=True, slots=True)
class Layer:
    """One layer: what is known of it, and what to do where it fails."""

    name: str
    verdict: Verdict
    text: str


@dataclass(slots=True)
class Evidence:
    """What was seen of one sonar.

    Attributes:
        address: of the sonar, None where none is known.
        sighting: its status before we connected, None where none was heard.
        own_addresses: of this host, towards the sonar.
        status_port, port: that were used.
        listening_fault: why statuses could not be listened for, or None.
        connect_error: why the connection failed, None where it stands or was not tried.
        connected: whether it stood.
        ended: whether the sonar ended it.
        listened_s: how long bytes were waited for.
        bytes_received, bytes_rejected: from the sonar; of these, that belong to no message.
        messages: whole messages by id.
        pings: good ones; ping_rejects: the others, by reason.
        lost_pings: what the ids say.
        asked_for_pings: whether the sonar was asked to ping.
    """

    address: str | None = None
    sighting: Sighting | None = None
    own_addresses: tuple[IPv4Address, ...] = ()
    status_port: int = 0
    port: int = TCP_PORT
    listening_fault: str | None = None
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
        """What the sonar's status says, the worst first."""
        if self.sighting is None:
            return []
        return sighting_findings(self.sighting, self.own_addresses)


def judge(evidence: Evidence) -> list[Layer]:
    """Return all five layers; those behind the first that fails are not tested."""
    layers: list[Layer] = []
    for name, look in zip(LAYERS, (_address, _port, _bytes, _frames, _pings), strict=True):
        if any(layer.verdict == "failed" for layer in layers):
            layers.append(Layer(name, "not tested", f"needs {layers[-1].name}"))
        else:
            layers.append(Layer(name, *look(evidence)))
    return layers


def first_failure(layers: list[Layer]) -> Layer | None:
    """Return the layer to look at first, None where none failed."""
    return next((layer for layer in layers if layer.verdict == "failed"), None)


def _finding(evidence: Evidence, codes: tuple[str, ...]) -> str | None:
    return next((one.text for one in evidence.findings if one.code in codes), None)


def _address(evidence: Evidence) -> tuple[Verdict, str]:
    if evidence.address is None:
        return "failed", evidence.listening_fault or silence_finding(evidence.status_port).text
    astray = _finding(evidence, _UNREACHABLE)
    if astray is not None and not evidence.connected:
        return "failed", astray
    if evidence.sighting is None:
        why = evidence.listening_fault or f"no status on UDP port {evidence.status_port}"
        return "doubtful", f"{evidence.address} as given; {why}"
    status = evidence.sighting.status
    who = f"{status.model.name}, serial number {status.device_id}, {status.master_state}"
    return "ok", f"{evidence.address}: {who}"


def _port(evidence: Evidence) -> tuple[Verdict, str]:
    where = f"TCP port {evidence.port} of {evidence.address}"
    if evidence.connected:
        return "ok", f"{where} takes the connection"
    taken = _finding(evidence, _TAKEN)
    if taken is not None:
        return "failed", taken
    if evidence.connect_error is None:
        return "failed", f"{where} was not tried"
    finding = connection_finding(evidence.connect_error, str(evidence.address), evidence.port)
    return "failed", finding.text


def _bytes(evidence: Evidence) -> tuple[Verdict, str]:
    if evidence.bytes_received:
        return "ok", f"{evidence.bytes_received} bytes in {evidence.listened_s:.1f} s"
    taken = _finding(evidence, _TAKEN)
    if evidence.ended:
        why = taken or "another client holds the sonar; close it"
        return "failed", f"the connection is closed at once: {why}"
    reason = (
        taken
        or _finding(evidence, _NO_PINGS)
        or (
            "another client may hold the sonar, or it hangs: close other programs, then switch its "
            "power off for ten seconds"
        )
    )
    return "failed", f"connected, and nothing comes for {evidence.listened_s:.1f} s: {reason}"


def _frames(evidence: Evidence) -> tuple[Verdict, str]:
    total, rejected = evidence.bytes_received, evidence.bytes_rejected
    if not evidence.messages:
        if total - rejected > 0 and not evidence.ended:
            text = f"no whole message in {evidence.listened_s:.1f} s: a slow link? Wait longer"
            return "doubtful", text
        text = f"{total} bytes hold no message of an Oculus sonar: is {evidence.address} one?"
        return "failed", text
    count = evidence.messages.total()
    if rejected:
        text = f"{count} messages; {rejected} of {total} bytes belong to none: check the cable"
        return "doubtful", text
    return "ok", f"{count} messages, no byte lost"


def _pings(evidence: Evidence) -> tuple[Verdict, str]:
    rejects = ", ".join(f"{reason} {count}" for reason, count in evidence.ping_rejects.items())
    if evidence.pings:
        text = f"{evidence.pings} pings"
        if not rejects and not evidence.lost_pings:
            return "ok", text
        return "doubtful", f"{text}; refused: {rejects or 'none'}; lost: {evidence.lost_pings}"
    if rejects:
        text = f"pings come and none can be used ({rejects}): record them with `oculus log`"
        return "failed", f"{text} and send us the file"
    reason = _finding(evidence, _NO_PINGS)
    if reason is not None:
        return "failed", reason
    if not evidence.asked_for_pings:
        standby = evidence.messages[MessageId.DUMMY] > 0
        state = "the sonar is in standby" if standby else "no ping came by itself"
        return "not tested", f"{state}: put it under water and use --ping"
    return "failed", "asked for pings, and none came: try --version 1, then look at its supply"


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
