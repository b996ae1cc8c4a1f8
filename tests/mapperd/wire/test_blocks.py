"""Blocks as bytes and back, and malformed bytes."""

from concurrent.futures import ThreadPoolExecutor

import hypothesis.extra.numpy as arrays
import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

from mapperd.wire.blocks import (
    CELLS,
    MAX_BODY,
    MAX_KEY,
    UNKNOWN,
    BlockSet,
    decode_blocks,
    encode_blocks,
)
from mapperd.wire.framing import StreamError
from mapperd.wire.messages import MAX_BLOCKS

KINDS = st.sampled_from(["empty", "uniform", "plane"])


@st.composite
def some_blocks(draw: st.DrawFn) -> BlockSet:
    kinds = draw(st.lists(KINDS, max_size=8))
    number = len(kinds)
    cells = draw(arrays.arrays(np.int8, (number, CELLS), fill=st.integers(-128, 127)))
    for row, kind in enumerate(kinds):
        if kind != "plane":
            cells[row] = UNKNOWN if kind == "empty" else cells[row, 0]
    keys = draw(
        arrays.arrays(
            np.int32, (number, 3), elements=st.integers(1 - MAX_KEY, MAX_KEY - 1), unique=True
        )
    )
    ages = draw(arrays.arrays(np.uint32, number))
    counts = None
    if draw(st.booleans()):
        counts = draw(arrays.arrays(np.uint8, (number, CELLS), fill=st.integers(0, 16)))
        counts[(cells == UNKNOWN).all(axis=1)] = 0
    return BlockSet(keys, ages, cells, counts)


@given(some_blocks())
@settings(max_examples=60, deadline=None)
def test_decoded_blocks_are_those_that_were_encoded(blocks: BlockSet) -> None:
    decoded = decode_blocks(encode_blocks(blocks), counts=blocks.counts is not None)
    assert (decoded.keys == blocks.keys).all()
    assert (decoded.ages_ms == blocks.ages_ms).all()
    assert (decoded.cells == blocks.cells).all()
    if blocks.counts is not None:
        assert decoded.counts is not None
        assert (decoded.counts == blocks.counts).all()


def raw(*parts: bytes) -> bytes:
    return zstandard.ZstdCompressor().compress(b"".join(parts))


ONE = b"\x01\0\0\0"
ROW = bytes(16)


@pytest.mark.parametrize(
    ("body", "why"),
    [
        (b"", "unpacked"),
        (b"no frame", "unpacked"),
        (raw(b"\x01\0\0"), "cut short"),
        (raw(ONE, ROW), "cut short"),
        (raw(ONE, ROW, b"\x02", bytes(511)), "cut short"),
        (raw(ONE, ROW, b"\x01\x05\x05"), "follow"),
        (raw(ONE, ROW, b"\x03"), "unknown kind"),
        (raw(ONE, MAX_KEY.to_bytes(4, "little"), bytes(12), b"\x00"), "reach"),
        (raw(ONE, b"\0\0\0\x80", bytes(12), b"\x00"), "reach"),
        (raw((MAX_BLOCKS + 1).to_bytes(4, "little"), bytes(17 * (MAX_BLOCKS + 1))), "allowed"),
        (raw(bytes(MAX_BODY + 1)), "allowed"),
        (raw(ONE, ROW, b"\x00")[:-1], "unpacked"),
        (raw(ONE, ROW, b"\x00") + b"more", "unpacked"),
    ],
)  # fmt: skip
def test_what_is_no_body_is_refused(body: bytes, why: str) -> None:
    with pytest.raises(StreamError, match=why) as caught:
        decode_blocks(body, counts=False)
    assert caught.value.reason == "bad_blocks"


def test_frame_that_lies_about_its_size_is_not_unpacked() -> None:
    compressor = zstandard.ZstdCompressor(write_content_size=False)
    bomb = compressor.compress(bytes(1 << 28))
    assert len(bomb) < 1 << 16
    with pytest.raises(StreamError, match="bytes"):
        decode_blocks(bomb, counts=False)


def test_threads_encode_and_decode_at_once() -> None:
    def is_unchanged(seed: int) -> bool:
        random = np.random.default_rng(seed)
        keys = random.integers(-99, 99, (400, 3), dtype=np.int32)
        cells = random.integers(-128, 127, (400, CELLS), dtype=np.int8)
        blocks = BlockSet(keys, np.zeros(400, np.uint32), cells, None)
        decoded = decode_blocks(encode_blocks(blocks), counts=False)
        return bool((decoded.cells == cells).all() and (decoded.keys == keys).all())

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(is_unchanged, range(64)))


def test_largest_body_is_taken() -> None:
    cells = np.tile(np.arange(CELLS).astype(np.int8), (MAX_BLOCKS, 1))
    keys = np.stack([np.arange(MAX_BLOCKS)] * 3, axis=1).astype(np.int32)
    blocks = BlockSet(keys, np.zeros(MAX_BLOCKS, np.uint32), cells, np.ones_like(cells, np.uint8))
    decoded = decode_blocks(encode_blocks(blocks), counts=True)
    assert (decoded.cells == cells).all()
