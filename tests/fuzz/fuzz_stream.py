"""Coverage-guided fuzzing of the driver's stream parser, with atheris.

Usage: python tests/fuzz/fuzz_stream.py CORPUS [-max_total_time=600] [other options of libFuzzer]

Not collected by pytest: `make fuzz` runs it. An input that breaks a promise ends the run and is
left in the working folder; put it into the corpus once it is mended.
"""

import sys

import atheris
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
    """Every byte is in a message or counted as rejected, however the stream is cut."""
    parser = StreamParser(confirm=confirm)
    messages = []
    for at in range(0, len(stream), piece):
        messages += parser.feed(stream[at : at + piece], at)
        if parser.pending_bytes > MAX_PENDING:
            raise AssertionError(f"{parser.pending_bytes} bytes are held back")
    messages += parser.finish()
    taken = sum(len(message.data) for message in messages)
    counters = parser.counters
    if counters.bytes_total != len(stream) or taken + counters.bytes_rejected != len(stream):
        raise AssertionError(f"{taken} taken, {counters}, {len(stream)} fed")
    for message in messages:
        if not isinstance(decode_ping(message), Ping | Reject):
            raise TypeError("a message is neither ping nor reject")


def _finds_what_follows(garbage: bytes) -> None:
    """Intact pings behind garbage are found, all from the first one found on.

    What the garbage claims to hold may swallow those before it, but never all of them.
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
    """Everything that is promised of any bytes."""
    if not data:
        return
    piece = 1 + data[0] * 16
    stream = data[1:]
    _account(stream, piece, confirm=bool(data[0] & 1))
    _account(stream, len(stream) + 1, confirm=False)
    _finds_what_follows(stream)
    decode_status(stream)


def main() -> None:
    """Hand over to libFuzzer."""
    # And not at import: an editable install hides its imports from atheris.
    atheris.instrument_all()
    atheris.Setup(sys.argv, one_input)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
