"""Files of other programs, put together from their specifications, not with our declarations."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

LOG_START_S = 1_700_000_000.25
SONAR = bytes((192, 168, 2, 3))
HOST = bytes((192, 168, 2, 10))
SYN, ACK = 0x02, 0x10


def log_header(*, magic: int = 0x11223344, encryption: int = 0) -> bytes:
    """Return the 48 bytes that an `.oculus` log of version 1 begins with."""
    head = struct.pack("<II16sHH4xqd", magic, 48, b"Oculus", 1, encryption, 0, LOG_START_S)
    assert len(head) == 48
    return head


def log_item(
    payload: bytes,
    *,
    kind: int = 10,
    unix_s: float = LOG_START_S,
    compression: int = 0,
    original: int | None = None,
    magic: int = 0xAABBCCDD,
    size: int | None = None,
) -> bytes:
    """Return one item of such a log."""
    head = struct.pack(
        "<IIHH4xdH2xII4x",
        magic,
        40,
        kind,
        0,
        unix_s,
        compression,
        len(payload) if original is None else original,
        len(payload) if size is None else size,
    )
    assert len(head) == 40
    return head + payload


def ipv4(protocol: int, payload: bytes, source: bytes, destination: bytes) -> bytes:
    """Return an IPv4 packet; its checksum is 0, as with offloading."""
    total = 20 + len(payload)
    return (
        struct.pack(
            ">BBHHHBBH4s4s", 0x45, 0, total, 0, 0x4000, 64, protocol, 0, source, destination
        )
        + payload
    )


def ipv6(protocol: int, payload: bytes, source: bytes, destination: bytes) -> bytes:
    """Return an IPv6 packet between addresses of 16 bytes."""
    head = struct.pack(">IHBB16s16s", 6 << 28, len(payload), protocol, 64, source, destination)
    return head + payload


def tcp(sequence: int, payload: bytes, *, ports: tuple[int, int], flags: int = ACK) -> bytes:
    """Return a TCP segment with 12 bytes of options."""
    sequence %= 1 << 32
    head = struct.pack(">HHIIBBHHH", *ports, sequence, 1, 8 << 4, flags, 512, 0, 0)
    return head + bytes(12) + payload


def udp(payload: bytes, *, ports: tuple[int, int]) -> bytes:
    """Return a UDP datagram."""
    return struct.pack(">HHHH", *ports, 8 + len(payload), 0) + payload


def ethernet(packet: bytes, *, vlan: int | None = None) -> bytes:
    """Return an Ethernet frame, padded to its least size."""
    kind = 0x86DD if packet[0] >> 4 == 6 else 0x0800
    tag = b"" if vlan is None else struct.pack(">HH", 0x8100, vlan)
    frame = bytes(12) + tag + struct.pack(">H", kind) + packet
    return frame.ljust(60, b"\xee")


def pcap(packets: list[tuple[int, bytes]], *, order: str = "<", nano: bool = False) -> bytes:
    """Return a capture file of Ethernet frames with stamps in nanoseconds."""
    magic, unit = (0xA1B23C4D, 1) if nano else (0xA1B2C3D4, 1000)
    out = [struct.pack(order + "IHHiIII", magic, 2, 4, 0, 0, 262144, 1)]
    for stamp_ns, frame in packets:
        seconds, rest = divmod(stamp_ns, 10**9)
        size = len(frame)
        out += [struct.pack(order + "IIII", seconds, rest // unit, size, size), frame]
    return b"".join(out)


def block(kind: int, body: bytes, order: str = "<") -> bytes:
    """Return one block of a pcapng file."""
    body += bytes(-len(body) % 4)
    size = struct.pack(order + "I", 12 + len(body))
    return struct.pack(order + "I", kind) + size + body + size


def section(order: str = "<") -> bytes:
    """Return a section header block."""
    return block(0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, 1, 0, -1), order)


def interface(order: str = "<", *, resolution: int = 9, link_type: int = 1) -> bytes:
    """Return an interface description block with its time resolution as an option."""
    options = struct.pack(order + "HHB3xHH", 9, 1, resolution, 0, 0)
    return block(1, struct.pack(order + "HHI", link_type, 0, 262144) + options, order)


def packet(ticks: int, frame: bytes, order: str = "<", number: int = 0) -> bytes:
    """Return an enhanced packet block."""
    size = len(frame)
    head = struct.pack(order + "IIIII", number, ticks >> 32, ticks & 0xFFFFFFFF, size, size)
    return block(6, head + frame, order)


@dataclass
class Wire:
    """Frames of one TCP connection from a sonar, with stamps 1 ms apart."""

    port: int = 52100
    sequence: int = 0xFFFF_F000  # wraps soon
    source: bytes = SONAR
    client_port: int = 40_000
    now_ns: int = 1_790_000_000_000_000_000
    frames: list[tuple[int, bytes]] = field(default_factory=list)

    def segment(self, sequence: int, payload: bytes, flags: int = ACK) -> tuple[int, bytes]:
        """Return a stamped frame that carries a segment."""
        self.now_ns += 1_000_000
        body = tcp(sequence, payload, ports=(self.port, self.client_port), flags=flags)
        return self.now_ns, ethernet(ipv4(6, body, self.source, HOST))

    def open(self) -> None:
        """Add the sonar's half of a handshake."""
        self.frames.append(self.segment(self.sequence, b"", SYN | ACK))
        self.sequence += 1

    def send(self, data: bytes, size: int = 1448) -> None:
        """Add segments that carry `data`."""
        for start in range(0, len(data), size):
            part = data[start : start + size]
            self.frames.append(self.segment(self.sequence, part))
            self.sequence += len(part)
