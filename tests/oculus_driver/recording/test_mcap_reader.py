"""Whole, cut and damaged MCAP files, ours and those of other tools."""

from __future__ import annotations

import io
import struct
import time
import tracemalloc
from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType, Writer

from oculus_driver.recording import (
    OCULUS,
    ODOMETRY_NATIVE,
    Chunk,
    RecordingWriter,
    mcap_records,
    open_recording,
)
from oculus_driver.recording.chunk import Progress
from oculus_driver.recording.mcap_reader import read_mcap
from oculus_driver.recording.mcap_records import MAGIC, Opcode
from oculus_driver.recording.writer import CHUNK_SIZE

if TYPE_CHECKING:
    from pathlib import Path

    from tests.oculus_driver.recording.conftest import Row, Written

LINK = mcap_records.channel(1, "sonar", OCULUS)


def read(data: bytes) -> tuple[list[Row], Progress]:
    progress = Progress()
    chunks = read_mcap(io.BytesIO(data), len(data), progress)
    rows = [rowed(chunk) for chunk in chunks]
    assert progress.bytes_read == len(data)
    return rows, progress


def rowed(chunk: Chunk) -> Row:
    return chunk.link, chunk.encoding, chunk.arrival_ns, chunk.data


def check_cut(written: Written, size: int) -> None:
    """All rows that were complete, then at most the beginning of the next; never a raise."""
    rows, progress = read(written.data[:size])
    complete = sum(end <= size for end in written.ends)
    assert rows[:complete] == written.rows[:complete]
    rest = rows[complete:]
    assert len(rest) <= 1
    if rest:
        link, encoding, stamp_ns, part = rest[0]
        assert encoding == OCULUS
        assert written.rows[complete][:3] == (link, encoding, stamp_ns)
        assert written.rows[complete][3].startswith(part)
    assert progress.truncated == (size < len(written.data))
    assert (progress.damage is None) == (size == len(written.data))


def test_a_whole_file_is_read_completely(written: Written) -> None:
    rows, progress = read(written.data)
    assert rows == written.rows
    assert (progress.truncated, progress.damage, progress.faults) == (False, None, 0)
    assert progress.first_ns == written.rows[0][2]
    assert progress.last_ns == written.rows[-1][2]


def test_a_file_cut_in_its_first_bytes_yields_what_is_there(written: Written) -> None:
    for size in range(400):
        check_cut(written, size)


@pytest.mark.slow
def test_a_file_cut_in_its_last_bytes_yields_everything(written: Written) -> None:
    end = len(written.data)
    for size in (*range(end - 2000, end - 200, 13), *range(end - 200, end + 1)):
        check_cut(written, size)


@pytest.mark.slow
def test_a_file_cut_around_any_record_yields_all_before(written: Written) -> None:
    for end in written.ends:
        for size in (end - 32, end - 1, end, end + 1, end + 8, end + 9, end + 31, end + 32):
            check_cut(written, min(size, len(written.data)))


def test_a_file_cut_anywhere_yields_all_before(written: Written) -> None:
    for size in np.random.default_rng(3).integers(0, len(written.data), 150):
        check_cut(written, int(size))


@pytest.mark.parametrize("fixture", ["written", "odometry_written"])
def test_a_cut_costs_the_last_chunk_only(request: pytest.FixtureRequest, fixture: str) -> None:
    written: Written = request.getfixturevalue(fixture)
    for size in np.random.default_rng(3).integers(written.ends[1], written.ends[-1], 50):
        progress = Progress()
        data = written.data[: int(size)]
        good, _ = parts_of(list(read_mcap(io.BytesIO(data), len(data), progress)))
        whole = [row[3] for row, end in zip(written.rows, written.ends, strict=True) if end <= size]
        assert good == whole[: len(good)]
        assert sum(map(len, whole[len(good) :])) <= CHUNK_SIZE
        pings = [row for row in written.rows[len(good) : len(whole)] if row[1] == OCULUS]
        assert pings == []
        assert progress.truncated
        assert progress.damaged_parts == []


def test_the_bytes_of_a_cut_piece_of_a_stream_are_not_lost(written: Written) -> None:
    index = next(n for n, row in enumerate(written.rows) if len(row[3]) > 50_000)
    rows, _ = read(written.data[: written.ends[index] - 10_000])
    assert rows[index][3] == written.rows[index][3][:-10_000]


def test_zeros_behind_the_end_are_reported(written: Written) -> None:
    size = written.ends[70]
    rows, progress = read(written.data[:size] + bytes(100_000))
    assert rows == written.rows[:71]
    assert progress.truncated
    assert (progress.damage or "").startswith("damaged at byte ")


@pytest.mark.parametrize("shift", range(9))
def test_a_damaged_record_head_costs_that_record_only(written: Written, shift: int) -> None:
    data = bytearray(written.data)
    start = written.start(21)
    assert data[start] == Opcode.MESSAGE
    data[start + shift] ^= 0x81
    rows, progress = read(bytes(data))
    assert rows[:21] == written.rows[:21]
    assert rows[-98:] == written.rows[-98:]
    assert not progress.truncated
    assert progress.faults


@pytest.mark.parametrize("shift", range(49))
def test_a_damaged_chunk_head_costs_no_message(written: Written, shift: int) -> None:
    data = bytearray(written.data)
    start = written.data.index(b"\x06", written.ends[30])
    while struct.unpack_from("<Q", data, start + 1)[0] not in range(CHUNK_SIZE // 2, CHUNK_SIZE):
        start = written.data.index(b"\x06", start + 1)
    data[start + shift] ^= 0xFF
    rows, _ = read(bytes(data))
    assert rows == written.rows


def test_a_damaged_length_that_ends_on_a_likely_byte_is_seen() -> None:
    whole = [mcap_records.message_head(1, n, 10**18 + n, 1000) + b"\x05" * 1000 for n in range(5)]
    data = bytearray(b"".join((MAGIC, LINK, *whole)))
    data[len(MAGIC) + len(LINK) + 2] ^= 0x04  # 1 KiB more: ends inside the next message
    rows, progress = read(bytes(data))
    assert [row[3] for row in rows] == [b"\x05" * 1000] * 5
    assert progress.faults == 2  # the length, and that there is no end


def test_a_changed_byte_inside_is_reported(written: Written) -> None:
    data = bytearray(written.data)
    data[written.ends[0] - 1] ^= 1
    rows, progress = read(bytes(data))
    assert len(rows) == len(written.rows)
    assert progress.damage is not None
    assert "wrong checksum" in progress.damage
    assert not progress.truncated


def parts_of(rows: list[Chunk]) -> tuple[list[bytes], list[bytes]]:
    """Return the data of good chunks, and of damaged ones."""
    return [c.data for c in rows if not c.damaged], [c.data for c in rows if c.damaged]


def test_a_changed_byte_marks_the_messages_of_its_chunk(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with RecordingWriter(path) as writer:
        link = writer.add_link("dvl", ODOMETRY_NATIVE)
        for number in range(9):
            if number in {3, 6}:
                writer.sync()
            writer.write(link, bytes([number]) * 1000, 10**18 + number)
    data = bytearray(path.read_bytes())
    data[data.index(b"\4" * 1000) + 500] ^= 1
    path.write_bytes(data)
    with open_recording(path) as recording:
        good, damaged = parts_of(list(recording))
        assert good == [bytes([number]) * 1000 for number in (0, 1, 2, 6, 7, 8)]
        assert [part[0] for part in damaged] == [3, 4, 5]
        [part] = recording.damaged_parts
        assert (part.bytes, recording.damaged_bytes) == (3 * 1031, 3 * 1031)
        assert part.offset < data.index(b"\3" * 1000) < part.offset + 32
        assert recording.faults == 1


def test_each_message_of_a_damaged_chunk_is_marked_even_if_its_head_is_damaged(
    odometry_written: Written,
) -> None:
    written = odometry_written
    data = bytearray(written.data)
    start = written.start(81)
    assert data[start] == Opcode.MESSAGE
    data[start] ^= 0x81
    progress = Progress()
    chunks = list(read_mcap(io.BytesIO(data), len(data), progress))
    [(offset, size)] = progress.damaged_parts
    assert offset < start < offset + size
    good, damaged = parts_of(chunks)
    whole = [row[3] for row in written.rows]
    assert good == [
        one for k, one in enumerate(whole) if not offset < written.ends[k] <= offset + size
    ]
    assert len(damaged) >= len(whole) - len(good) - 2


@pytest.mark.parametrize("compression", list(CompressionType))
def test_a_changed_byte_marks_the_messages_of_a_chunk_of_another_tool(
    compression: CompressionType,
) -> None:
    data = bytearray(foreign(compression))
    position = len(MAGIC)
    while data[position] != Opcode.CHUNK:
        position += 9 + struct.unpack_from("<Q", data, position + 1)[0]
    data[position + 5000] ^= 1
    progress = Progress()
    chunks = list(read_mcap(io.BytesIO(data), len(data), progress))
    good, damaged = parts_of(chunks)
    assert progress.damaged_parts
    assert damaged or compression is not CompressionType.NONE
    whole = read(foreign(compression))[0]
    assert good == [row[3] for row in whole[-len(good) :]]
    assert 60 <= len(good) < len(whole)


def test_a_piece_missing_in_the_middle_costs_that_piece(written: Written) -> None:
    start, end = written.ends[50] - 20, written.ends[57] + 3
    rows, progress = read(written.data[:start] + written.data[end:])
    assert rows[:50] == written.rows[:50]
    assert rows[-61:] == written.rows[-61:]
    assert progress.faults
    assert not progress.truncated


def test_a_damaged_beginning_costs_nothing_behind_it(written: Written) -> None:
    rows, progress = read(b"\x89MCAP0\r\r" + written.data[8:])
    assert progress.damage == "the first bytes are damaged"
    assert len(rows) <= len(written.rows)


def foreign(
    compression: CompressionType, *, chunking: bool = True, chunk_size: int = 300_000
) -> bytes:
    file = io.BytesIO()
    writer = Writer(
        file,
        compression=compression,
        chunk_size=chunk_size,
        use_chunking=chunking,
        index_types=IndexType.ALL,
    )
    writer.start()
    schema = writer.register_schema("bytes", "", b"")
    sonar = writer.register_channel("sonar", OCULUS, schema)
    other = writer.register_channel("log", "json", schema)
    rng = np.random.default_rng(2)
    writer.add_attachment(1, 1, "a.txt", "text/plain", b"hello")
    for index in range(50):
        noise = rng.bytes(10_000) + bytes(20_000)
        writer.add_message(sonar, 10**18 + index, noise, 0)
        writer.add_message(other, 10**18 + index, b"{}", 0)
    writer.finish()  # type: ignore[no-untyped-call]
    return file.getvalue()


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunking", [False, True])
def test_files_of_other_tools_are_read(
    compression: CompressionType,
    chunking: bool,  # noqa: FBT001 - a parameter of the test
) -> None:
    rows, progress = read(foreign(compression, chunking=chunking))
    rng = np.random.default_rng(2)
    for index in range(50):
        noise = rng.bytes(10_000) + bytes(20_000)
        assert rows[2 * index] == ("sonar", OCULUS, 10**18 + index, noise)
        assert rows[2 * index + 1] == ("log", "json", 10**18 + index, b"{}")
    assert len(rows) == 100
    assert (progress.truncated, progress.damage) == (False, None)


@pytest.mark.parametrize("compression", list(CompressionType))
def test_a_cut_compressed_chunk_yields_what_can_be_inflated(compression: CompressionType) -> None:
    data = foreign(compression, chunk_size=10 << 20)
    whole, _ = read(data)
    rows, progress = read(data[: len(data) // 2])
    assert progress.truncated
    assert len(rows) >= 30
    assert rows[:-1] == whole[: len(rows) - 1]
    assert whole[len(rows) - 1][3].startswith(rows[-1][3])


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_a_damaged_compressed_chunk_leaves_the_others(compression: CompressionType) -> None:
    data = bytearray(foreign(compression))
    start = data.index(b"zstd" if compression is CompressionType.ZSTD else b"lz4")
    data[start + 30 : start + 5000] = bytes(4970)
    rows, progress = read(bytes(data))
    assert len(rows) >= 60
    assert rows[-1][2] == 10**18 + 49
    assert not progress.truncated
    assert progress.damage is not None
    assert "damaged chunk" in progress.damage


@pytest.mark.parametrize("compression", list(CompressionType))
def test_what_a_compressor_stored_is_not_read_twice(compression: CompressionType) -> None:
    file = io.BytesIO()
    writer = Writer(file, compression=compression, chunk_size=10 << 20)
    writer.start()
    link = writer.register_channel("sonar", OCULUS, 0)
    rng = np.random.default_rng(7)
    for index in range(40):
        writer.add_message(link, 10**18 + index, rng.bytes(10_000), 0)
    writer.finish()  # type: ignore[no-untyped-call]
    data = file.getvalue()
    whole, _ = read(data)
    assert len(whole) == 40
    rows, _ = read(data[: len(data) * 3 // 4])
    assert len(rows) >= 25
    assert rows[:-1] == whole[: len(rows) - 1]


def test_cut_files_of_other_tools_never_raise() -> None:
    for compression in CompressionType:
        data = foreign(compression)
        for size in np.random.default_rng(4).integers(0, len(data), 60):
            _, progress = read(data[: int(size)])
            assert progress.truncated


def bomb(compression: str, inflated: bytes) -> bytes:
    compress = import_module("lz4.frame" if compression == "lz4" else "zstandard").compress
    packed = compress(inflated)
    content = mcap_records.CHUNK_HEAD.pack(1, 2, 1 << 40, 0, len(compression))
    content += compression.encode() + struct.pack("<Q", len(packed)) + packed
    return mcap_records.record(Opcode.CHUNK, content)


LARGE = struct.pack("<BQHIQQ", 5, 60 << 20, 1, 0, 1, 1) + bytes(100)


@pytest.mark.parametrize(
    "hostile",
    [
        bomb("zstd", bytes(100 << 20)),
        bomb("lz4", bytes(100 << 20)),
        bomb("zstd", LARGE),
        bomb("lz4", LARGE),
        LARGE,
        struct.pack("<BQHIQQ", 5, 1 << 32, 1, 0, 1, 1),
        struct.pack("<BQ", 5, (1 << 64) - 1),
        struct.pack("<BQ", 6, (1 << 64) - 1) + bytes(40),
        struct.pack("<BQQQQIIQ", 6, 1 << 32, 0, 0, 1 << 32, 0, 0, (1 << 32) - 40),
        struct.pack("<BQQQQII", 6, 1 << 40, 0, 0, 0, 0, (1 << 32) - 1),
        struct.pack("<BQHHI", 4, 1 << 33, 2, 0, (1 << 32) - 1),
        struct.pack("<BQHHI", 4, 8, 2, 0, (1 << 32) - 1),
        struct.pack("<BQ", 0xF0, 1 << 50),
    ],
)
def test_no_claim_is_believed(hostile: bytes) -> None:
    tracemalloc.start()
    started = time.monotonic()
    _, progress = read(MAGIC + mcap_records.header("") + LINK + hostile + bytes(1000))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert progress.truncated
    assert progress.damage is not None
    assert peak < 20 << 20
    assert time.monotonic() - started < 10.0


def test_searching_behind_damage_is_linear() -> None:
    head = struct.pack("<BQHIQQ", 5, 100, 1, 0, 10**18, 0)
    false_heads = (b"\x05" + bytes(8)) * 100_000 + (b"\x06" + bytes(8)) * 100_000
    started = time.monotonic()
    _, progress = read(MAGIC + LINK + head + bytes(78) + b"\0" + false_heads)
    assert progress.truncated
    assert time.monotonic() - started < 10.0


@settings(max_examples=150, deadline=None)
@given(data=st.data())
@pytest.mark.slow
def test_any_damage_is_survived(written: Written, data: st.DataObject) -> None:
    damaged = bytearray(written.data[:400_000])
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(damaged) - 1))
        junk = data.draw(st.binary(min_size=1, max_size=40))
        if data.draw(st.booleans()):
            damaged[place : place + len(junk)] = junk
        else:
            damaged[place:place] = junk
    rows, progress = read(bytes(damaged))
    assert progress.truncated
    assert {row[0] for row in rows} <= {"sonar", "dvl"} or progress.faults


@settings(deadline=None)
@given(st.binary(max_size=500))
def test_any_bytes_behind_the_magic_are_survived(junk: bytes) -> None:
    read(MAGIC + junk)
    read(MAGIC + LINK + junk)
