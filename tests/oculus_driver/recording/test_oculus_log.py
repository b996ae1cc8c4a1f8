"""Oculus Viewer logs, as the vendor and ENSTA write them, whole and hurt."""

from __future__ import annotations

import re
import struct
import zlib
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from oculus_driver.encode import encode_dummy
from oculus_driver.errors import RecordingError
from oculus_driver.recording import OCULUS_LOG, Chunk, describe, open_recording
from tests.oculus_driver.recording.foreign_files import LOG_START_S, log_header, log_item

if TYPE_CHECKING:
    from pathlib import Path

    from oculus_driver.recording import Recording, RecordingInfo
    from tests.oculus_driver.conftest import MakePing

START_NS = 1_700_000_000_250_000_000


def read(path: Path, data: bytes) -> tuple[list[Chunk], Recording]:
    path.write_bytes(data)
    with open_recording(path) as recording:
        assert recording.format == OCULUS_LOG
        return list(recording), recording


def described(path: Path, data: bytes) -> RecordingInfo:
    path.write_bytes(data)
    with open_recording(path) as recording:
        return describe(recording)


def test_the_messages_of_a_vendor_log_come_with_their_stamps(
    tmp_path: Path, capture: bytes
) -> None:
    pings = [capture[at : at + 182016] for at in (0, 182016, 364032)]
    data = log_header() + log_item(b"settings", kind=1)
    for index, ping in enumerate(pings):
        data += log_item(ping, unix_s=LOG_START_S + index) + log_item(b"x" * 99, kind=500)
    chunks, recording = read(tmp_path / "log", data)
    assert [chunk.data for chunk in chunks] == pings
    assert [chunk.arrival_ns for chunk in chunks] == [START_NS + i * 10**9 for i in range(3)]
    assert (recording.start_ns, recording.end_ns) == (START_NS, START_NS + 2 * 10**9)
    assert (recording.damage, recording.bytes_read) == (None, len(data))
    assert described(tmp_path / "log", data).pings == 3


def test_an_ensta_log_has_exact_stamps_behind_its_messages(
    tmp_path: Path, make_ping: MakePing
) -> None:
    stamp = log_item(struct.pack("<QQ", 1_700_000_001, 123_456_789), kind=1010)
    data = log_header() + log_item(make_ping()) + stamp + log_item(encode_dummy())
    chunks, recording = read(tmp_path / "log", data)
    assert [chunk.arrival_ns for chunk in chunks] == [1_700_000_001_123_456_789, START_NS]
    assert chunks[1].data == encode_dummy()
    assert recording.damage is None


def test_compressed_messages_are_unpacked(tmp_path: Path, make_ping: MakePing) -> None:
    ping = make_ping()
    packed = struct.pack(">I", len(ping)) + zlib.compress(ping)
    data = log_header() + log_item(packed, compression=1, original=len(ping)) + log_item(ping)
    chunks, recording = read(tmp_path / "log", data)
    assert [chunk.data for chunk in chunks] == [ping, ping]
    assert recording.damage is None


def test_what_cannot_be_unpacked_is_a_gap(tmp_path: Path, make_ping: MakePing) -> None:
    bomb = struct.pack(">I", 5) + zlib.compress(bytes(17 << 20), 1)  # larger than any message
    for bad in (
        log_item(bomb, compression=1),
        log_item(b"junk", compression=1),
        log_item(b"", compression=7),
    ):
        data = log_header() + bad + log_item(make_ping())
        chunks, recording = read(tmp_path / "log", data)
        assert [(chunk.data, chunk.gap_before) for chunk in chunks] == [(make_ping(), True)]
        assert recording.faults == 1


def test_a_broken_conversion_is_read_by_the_messages_own_sizes(
    tmp_path: Path, make_ping: MakePing
) -> None:
    pings = [make_ping(ping_id=index) for index in range(3)]
    data = log_header(magic=2037)
    for ping in pings:
        data += log_item(ping, magic=2037, size=0, original=0)
    chunks, recording = read(tmp_path / "log", data)
    assert [chunk.data for chunk in chunks] == pings
    assert recording.damage is None
    info = described(tmp_path / "log", data[:900] + b"??" + data[900:])
    assert [ping.id for ping in info.ping_list][-1] == 2


def test_messages_of_unknown_ids_are_kept_in_any_log(tmp_path: Path, make_ping: MakePing) -> None:
    odd = struct.pack("<HHHHHIH", 0x4F53, 7892, 0, 0x91, 0, 20, 0) + bytes(20)  # quirk 32
    for magic, item_magic in ((0x11223344, 0xAABBCCDD), (2037, 2037)):
        data = log_header(magic=magic)
        for message in (odd, make_ping(), odd):
            size = 0 if magic == 2037 else len(message)
            data += log_item(message, magic=item_magic, size=size)
        chunks, recording = read(tmp_path / "log", data)
        assert [chunk.data for chunk in chunks] == [odd, make_ping(), odd]
        assert recording.damage is None
        info = described(tmp_path / "log", data)
        assert (info.messages_by_id, info.rejects) == ({0x23: 1, 0x91: 2}, {"unknown_id": 2})


def test_a_broken_conversion_swallows_nothing(tmp_path: Path, make_ping: MakePing) -> None:
    head = struct.pack("<HHHHHIH", 0x4F53, 7892, 0, 0x91, 0, 500, 0)  # claims 500 bytes
    lie = log_item(head, magic=2037, size=0)
    data = log_header(magic=2037) + lie * 3 + log_item(make_ping(), magic=2037, size=0)
    chunks, recording = read(tmp_path / "log", data)
    assert [(chunk.data, chunk.gap_before) for chunk in chunks] == [(make_ping(), True)]
    assert recording.faults == 3


def test_an_encrypted_log_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_bytes(log_header(encryption=1) + log_item(bytes(100)))
    with pytest.raises(RecordingError, match="is encrypted"):
        open_recording(path)


def test_a_damaged_item_costs_itself_only(tmp_path: Path, make_ping: MakePing) -> None:
    items = [log_item(make_ping(ping_id=index)) for index in range(4)]
    for at in (0, 5, 33):  # magic, size of the head, size of the payload
        hurt = bytearray(items[1])
        hurt[at] ^= 0x55
        data = log_header() + items[0] + bytes(hurt) + items[2] + items[3]
        info = described(tmp_path / "log", data)
        assert [ping.id for ping in info.ping_list if ping.id != 1] == [0, 2, 3]
        assert info.faults >= 1


@pytest.mark.parametrize("size", range(980, 1030, 3))
def test_an_item_is_found_wherever_it_lies(tmp_path: Path, size: int) -> None:
    data = log_header() + bytes(size) + log_item(encode_dummy())
    chunks, recording = read(tmp_path / "log", data)
    assert [(chunk.data, chunk.gap_before) for chunk in chunks] == [(encode_dummy(), True)]
    assert recording.faults == 1


def test_a_size_beyond_the_file_hides_nothing(tmp_path: Path, make_ping: MakePing) -> None:
    lie = log_item(b"abc", size=1 << 30)
    data = log_header() + lie + log_item(make_ping()) + log_item(b"", kind=1, size=1 << 30)
    data += log_item(make_ping(ping_id=8))
    info = described(tmp_path / "log", data)
    assert [ping.id for ping in info.ping_list] == [7, 8]
    assert not info.truncated
    assert info.faults == 2


def test_a_message_item_beyond_the_file_hides_nothing(tmp_path: Path, make_ping: MakePing) -> None:
    data = log_header() + log_item(b"abc", size=1 << 20) + log_item(make_ping())
    chunks, recording = read(tmp_path / "log", data)
    assert [(chunk.data, chunk.gap_before) for chunk in chunks] == [(make_ping(), True)]
    assert (recording.faults, recording.truncated) == (1, False)


def test_an_item_larger_than_any_message_is_a_gap(tmp_path: Path, make_ping: MakePing) -> None:
    data = log_header() + log_item(bytes(17 << 20)) + log_item(make_ping())
    chunks, recording = read(tmp_path / "log", data)
    assert [(chunk.data, chunk.gap_before) for chunk in chunks] == [(make_ping(), True)]
    assert re.search(r"\bbyte 88\b", recording.damage or "")


@pytest.mark.parametrize("cut", [4, 30, 48, 60, 88, 100, 1000])
def test_a_cut_log_gives_what_is_there(tmp_path: Path, make_ping: MakePing, cut: int) -> None:
    data = log_header() + log_item(make_ping())
    chunks, recording = read(tmp_path / "log", data[:cut])
    assert b"".join(chunk.data for chunk in chunks) == data[88:cut]
    assert recording.truncated == (cut != 48)


@given(data=st.binary(max_size=400), seed=st.integers(0, 2**32 - 1))
def test_no_bytes_make_reading_fail(
    tmp_path_factory: pytest.TempPathFactory, data: bytes, seed: int
) -> None:
    path = tmp_path_factory.getbasetemp() / "fuzzed_log"
    item = bytearray(log_item(encode_dummy()))
    item[seed % len(item)] ^= 1 << (seed >> 8) % 8
    for magic in (0x11223344, 2037):
        chunks, recording = read(path, log_header(magic=magic) + data + bytes(item) + data)
        assert sum(len(chunk.data) for chunk in chunks) <= recording.size_bytes * 20
        assert recording.bytes_read == recording.size_bytes
