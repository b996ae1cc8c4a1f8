"""Which bytes are taken for the next record, and which are not."""

from __future__ import annotations

import io
import struct

import pytest

from oculus_driver.recording import mcap_records as mcap
from oculus_driver.recording.salvage import find_record

NOW = 10**18
HOUR = 3_600 * 10**9
MESSAGE = mcap.message_head(1, 0, NOW, 300) + bytes(300)
CHUNK = mcap.chunk_head(NOW, NOW + 1, len(MESSAGE), 0) + MESSAGE


def found(data: bytes, near_ns: int | None = NOW) -> int | None:
    return find_record(io.BytesIO(data), (0, len(data)), len(data), {1}, near_ns)


def chunk(span: tuple[int, int], name: bytes, sizes: tuple[int, int, int]) -> bytes:
    """Return a chunk that claims a length, and a size before and after inflating."""
    length, size, inflated = sizes
    head = mcap.HEAD.pack(6, length) + mcap.CHUNK_HEAD.pack(*span, inflated, 0, len(name))
    return head + name + struct.pack("<Q", size) + bytes(1000)


@pytest.mark.parametrize("lead", [b"", b"\x05", b"\x05\x01", b"\x06" * 3, b"\x05\x00" * 700_000])
def test_chunks_and_messages_are_found_behind_anything(lead: bytes) -> None:
    assert found(lead + CHUNK) == len(lead)
    assert found(lead + MESSAGE) == len(lead)


def test_only_what_starts_in_the_place_is_found() -> None:
    data = b"xx" + MESSAGE
    size = len(data)
    assert find_record(io.BytesIO(data), (0, 2), size, {1}, NOW) is None
    assert find_record(io.BytesIO(data), (2, 3), size, {1}, NOW) == 2
    assert find_record(io.BytesIO(data), (3, size), size, {1}, NOW) is None


def test_good_compressed_chunks_are_found() -> None:
    assert found(chunk((1, 2), b"zstd", (54, 10, 999))) == 0
    assert found(chunk((1, 2), b"lz4", (53, 10, 999))) == 0
    assert found(chunk((1, 2), b"", (50, 10, 10))) == 0


@pytest.mark.parametrize(
    "data",
    [
        chunk((1, 2), b"", (50, 10, 11)),
        chunk((1, 2), b"", (51, 10, 10)),
        chunk((2, 1), b"", (50, 10, 10)),
        chunk((1, 2), b"zst!", (54, 10, 999)),
        chunk((1, 2), b"snappy", (56, 10, 999)),
        chunk((1, 2), b"", (5040, 5000, 5000)),
        MESSAGE[:-1],
        mcap.message_head(2, 0, NOW, 300) + bytes(300),
        mcap.message_head(1, 0, NOW + HOUR + 1, 300) + bytes(300),
        mcap.message_head(1, 0, NOW - HOUR - 1, 300) + bytes(300),
        struct.pack("<BQ", 5, 21) + MESSAGE[9:],
        MESSAGE[:20],
        CHUNK[:30],
    ],
)
def test_heads_that_contradict_themselves_are_passed_over(data: bytes) -> None:
    assert found(data) is None


def test_without_a_stamp_only_chunks_are_found() -> None:
    assert found(MESSAGE, None) is None
    assert found(b"x" + CHUNK, None) == 1
