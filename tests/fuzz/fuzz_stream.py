"""Coverage-guided fuzzing of the driver's stream parser, with atheris.

Usage: python -m tests.fuzz.fuzz_stream CORPUS [-max_total_time=600] [options of libFuzzer]

`make fuzz` runs it. An input that breaks a check ends the run and is left in the working folder.
Minimise it (-minimize_crash=1), and add it to `stream.cases` together with the repair.
"""

import numpy as np

from oculus_driver import (
    Ping,
    Reject,
    StreamParser,
    bearing_table_cdeg,
    decode_ping,
    decode_status,
    encode_ping,
)
from tests.fuzz.cases import fuzz

MAX_PENDING = (16 << 20) + (1 << 16)


def _ping(ping_id: int) -> bytes:
    image = np.full((4, 256), ping_id, dtype=np.uint8)
    return encode_ping(
        ping_id=ping_id,
        mode=1,
        frequency_hz=750e3,
        range_m=4.0,
        gain_percent=50.0,
        speed_of_sound_mps=1500.0,
        salinity_ppt=35.0,
        start_time=float(ping_id),
        range_resolution_m=1.0,
        bearings_cdeg=bearing_table_cdeg(256, 1.1),
        image=image,
    )


INTACT = [_ping(index) for index in (1, 2, 3, 4)]


def _account(stream: bytes, piece: int, *, confirm: bool) -> None:
    """Check that every byte is in a message or counted as rejected, in pieces of any size."""
    parser = StreamParser(confirm=confirm)
    messages = []
    for at in range(0, len(stream), piece):
        messages += parser.feed(stream[at : at + piece], at)
        if parser.pending_bytes > MAX_PENDING:
            raise AssertionError(f"{parser.pending_bytes} bytes are buffered")
    messages += parser.finish()
    taken = sum(len(message.data) for message in messages)
    counters = parser.counters
    if counters.bytes_total != len(stream) or taken + counters.bytes_rejected != len(stream):
        raise AssertionError(f"{taken} in messages, {counters}, {len(stream)} received")
    for message in messages:
        if not isinstance(decode_ping(message), Ping | Reject):
            raise TypeError("a message is neither ping nor reject")


def _finds_what_follows(garbage: bytes) -> None:
    """Check that intact pings after garbage are found, all of them from the first one found.

    A size that the garbage declares may cover pings before that one, but never all of them.
    """
    parser = StreamParser(confirm=True)
    behind = b"".join(INTACT) * 4
    messages = parser.feed(garbage + behind, 0) + parser.finish()
    found = {message.offset for message in messages}
    starts = range(len(garbage), len(garbage) + len(behind), len(INTACT[0]))
    first = next((start for start in starts if start in found), None)
    if first is None or not all(start in found for start in starts if start >= first):
        raise AssertionError(f"found {sorted(found)} of {list(starts)}")


def one_input(data: bytes) -> None:
    """Check one input; raise an error where a check fails."""
    if not data:
        return
    piece = 1 + data[0] * 16
    stream = data[1:]
    _account(stream, piece, confirm=bool(data[0] & 1))
    _account(stream, len(stream) + 1, confirm=False)
    _finds_what_follows(stream)
    decode_status(stream)


if __name__ == "__main__":
    fuzz("stream", one_input)
