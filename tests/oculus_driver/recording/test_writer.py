"""What the writer leaves on disk, closed, killed, or out of space."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from typing import IO, TYPE_CHECKING

import numpy as np
import pytest
from mcap.exceptions import EndOfFile
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader

from oculus_driver.errors import RecordingError
from oculus_driver.recording import OCULUS, RecordingWriter, open_recording
from oculus_driver.recording.mcap_records import MAGIC

if TYPE_CHECKING:
    from pathlib import Path

    from tests.oculus_driver.recording.conftest import Written


def test_other_readers_find_index_and_messages(written: Written) -> None:
    with written.path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == len(written.rows)
        assert summary.statistics.chunk_count == len(summary.chunk_indexes) > 1
        assert summary.statistics.channel_message_counts == {1: 60, 2: 60}
        assert [index.name for index in summary.metadata_indexes] == ["oculus_driver.recording"]
        found = [
            (channel.topic, channel.message_encoding, message.log_time, message.data)
            for _, channel, message in reader.iter_messages(log_time_order=False)
        ]
        (note,) = reader.iter_metadata()
    assert found == written.rows
    assert note.metadata.keys() == {"format_version", "monotonic_to_unix_ns", "crc32"}


def test_other_readers_can_seek_in_time(written: Written) -> None:
    stamps = [row[2] for row in written.rows]
    with written.path.open("rb") as file:
        reader = make_reader(file)
        found = [
            message.log_time
            for _, _, message in reader.iter_messages(
                topics=["dvl"], starting_at=stamps[40], ending_before=stamps[80]
            )
        ]
    assert found == [row[2] for row in written.rows[40:80] if row[0] == "dvl"]


def test_other_readers_can_read_from_front_to_back(written: Written) -> None:
    with written.path.open("rb") as file:
        reader = NonSeekingReader(file, validate_crcs=True)
        assert sum(1 for _ in reader.iter_messages()) == len(written.rows)


def test_chunks_are_small(written: Written) -> None:
    with written.path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert max(index.uncompressed_size for index in summary.chunk_indexes) <= 1 << 20


def test_a_write_larger_than_a_chunk_is_kept_whole(tmp_path: Path) -> None:
    path = tmp_path / "big"
    data = bytes(3 << 20)
    with RecordingWriter(path) as writer:
        writer.write(writer.add_link("sonar", OCULUS), data, 1)
    with open_recording(path) as recording:
        assert [chunk.data for chunk in recording] == [data]
        assert recording.damage is None


def test_links_can_be_added_while_recording(tmp_path: Path) -> None:
    path = tmp_path / "late"
    with RecordingWriter(path) as writer:
        first = writer.add_link("one", OCULUS)
        writer.write(first, b"a", 1)
        second = writer.add_link("two", "nmea")
        writer.write(second, memoryview(b"b"), 2)
        writer.write(first, bytearray(b"c"), 3)
        assert writer.messages == 3
    with open_recording(path) as recording:
        assert [(c.link, c.encoding, c.data) for c in recording] == [
            ("one", "oculus", b"a"),
            ("two", "nmea", b"b"),
            ("one", "oculus", b"c"),
        ]
    with path.open("rb") as file:
        assert len(list(make_reader(file).iter_messages())) == 3


def test_stamps_become_unix_time(tmp_path: Path) -> None:
    path = tmp_path / "clock"
    with RecordingWriter(path, monotonic_to_unix_ns=10**18, metadata={"site": "dock"}) as writer:
        link = writer.add_link("sonar", OCULUS)
        writer.write(link, b"a", 5)
        writer.write(link, b"b", None)
    with open_recording(path) as recording:
        assert [chunk.arrival_ns for chunk in recording] == [10**18 + 5, None]
        assert recording.metadata == {
            "site": "dock",
            "format_version": "3",
            "monotonic_to_unix_ns": str(10**18),
        }


def test_a_recording_is_not_replaced_without_a_request(tmp_path: Path) -> None:
    path = tmp_path / "capture"
    path.write_bytes(b"precious")
    with pytest.raises(RecordingError, match="file exists; choose another name"):
        RecordingWriter(path)
    assert path.read_bytes() == b"precious"
    RecordingWriter(path, overwrite=True).close()
    assert path.read_bytes().startswith(b"\x89MCAP")


def test_a_place_that_cannot_be_written_is_reported(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="check folder and permissions"):
        RecordingWriter(tmp_path / "no" / "folder")


def test_what_makes_no_sense_is_refused(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "capture") as writer:
        link = writer.add_link("sonar", OCULUS)
        for number, stamp_ns in ((0, 1), (link + 1, 1), (link, -1), (link, 1 << 64)):
            with pytest.raises(RecordingError):
                writer.write(number, b"a", stamp_ns)
        writer.write(link, b"a", 1)
    writer.close()
    with open_recording(writer.path) as recording:
        assert [chunk.data for chunk in recording] == [b"a"]


def test_a_full_disk_loses_only_what_did_not_fit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "full"
    write = os.pwrite
    with RecordingWriter(path) as writer:
        link = writer.add_link("sonar", OCULUS)
        writer.write(link, b"before", 1)
        with monkeypatch.context() as patch:

            def half(file: int, data: bytes, offset: int) -> int:
                if len(data) > 20:
                    return write(file, data[:20], offset)
                raise OSError(28, "No space left on device")

            patch.setattr(os, "pwrite", half)
            with pytest.raises(RecordingError, match="No space left on device"):
                writer.write(link, b"x" * 50, 2)
        writer.write(link, b"after", 3)
    with open_recording(path) as recording:
        assert [chunk.data for chunk in recording] == [b"before", b"after"]
        assert recording.damage is None


def test_a_disk_without_any_room_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(file: int, data: bytes, offset: int) -> int:  # noqa: ARG001
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "pwrite", full)
        with pytest.raises(RecordingError, match="No space left on device"):
            RecordingWriter(tmp_path / "full")
    assert list(tmp_path.iterdir()) == []


def test_an_empty_recording_is_a_recording(tmp_path: Path) -> None:
    path = tmp_path / "empty"
    with RecordingWriter(path) as writer:
        writer.add_link("sonar", OCULUS)
    with open_recording(path) as recording:
        assert list(recording) == []
        assert (recording.has_time, recording.truncated, recording.damage) == (False, False, None)
    with path.open("rb") as file:
        assert list(make_reader(file).iter_messages()) == []


KILLED = """
import os, signal, sys
from oculus_driver.recording import RecordingWriter
writer = RecordingWriter(sys.argv[1])
link = writer.add_link("sonar", "oculus")
for index in range(100):
    writer.write(link, bytes([index]) * 30_000, index + 1)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_killed_program_leaves_everything_that_it_wrote(tmp_path: Path) -> None:
    path = tmp_path / "killed"
    done = subprocess.run([sys.executable, "-c", KILLED, str(path)], check=False, timeout=60)  # noqa: S603 - our own words
    assert done.returncode == -signal.SIGKILL
    with open_recording(path) as recording:
        chunks = list(recording)
        assert [chunk.data for chunk in chunks] == [bytes([n]) * 30_000 for n in range(100)]
        assert recording.truncated
        assert recording.damage == "the recording was not closed"
        assert (recording.start_ns, recording.end_ns) == (1, 100)
    with path.open("rb") as file:
        assert count_messages(file) == 100


def count_messages(file: IO[bytes]) -> int:
    """Count what another reader finds in a file without an end."""
    count = 0
    with contextlib.suppress(EndOfFile):
        for record in StreamReader(file).records:
            count += isinstance(record, Message)
    return count


def unclosed(path: Path, *, killed: bool = False) -> tuple[bytes, list[bytes]]:
    """An unclosed recording of several chunks, and its pieces.

    Args:
        path: of the file.
        killed: between the two steps of the last piece.
    """
    rng = np.random.default_rng(3)
    pieces = [rng.bytes(int(size)) for size in rng.integers(20, 60_000, 30)]
    writer = RecordingWriter(path)
    link = writer.add_link("sonar", OCULUS)
    for number, piece in enumerate(pieces[:-1]):
        writer.write(link, piece, number)
    with pytest.MonkeyPatch.context() as patch, contextlib.suppress(KeyboardInterrupt):
        if killed:
            patch.setattr(writer, "_patch", interrupt)
        writer.write(link, pieces[-1], len(pieces))
    return path.read_bytes(), pieces


def interrupt(*_: object) -> None:
    raise KeyboardInterrupt


def undamaged(path: Path, data: bytes) -> tuple[list[bytes], bool]:
    """The undamaged pieces of a file, and whether a problem is reported."""
    path.write_bytes(data)
    with open_recording(path) as recording:
        pieces = [chunk.data for chunk in recording if not chunk.damaged]
        return pieces, recording.damage != "the recording was not closed"


@pytest.mark.parametrize("killed", [False, True])
@pytest.mark.slow
def test_each_byte_of_an_unclosed_recording_has_a_checksum(tmp_path: Path, *, killed: bool) -> None:
    data, pieces = unclosed(tmp_path / "open.mcap", killed=killed)
    assert undamaged(tmp_path / "copy.mcap", data) == (pieces, False)
    random = np.random.default_rng(4)
    places = [*random.integers(len(MAGIC), len(data), 150), *range(len(data) - 40, len(data))]
    for place in map(int, places):
        changed = bytearray(data)
        changed[place] ^= 1 << int(random.integers(8))
        found, reported = undamaged(tmp_path / "copy.mcap", bytes(changed))
        assert set(found) <= set(pieces), place
        assert found == pieces or reported, place


def test_what_a_power_cut_left_without_checksum_is_damaged(tmp_path: Path) -> None:
    data, pieces = unclosed(tmp_path / "open.mcap")
    for size in (len(data) - 13, len(data) - 14, len(data) - 5000, len(data) - 200_000):
        found, _ = undamaged(tmp_path / "copy.mcap", data[:size])
        assert found == pieces[: len(found)]
        assert len(found) >= 20
    torn = bytearray(data)
    torn[-8192:-4096] = bytes(4096)
    found, reported = undamaged(tmp_path / "copy.mcap", bytes(torn))
    assert found == pieces[: len(found)]
    assert reported
