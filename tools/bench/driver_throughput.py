"""How fast the driver turns a stream into pings, by message size.

Feeds version 2 pings of 512 beams and 8 bit to `StreamParser` and `decode_ping` in pieces as a
socket gives them, on one core. Prints a table, with the ratio to the largest rate that an M750d can
send, and draws docs/images/driver-throughput.png.

Usage: python -m bench driver-throughput [--picture FILE]
"""

import argparse
import statistics
import time
import tracemalloc
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from oculus_driver import Ping, StreamParser, bearing_table_cdeg, decode_ping, encode_ping

PICTURE = Path("docs/images/driver-throughput.png")
ROWS = (16, 64, 200, 400, 703, 1400, 2800)
MAX_ROWS = 703
"""Rows of the pings in the captures that we have."""
MAX_RATE_HZ = 40.0
BEAMS = 512
PIECE = 1 << 16
STREAM_BYTES = 200_000_000
ASKED = 20.0


@dataclass(frozen=True, slots=True)
class Throughput:
    """One message size: rate of the stream, time of one ping, and memory of one."""

    message_bytes: int
    mb_per_s: float
    pings_per_s: float
    median_us: float
    peak_kb: float


def message_of(rows: int) -> bytes:
    """A ping with noise in it."""
    rng = np.random.default_rng(rows)
    return encode_ping(
        ping_id=1,
        mode=1,
        frequency_hz=750e3,
        range_m=10.0,
        gain_percent=50.0,
        speed_of_sound_mps=1500.0,
        salinity_ppt=35.0,
        start_time=1.0,
        range_resolution_m=10.0 / rows,
        bearings_cdeg=bearing_table_cdeg(BEAMS, np.radians(65.0)),
        image=rng.integers(0, 256, (rows, BEAMS), dtype=np.uint8),
    )


def decode(stream: bytes, times: int) -> tuple[float, int]:
    """Seconds and pings of a stream that is fed again and again."""
    parser = StreamParser()
    pings = 0
    began_s = time.perf_counter()
    for _ in range(times):
        for at in range(0, len(stream), PIECE):
            for message in parser.feed(stream[at : at + PIECE], 0):
                pings += isinstance(decode_ping(message), Ping)
    return time.perf_counter() - began_s, pings


def last_byte_to_ping_us(message: bytes, repeats: int = 200) -> float:
    """Median microseconds from the last piece of a message to its ping."""
    head, tail = message[:-PIECE], message[-PIECE:]
    took = []
    for _ in range(repeats):
        parser = StreamParser()
        parser.feed(head, 0)
        began_s = time.perf_counter()
        pings = [decode_ping(found) for found in parser.feed(tail, 0)]
        took.append(1e6 * (time.perf_counter() - began_s))
        if not pings:
            raise SystemExit("the ping was not found: nothing is measured")
    return statistics.median(took)


def peak_kb(message: bytes) -> float:
    """Most memory in use while one ping is decoded, beyond what was there before."""
    parser = StreamParser()
    tracemalloc.start()
    for at in range(0, len(message), PIECE):
        for found in parser.feed(message[at : at + PIECE], 0):
            decode_ping(found)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak / 1024


def measure(rows: int) -> Throughput:
    """One message size."""
    message = message_of(rows)
    stream = message * max(1, 4_000_000 // len(message))
    times = max(1, STREAM_BYTES // len(stream))
    took_s, pings = decode(stream, times)
    if pings != times * len(stream) // len(message):
        raise SystemExit(f"{pings} pings of {rows} rows came out: nothing is measured")
    rate = times * len(stream) / took_s / 1e6
    return Throughput(
        len(message), rate, pings / took_s, last_byte_to_ping_us(message), peak_kb(message)
    )


def draw(found: list[Throughput], largest_mb_per_s: float, file: Path) -> None:
    """Rate against size, with what the sonar can send."""
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.add_subplot(
        xscale="log", yscale="log", xlabel="message, kB", ylabel="stream, MB/s, one core"
    )
    axes.plot([t.message_bytes / 1e3 for t in found], [t.mb_per_s for t in found], marker="o")
    for factor, label in ((1.0, "the largest rate of an M750d"), (ASKED, "20 times that")):
        axes.axhline(factor * largest_mb_per_s, linestyle=":", color="k", linewidth=1)
        axes.annotate(label, (found[0].message_bytes / 1e3, 1.06 * factor * largest_mb_per_s))
    axes.set_title("From bytes to pings: 512 beams, 8 bit, version 2")
    axes.grid(visible=True, which="both", alpha=0.25)
    FigureCanvasAgg(figure)
    figure.savefig(file, dpi=110)


def main() -> None:
    """Measure, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--picture", type=Path, default=PICTURE)
    args = parser.parse_args()
    largest_mb_per_s = len(message_of(MAX_ROWS)) * MAX_RATE_HZ / 1e6
    print(f"largest rate of an M750d: {largest_mb_per_s:.1f} MB/s\n")
    print("| rows | message, kB | MB/s | times largest | pings/s | last byte to ping | peak, kB |")
    print("|---:|---:|---:|---:|---:|---:|---:|")
    found = []
    for rows in ROWS:
        t = measure(rows)
        found.append(t)
        print(
            f"| {rows} | {t.message_bytes / 1e3:.0f} | {t.mb_per_s:.0f} | "
            f"{t.mb_per_s / largest_mb_per_s:.0f} | {t.pings_per_s:.0f} | "
            f"{t.median_us:.0f} µs | {t.peak_kb:.0f} |",
            flush=True,
        )
    args.picture.parent.mkdir(parents=True, exist_ok=True)
    draw(found, largest_mb_per_s, args.picture)


if __name__ == "__main__":
    main()
