"""From what was seen of a sonar to the first layer that fails and what to do about it. Pure.

The layers, each of which needs those before it: address, port, bytes, frames, pings.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, Literal

from oculus_driver.discovery.diagnosis import connection_finding, sighting_findings, silence_finding
from oculus_driver.wire import TCP_PORT, MessageId

if TYPE_CHECKING:
    from ipaddress import IPv4Address

    from oculus_driver.discovery.diagnosis import Finding
    from oculus_driver.discovery.state import Sighting

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
