"""Recordings from format to format: the same pings, and an honest word on what was left out."""

from __future__ import annotations

import errno
import sqlite3
from contextlib import closing
from typing import TYPE_CHECKING

import dpkt
import pytest

from oculus_driver.encode import encode_dummy, encode_status
from oculus_driver.errors import RecordingError
from oculus_driver.recording import (
    MCAP,
    OCULUS,
    OCULUS_LOG,
    OCULUS_RAW,
    OCULUS_STATUS,
    ODOMETRY_NATIVE,
    PCAP,
    WRITABLE,
    RecordingWriter,
    convert,
    describe,
    open_recording,
)
from oculus_driver.recording.convert import PcapSink
from tests.oculus_driver.recording.foreign_files import Wire, log_header, log_item, pcap
from tests.oculus_driver.recording.test_viewpoint_log import TABLES

if TYPE_CHECKING:
    from pathlib import Path

    from oculus_driver.recording import Chunk, PingInfo, RecordingInfo
    from tests.oculus_driver.conftest import MakePing

START_NS = 1_790_000_000_123_456_789


def described(path: Path) -> RecordingInfo:
    with open_recording(path) as recording:
        return describe(recording)


def pings(path: Path) -> list[tuple[int, int, int, float]]:
    def facts(ping: PingInfo) -> tuple[int, int, int, float]:
        return ping.id, ping.rows, ping.beams, ping.range_m

    return [facts(ping) for ping in described(path).ping_list]


@pytest.fixture
def dive(tmp_path: Path, make_ping: MakePing) -> Path:
    """Return a recording with two sonars, statuses, odometry, garbage and a gap."""
    path = tmp_path / "dive.mcap"
    with RecordingWriter(path) as writer:
        links = [writer.add_link(name, OCULUS) for name in ("left", "right")]
        status = writer.add_link("status", OCULUS_STATUS)
        odometry = writer.add_link("odometry", ODOMETRY_NATIVE)
        for index in range(8):
            stamp_ns = START_NS + index * 10**8
            for link in links:
                ping = make_ping(ping_id=index + 100 * link, rows=200)
                writer.write(link, ping[:1234], stamp_ns)
                writer.write(link, ping[1234:] + encode_dummy(), stamp_ns + 5)
            writer.write(status, encode_status(device_id=5), stamp_ns + 6)
            writer.write(odometry, b"\x80", stamp_ns + 7)
        writer.write(links[0], b"garbage" + make_ping(ping_id=150)[:900], stamp_ns + 8)
        writer.write(links[0], make_ping(ping_id=151), stamp_ns + 9, gap_before=True)
    return path


@pytest.mark.parametrize("kind", WRITABLE)
def test_a_real_capture_is_the_same_in_every_format(
    tmp_path: Path, capture_path: Path, capture: bytes, kind: str
) -> None:
    target, back = tmp_path / "target", tmp_path / "back"
    done = convert(capture_path, target, kind)
    assert (done.source_format, done.target_format) == (OCULUS_RAW, kind)
    assert (done.left_out, done.stamps_lost, done.damage) == ({}, 0, None)
    assert done.size_bytes == target.stat().st_size
    info = described(target)
    assert (info.format, info.damage, info.bytes_rejected) == (kind, None, 0)
    assert (info.start_ns, info.end_ns) == (None, None)
    assert pings(target) == pings(capture_path)
    convert(target, back, OCULUS_RAW)
    assert capture.count(b"\n") == 13634  # quirk 27: no reader stops at them
    assert back.read_bytes() == capture
    assert sorted(path.name for path in tmp_path.iterdir()) == ["back", "target"]


@pytest.mark.parametrize("kind", [MCAP, PCAP])
def test_formats_for_several_links_keep_sonars_stamps_statuses_and_gaps(
    tmp_path: Path, dive: Path, kind: str
) -> None:
    target = tmp_path / "target"
    done = convert(dive, target, kind)
    assert done.left_out == ({} if kind == MCAP else {"other_link": 8})
    before, after = described(dive), described(target)
    assert pings(target) == pings(dive)
    stamps = [ping.arrival_ns for ping in after.ping_list]
    assert stamps == [ping.arrival_ns for ping in before.ping_list]
    assert (after.statuses, after.messages) == (8, before.messages)
    assert after.rejects == before.rejects == {"bad_magic": 1}


@pytest.mark.parametrize("kind", [MCAP, OCULUS_RAW])
def test_data_that_fail_their_checksum_are_left_out_unless_asked_for(
    tmp_path: Path, make_ping: MakePing, kind: str
) -> None:
    source, target, all_of_it = (tmp_path / name for name in ("source", "target", "all"))
    with RecordingWriter(source) as writer:
        link = writer.add_link("sonar", OCULUS)
        for number in range(6):
            writer.write(link, make_ping(ping_id=number), 10**18 + number)
    data = bytearray(source.read_bytes())
    ping = make_ping(ping_id=2)
    data[data.index(ping) + len(ping) - 1] ^= 1
    source.write_bytes(data)
    done = convert(source, target, kind)
    assert done.left_out == {"checksum": len(ping)}
    assert [ping.id for ping in described(target).ping_list] == [0, 1, 3, 4, 5]
    assert convert(source, all_of_it, kind, allow_damaged=True).left_out == {}
    assert [ping.id for ping in described(all_of_it).ping_list] == list(range(6))


@pytest.mark.parametrize("kind", [OCULUS_LOG, OCULUS_RAW])
def test_formats_for_messages_keep_those_of_the_first_sonar(
    tmp_path: Path, dive: Path, kind: str
) -> None:
    target = tmp_path / "target"
    done = convert(dive, target, kind)
    assert set(done.left_out) == {"other_link", "no_message"}
    assert done.left_out["no_message"] == 907
    assert done.damage is None  # a gap is not damage
    first = [ping for ping in described(dive).ping_list if ping.link == "left"]
    info = described(target)
    assert [ping.id for ping in info.ping_list] == [ping.id for ping in first]
    assert (info.messages, info.bytes_rejected) == (17, 0)
    if kind == OCULUS_LOG:
        assert [ping.arrival_ns for ping in info.ping_list] == [ping.arrival_ns for ping in first]
        assert done.stamps_lost == 0
    else:
        assert done.stamps_lost == done.chunks


def test_files_of_other_programs_become_mcap(tmp_path: Path, capture: bytes) -> None:
    messages = [capture[at : at + 182016] for at in (0, 182016, 364032)]
    log = log_header() + b"".join(log_item(message) for message in messages)
    (tmp_path / "oculus-log").write_bytes(log)
    with closing(sqlite3.connect(tmp_path / "viewpoint-log")) as connection:
        connection.executescript(TABLES)
        rows = [(None, 5, 1, 1, len(message), message) for message in messages]
        connection.executemany("INSERT INTO data VALUES (?, ?, ?, ?, ?, ?)", rows)
        connection.commit()
    wire = Wire()
    wire.send(capture)
    (tmp_path / "pcap").write_bytes(pcap(wire.frames))
    for name in ("oculus-log", "viewpoint-log", "pcap"):
        assert convert(tmp_path / name, tmp_path / "out.mcap", overwrite=True).source_format == name
        info = described(tmp_path / "out.mcap")
        assert [ping.id for ping in info.ping_list] == [415323, 415324, 415325]
        assert info.start_ns is not None
        assert info.metadata["converted_from"] == name


def test_another_reader_finds_our_captures_sound(tmp_path: Path, dive: Path) -> None:
    convert(dive, tmp_path / "c.pcap", PCAP)
    streams: dict[bytes, bytes] = {}
    with (tmp_path / "c.pcap").open("rb") as file:
        reader = dpkt.pcap.Reader(file)
        assert reader.datalink() == 101  # bare IP
        for _, data in reader:
            packet = dpkt.ip.IP(data)
            checksum, packet.sum = packet.sum, 0
            assert dpkt.ip.IP(bytes(packet)).sum == checksum
            if packet.p == dpkt.ip.IP_PROTO_TCP:
                assert packet.data.sport == 52100
                streams[packet.src] = streams.get(packet.src, b"") + packet.data.data
            else:
                assert (packet.data.dport, len(packet.data.data)) == (52102, 142)
    with open_recording(dive) as recording:
        chunks = list(recording)
    for link, stream in zip(("left", "right"), streams.values(), strict=True):
        assert stream == b"".join(chunk.data for chunk in chunks if chunk.link == link)


def test_what_cannot_be_converted_is_reported_and_nothing_is_left_behind(
    tmp_path: Path, dive: Path
) -> None:
    other = tmp_path / "other"
    other.write_bytes(b"precious")
    before = dive.read_bytes()
    for source, target, kind, text in (
        (dive, tmp_path / "x", "viewpoint-log", "cannot write"),
        (dive, other, MCAP, "file exists"),
        (dive, dive, PCAP, "same file"),
        (dive, tmp_path, PCAP, "is a directory"),
        (dive, tmp_path / "no" / "x", PCAP, "cannot be written"),
        (dive, tmp_path / "no" / "x", MCAP, "cannot be created"),
        (tmp_path / "none", tmp_path / "x", PCAP, "no such file"),
    ):
        with pytest.raises(RecordingError, match=text):
            convert(source, target, kind, overwrite=source == target)
    assert (other.read_bytes(), dive.read_bytes()) == (b"precious", before)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dive.mcap", "other"]


def test_a_disk_that_fails_leaves_nothing_behind(
    tmp_path: Path, dive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(sink: PcapSink, chunk: Chunk) -> None:
        del sink, chunk
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(PcapSink, "put", full)
    with pytest.raises(RecordingError, match="No space left"):
        convert(dive, tmp_path / "x", PCAP)
    assert [path.name for path in tmp_path.iterdir()] == ["dive.mcap"]
