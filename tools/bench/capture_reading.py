"""How fast network captures are read: our reader beside dpkt, which does less.

`python -m bench capture-reading` writes a capture of an M750d into a temporary folder and
reads it. dpkt parses each packet and appends its payload to its flow, in the order of the file:
no reordering, no repeats, no bounds.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

import dpkt
import numpy as np

from oculus_driver import bearing_table_cdeg, encode_ping
from oculus_driver.recording import PCAP, RecordingWriter, convert, open_recording
from oculus_driver.recording.chunk import OCULUS

if TYPE_CHECKING:
    from collections.abc import Callable

PINGS: Final = 400
ROWS: Final = 700
BEAMS: Final = 512
SEGMENT: Final = 1448
"""Payload of a segment on Ethernet."""

REPEATS: Final = 3
MB: Final = 1_000_000


def write_capture(folder: Path) -> Path:
    """Write pings as segments of Ethernet's size; returns the capture."""
    image = np.random.default_rng(1).integers(0, 255, (ROWS, BEAMS), dtype=np.uint8)
    with RecordingWriter(folder / "stream.mcap") as writer:
        link = writer.add_link("sonar", OCULUS)
        for number in range(PINGS):
            ping = encode_ping(
                ping_id=number,
                mode=1,
                frequency_hz=750e3,
                range_m=10.0,
                gain_percent=50.0,
                speed_of_sound_mps=1500.0,
                salinity_ppt=35.0,
                start_time=0.1 * number,
                range_resolution_m=10.0 / ROWS,
                bearings_cdeg=bearing_table_cdeg(BEAMS, np.pi / 3),
                image=image,
            )
            for start in range(0, len(ping), SEGMENT):
                writer.write(link, ping[start : start + SEGMENT], 10**18 + number * 10**8)
    convert(folder / "stream.mcap", folder / "stream.pcap", PCAP)
    return folder / "stream.pcap"


def read_ours(path: Path) -> int:
    """Return the bytes of the stream, put together by our reader."""
    with open_recording(path) as recording:
        return sum(len(chunk.data) for chunk in recording)


def read_dpkt(path: Path) -> int:
    """Return the bytes of the stream, appended as dpkt finds them."""
    flows: dict[tuple[bytes, int], bytearray] = {}
    with path.open("rb") as file:
        for _, data in dpkt.pcap.Reader(file):
            packet = dpkt.ip.IP(data)
            segment = packet.data
            flows.setdefault((packet.src, segment.sport), bytearray()).extend(segment.data)
    return sum(map(len, flows.values()))


def best_s(read: Callable[[Path], int], path: Path, expected: int) -> float:
    """Return the shortest time that reading takes; the result must be whole."""
    times: list[float] = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        if read(path) != expected:
            raise SystemExit(f"{read.__name__}: not the whole stream")
        times.append(time.perf_counter() - start)
    return min(times)


def main() -> None:
    """Print a line for each reader."""
    with tempfile.TemporaryDirectory() as folder:
        path = write_capture(Path(folder))
        size = path.stat().st_size
        expected = read_ours(path)
        for read in (read_ours, read_dpkt):
            seconds = best_s(read, path, expected)
            packets = -(-expected // SEGMENT)
            print(
                f"{read.__name__}: {size / MB / seconds:.0f} MB/s, "
                f"{seconds / packets * 1e6:.1f} µs a packet"
            )


if __name__ == "__main__":
    main()
