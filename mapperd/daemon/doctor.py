"""From what was seen of the odometry to the first layer that fails, and what to do. Pure.

The layers, each of which needs those before it: address, port, bytes, frames, checks, poses.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

from mapperd.config.odometry import LinkAddress
from mapperd.odometry.decoder import DecoderCounters
from mapperd.odometry.links import LinkPhase, OdometryLinkStatus
from oculus_driver.discovery.probe import Layer, Verdict

__all__ = ["LAYERS", "PORT_REMEDIES", "LinkEvidence", "judge_link", "without_odometry"]

LAYERS = ("address", "port", "bytes", "frames", "checks", "poses")

OPEN = (LinkPhase.WAITING, LinkPhase.RECEIVING, LinkPhase.SILENT)
MAX_NAMES = 6
MUCH_LOST = 0.05
"""Part of a stream that belongs to no frame, above which something is wrong with the line."""


PORT_REMEDIES = {
    "udp": "give the source another port, or stop the program that uses this one",
    "tcp": "check that the sender is on, its address, and that this host is in its subnet",
    "serial": "check the plug, the name, and that this user is in the group dialout",
}
"""By kind of a link that cannot be opened."""


@dataclass(frozen=True, slots=True)
class LinkEvidence:
    """What was seen of one source.

    Attributes:
        name, address, format: as configured.
        status: of the link, in the end.
        seconds: how long it was watched.
        decoder: what its bytes held; None without any.
        refused: reason to count, of records that fusion did not take.
        owns: quantities that come from it.
        fault: why no pose can be had of all sources together; None where one can.
        missing_library: why the format or the link cannot be used at all; None where it can.
    """

    name: str
    address: LinkAddress
    format: str
    status: OdometryLinkStatus
    seconds: float
    decoder: DecoderCounters | None = None
    refused: Counter[str] = field(default_factory=Counter)
    owns: tuple[str, ...] = ()
    fault: str | None = None
    missing_library: str | None = None


def judge_link(evidence: LinkEvidence) -> list[Layer]:
    """All six layers; those behind the first that fails are not tested."""
    layers: list[Layer] = []
    for name, look in zip(LAYERS, _LOOKS, strict=True):
        if any(layer.verdict == "failed" for layer in layers):
            layers.append(Layer(name, "not tested", f"needs {layers[-1].name}"))
        else:
            layers.append(Layer(name, *look(evidence)))
    return layers


def _address(evidence: LinkEvidence) -> tuple[Verdict, str]:
    if evidence.missing_library is not None:
        return "failed", evidence.missing_library
    return "ok", f"{evidence.address}, format {evidence.format}"


def _port(evidence: LinkEvidence) -> tuple[Verdict, str]:
    status = evidence.status
    if status.phase in OPEN or status.bytes_received:
        return "ok", f"{evidence.address} is open"
    return "failed", f"{status.reason}; {PORT_REMEDIES[evidence.address.kind]}"


def _bytes(evidence: LinkEvidence) -> tuple[Verdict, str]:
    received = evidence.status.bytes_received
    if received:
        rate = received / max(evidence.seconds, 1e-9)
        return "ok", f"{received} bytes, {rate:.0f} a second"
    nothing = f"nothing received for {evidence.seconds:.0f} s on {evidence.address}"
    port = evidence.address.port
    advice = {
        "udp": f"let the vehicle send to this host's port {port}; on BlueOS add a UDP client "
        f"endpoint to this host's address and port {port}"
        + (
            "; it listens to this host alone, 0.0.0.0 would hear the network"
            if evidence.address.host.startswith("127.")
            else ""
        ),
        "tcp": "the sender takes the connection and stays silent: is it pinging, and in water?",
        "serial": f"check the wiring (RX to TX) and the {evidence.address.baud} baud",
    }[evidence.address.kind]
    return "failed", f"{nothing}: {advice}"


def _frames(evidence: LinkEvidence) -> tuple[Verdict, str]:
    decoder = evidence.decoder
    if decoder is None or not decoder.frames:
        held = evidence.status.bytes_received
        return "failed", (
            f"none of {held} bytes belongs to a frame of format {evidence.format}: "
            "is the source's format right, and on a serial line the baud rate?"
        )
    text = f"{decoder.frames} whole: {_counts(decoder.messages)}"
    lost = decoder.bytes_skipped / max(decoder.bytes_total, 1)
    if lost > MUCH_LOST:
        return "doubtful", f"{text}; {100 * lost:.0f} % of the bytes belong to none"
    return "ok", text


def _checks(evidence: LinkEvidence) -> tuple[Verdict, str]:
    decoder = evidence.decoder
    assert decoder is not None  # noqa: S101 - frames came
    bad = decoder.rejects + evidence.refused
    if not decoder.records:
        if decoder.rejects:
            return "failed", f"every record is refused: {_counts(decoder.rejects)}"
        return "failed", (
            f"no odometry among them ({_counts(decoder.ignored or decoder.messages)}): "
            + without_odometry(evidence.format)
        )
    if bad:
        return "doubtful", f"{decoder.records} records; refused: {_counts(bad)}"
    return "ok", f"{decoder.records} records, none refused"


def without_odometry(name: str) -> str:
    """Return what to do about a sender of valid messages without odometry."""
    if name == "mavlink":
        return (
            "the autopilot sends no position or attitude to this link, or another system's are "
            "left out (mavlink_system_id); LOCAL_POSITION_NED flows only once an origin is set"
        )
    return "let the sender add its position, attitude or velocity"


def _poses(evidence: LinkEvidence) -> tuple[Verdict, str]:
    if not evidence.owns:
        return "doubtful", "no quantity of this source is used: other sources own them"
    owned = ", ".join(evidence.owns)
    if evidence.fault is not None:
        return "failed", f"{owned} come from here, but no pose can be had: {evidence.fault}"
    return "ok", f"{owned} come from here, and poses can be had"


def _counts(counts: Counter[str]) -> str:
    most = [f"{name} {count}" for name, count in counts.most_common(MAX_NAMES)]
    return ", ".join(most) + (", …" if len(counts) > MAX_NAMES else "")


_LOOKS: tuple[Callable[[LinkEvidence], tuple[Verdict, str]], ...] = (
    _address,
    _port,
    _bytes,
    _frames,
    _checks,
    _poses,
)
