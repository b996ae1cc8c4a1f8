"""Gaps: what a damaged recording shows of each link, and what the parser makes of it."""

from __future__ import annotations

import io
import re
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from oculus_driver import Ping, StreamParser, bearing_table_cdeg, decode_ping, encode_ping
from oculus_driver.recording import (
    OCULUS,
    ODOMETRY_NATIVE,
    RecordingWriter,
    mcap_records,
    open_recording,
)
from oculus_driver.recording.chunk import Chunk, Progress
from oculus_driver.recording.mcap_reader import read_mcap
from oculus_driver.recording.mcap_records import Opcode
from oculus_driver.recording.writer import CHUNK_SIZE, METADATA_NAME

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from tests.oculus_driver.recording.conftest import Written

PIECE = 10_000
PINGS = 60
ROWS = 300


def read(data: bytes) -> tuple[list[Chunk], Progress]:
    progress = Progress()
    return list(read_mcap(io.BytesIO(data), len(data), progress)), progress


def gaps(chunks: list[Chunk]) -> list[tuple[str, bytes]]:
    return [(chunk.link, chunk.data) for chunk in chunks if chunk.gap_before]


@pytest.fixture(scope="session")
def survey(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return a recording of pings in pieces, several chunks long."""
    path = tmp_path_factory.mktemp("survey") / "survey.mcap"
    stream = b"".join(ping_of(number) for number in range(PINGS))
    with RecordingWriter(path) as writer:
        link = writer.add_link("sonar", OCULUS)
        for start in range(0, len(stream), PIECE):
            writer.write(link, stream[start : start + PIECE], 10**18 + start)
    return path.read_bytes()


def ping_of(number: int) -> bytes:
    image = bytes((number + row) % 251 for row in range(ROWS)) * 256
    return encode_ping(
        ping_id=number,
        mode=1,
        frequency_hz=750e3,
        range_m=10.0,
        gain_percent=50.0,
        speed_of_sound_mps=1500.0,
        salinity_ppt=35.0,
        start_time=1.0,
        range_resolution_m=0.02,
        bearings_cdeg=bearing_table_cdeg(256, 1.0),
        image=np.frombuffer(image, np.uint8).reshape(ROWS, 256),
        source_id=7892,
    )


def pings(chunks: Sequence[Chunk]) -> tuple[list[int], StreamParser]:
    parser = StreamParser(confirm=True)
    messages = []
    for chunk in chunks:
        messages += parser.feed(chunk.data, chunk.arrival_ns, gap_before=chunk.gap_before)
    messages += parser.finish()
    right = []
    for ping in map(decode_ping, messages):
        assert isinstance(ping, Ping)
        image = bytes((ping.ping_id + row) % 251 for row in range(ROWS)) * 256
        if ping.image.tobytes() == image and not ping.warnings:
            right.append(ping.ping_id)
    assert len(right) == len(messages) or any(chunk.damaged for chunk in chunks)
    return right, parser


def test_a_whole_recording_has_no_gap(survey: bytes, written: Written) -> None:
    for data in (survey, written.data):
        chunks, progress = read(data)
        assert gaps(chunks) == []
        assert progress.faults == 0
    assert pings(read(survey)[0])[0] == list(range(PINGS))


def test_a_chunk_that_is_missing_as_a_whole_is_reported(survey: bytes) -> None:
    data = without_chunk(survey, 20)
    chunks, progress = read(data)
    assert len(gaps(chunks)) == 1
    assert progress.faults == 1
    assert progress.damage is not None
    assert "pieces of link 'sonar' missing" in progress.damage
    assert not progress.truncated
    ids, parser = pings(chunks)
    lost = PINGS - len(ids)
    assert lost <= CHUNK_SIZE // len(ping_of(0)) + 2
    steps = [after - before for before, after in pairwise(ids)]
    assert sorted(steps)[-2:] == [1, lost + 1]
    assert parser.counters.rejects == {"truncated": 1}
    assert parser.counters.resyncs == 1


def without_chunk(data: bytes, index: int) -> bytes:
    """Return a recording without one of its chunks and its message indexes."""
    position, chunks = 8, 0
    while True:
        opcode, length = data[position], int.from_bytes(data[position + 1 : position + 9], "little")
        end = position + 9 + length
        if opcode == Opcode.CHUNK:
            if chunks == index:
                while data[end] == Opcode.MESSAGE_INDEX:
                    end += 9 + int.from_bytes(data[end + 1 : end + 9], "little")
                return data[:position] + data[end:]
            chunks += 1
        position = end


@pytest.mark.parametrize("size", [1, 703, 4900, 9999, 10_000, 10_031, 50_000, 76_000])
@pytest.mark.parametrize("place", [100_000, 150_000, 1_200_000, 2_345_678])
def test_bytes_cut_out_cost_the_pings_that_they_touch(survey: bytes, place: int, size: int) -> None:
    chunks, progress = read(survey[:place] + survey[place + size :])
    ids, _ = pings(chunks)
    touched = (size + PIECE) // len(ping_of(0)) + 2
    assert PINGS - len(ids) <= touched
    assert ids == sorted(set(ids))
    assert progress.faults
    assert not progress.truncated


def test_damage_in_one_link_is_no_gap_in_another(written: Written) -> None:
    data = bytearray(written.data)
    assert written.rows[21][0] == "dvl"
    data[written.start(21) + 2] ^= 0x81
    chunks, progress = read(bytes(data))
    assert progress.faults
    assert "sonar" not in [link for link, _ in gaps(chunks)]
    assert ("dvl", written.rows[23][3]) in gaps(chunks)


def test_a_missing_piece_is_a_gap_in_its_link_alone(written: Written) -> None:
    start, end = written.ends[49], written.ends[50]
    assert written.rows[50][0] == "sonar"
    chunks, _ = read(written.data[:start] + written.data[end:])
    assert gaps(chunks) == [("sonar", written.rows[52][3])]


def test_what_was_broken_off_is_followed_by_a_gap(written: Written) -> None:
    index = next(n for n, row in enumerate(written.rows) if n > 10 and len(row[3]) > 50_000)
    end = written.ends[index]
    chunks, _ = read(written.data[: end - 10_000] + written.data[end:])
    assert [chunk.data for chunk in chunks][index] == written.rows[index][3][:-10_000]
    assert gaps(chunks) == [("sonar", written.rows[index + 2][3])]


def test_a_changed_number_costs_at_most_one_false_gap(written: Written) -> None:
    for value in (0, 0xFF):
        data = bytearray(written.data)
        assert written.rows[20][0] == "sonar"
        data[written.start(20) + 11] = value  # of the sequence number
        assert len(gaps(read(bytes(data))[0])) <= 1


@pytest.mark.parametrize("compression", list(CompressionType))
def test_in_files_of_other_tools_damage_is_a_gap_in_all_links(
    compression: CompressionType,
) -> None:
    file = io.BytesIO()
    writer = Writer(file, compression=compression, chunk_size=100_000)
    writer.start()
    schema = writer.register_schema("bytes", "", b"")
    links = [
        writer.register_channel(name, encoding, schema)
        for name, encoding in (("sonar", OCULUS), ("dvl", ODOMETRY_NATIVE))
    ]
    rng = np.random.default_rng(2)
    for index in range(60):
        for link in links:
            writer.add_message(link, 10**18 + index, rng.bytes(9000), 0)
    writer.finish()  # type: ignore[no-untyped-call]
    data = file.getvalue()
    assert gaps(read(data)[0]) == []
    middle = len(data) // 2
    chunks, progress = read(data[:middle] + bytes(3000) + data[middle + 3500 :])
    assert progress.faults
    reported_links = [link for link, _ in gaps(chunks)]
    assert set(reported_links) == {"sonar", "dvl"}
    assert len(reported_links) <= 2 * (progress.faults + 1)


def test_a_raw_stream_with_missing_bytes_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "stream.raw"
    stream = ping_of(0) + ping_of(1)[:5000] + ping_of(1)[9000:] + ping_of(2)
    path.write_bytes(stream)
    with open_recording(path) as recording:
        ids, _ = pings(list(recording))
        assert ids == [0, 2]
        size = len(ping_of(1)) - 4000
        assert (recording.damage or "").startswith(f"{size} bytes")


def test_a_gap_that_the_recorder_knows_of_is_a_link_loss_and_no_damage(tmp_path: Path) -> None:
    path = tmp_path / "gap.mcap"
    with RecordingWriter(path) as writer:
        sonar, dvl = writer.add_link("sonar", OCULUS), writer.add_link("dvl", ODOMETRY_NATIVE)
        for number in range(6):
            writer.write(sonar, b"%d" % number, number, gap_before=number in (0, 2, 5))
            writer.write(dvl, b"x", number)
        assert writer.messages == 12
    with open_recording(path) as recording:
        assert gaps(list(recording)) == [("sonar", b"2"), ("sonar", b"5")]
        assert (recording.faults, recording.damage, recording.link_losses) == (0, None, 2)


def test_a_lost_piece_behind_a_link_loss_is_damage(tmp_path: Path) -> None:
    path = tmp_path / "gap.mcap"
    with RecordingWriter(path) as writer:
        sonar = writer.add_link("sonar", OCULUS)
        for number in range(6):
            writer.sync()
            writer.write(sonar, b"%d" % number, number, gap_before=number in (2, 3))
    chunks, progress = read(without_chunk(path.read_bytes(), 3))
    assert gaps(chunks) == [("sonar", b"2"), ("sonar", b"4")]
    assert (progress.link_losses, progress.faults) == (2, 1)
    assert re.search(r"\b1 piece.*'sonar'", progress.damage or "")


def test_recordings_of_format_1_skip_one_number_at_a_link_loss() -> None:
    note = mcap_records.metadata(METADATA_NAME, {"format_version": "1"})
    link = mcap_records.channel(1, "sonar", OCULUS)
    numbers = (0, 1, 3, 4, 7)
    rows = [mcap_records.message_head(1, number, 10**18, 1) + b"x" for number in numbers]
    chunks, progress = read(b"".join((mcap_records.MAGIC, note, link, *rows)))
    assert [chunk.gap_before for chunk in chunks] == [False, False, True, False, True]
    assert progress.link_losses == 1
    assert "2 pieces of link 'sonar' missing" in (progress.damage or "")
