"""Network captures: sonars found in them, streams put together, damage survived."""

from __future__ import annotations

import re
import struct
import tracemalloc
from typing import TYPE_CHECKING

import numpy as np
import pytest

from oculus_driver.encode import encode_dummy, encode_fire, encode_status
from oculus_driver.recording import OCULUS_STATUS, PCAP, PCAPNG, describe, open_recording
from oculus_driver.recording.chunk import Progress
from oculus_driver.recording.network_capture import TCP, Flow, Segment, _FlowSorter, segment_of
from tests.oculus_driver.recording.foreign_files import (
    HOST,
    SONAR,
    Wire,
    block,
    ethernet,
    interface,
    ipv4,
    ipv6,
    packet,
    pcap,
    section,
    tcp,
    udp,
)

if TYPE_CHECKING:
    from pathlib import Path

    from oculus_driver.recording import Chunk, Recording, RecordingInfo
    from tests.oculus_driver.conftest import MakePing


def read(path: Path, data: bytes, kind: str = PCAP) -> tuple[list[Chunk], Recording]:
    path.write_bytes(data)
    with open_recording(path) as recording:
        assert recording.format == kind
        return list(recording), recording


def described(path: Path, data: bytes) -> RecordingInfo:
    path.write_bytes(data)
    with open_recording(path) as recording:
        return describe(recording)


@pytest.fixture
def wire(capture: bytes) -> Wire:
    wire = Wire()
    wire.open()
    wire.send(capture)
    return wire


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("nano", [False, True])
def test_the_stream_of_a_capture_is_that_of_the_sonar(
    tmp_path: Path, capture: bytes, wire: Wire, order: str, *, nano: bool
) -> None:
    chunks, recording = read(tmp_path / "c", pcap(wire.frames, order=order, nano=nano))
    assert b"".join(chunk.data for chunk in chunks) == capture
    assert [chunk.arrival_ns for chunk in chunks] == [stamp for stamp, _ in wire.frames[1:]]
    assert not any(chunk.gap_before for chunk in chunks)
    assert (recording.damage, recording.bytes_read) == (None, recording.size_bytes)
    assert recording.start_ns == wire.frames[1][0]
    assert describe_again(recording) == [415323, 415324, 415325]


def describe_again(recording: Recording) -> list[int]:
    with open_recording(recording.path) as again:
        return [ping.id for ping in describe(again).ping_list]


@pytest.mark.parametrize("order", "<>")
def test_pcapng_is_read_with_its_own_clock(
    tmp_path: Path, capture: bytes, wire: Wire, order: str
) -> None:
    data = section(order) + interface(order, resolution=9) + interface(order, resolution=0x80 | 20)
    for index, (stamp, frame) in enumerate(wire.frames):
        ticks = stamp if index % 2 == 0 else (stamp << 20) // 10**9
        data += packet(ticks, frame, order, index % 2)
    data += block(5, bytes(20), order)  # statistics
    chunks, recording = read(tmp_path / "c", data, PCAPNG)
    assert b"".join(chunk.data for chunk in chunks) == capture
    for chunk, (stamp, _) in zip(chunks, wire.frames[1:], strict=True):
        assert chunk.arrival_ns == pytest.approx(stamp, abs=1000)
    assert recording.damage is None


def test_reordered_and_repeated_segments_give_the_same_stream(
    tmp_path: Path, capture: bytes, wire: Wire
) -> None:
    rng = np.random.default_rng(8)
    frames = list(wire.frames[1:])
    frames += [frames[int(at)] for at in rng.integers(0, len(frames), 50)]
    order = np.argsort(np.arange(len(frames)) % len(wire.frames) + rng.uniform(0, 9, len(frames)))
    frames = wire.frames[:1] + [frames[int(at)] for at in order]
    chunks, recording = read(tmp_path / "c", pcap(frames))
    assert b"".join(chunk.data for chunk in chunks) == capture
    stamps = [chunk.arrival_ns or 0 for chunk in chunks]
    assert stamps == sorted(stamps)
    assert recording.damage is None


def test_a_packet_that_was_not_captured_costs_its_ping_only(tmp_path: Path, wire: Wire) -> None:
    del wire.frames[200]  # inside the second ping
    info = described(tmp_path / "c", pcap(wire.frames))
    assert [ping.id for ping in info.ping_list] == [415323, 415325]
    assert re.match(r"1448 bytes .*'sonar'", info.damage or "")
    assert (info.faults, info.lost_pings) == (1, 1)


def test_a_reconnection_is_the_same_link_behind_a_gap(tmp_path: Path, capture: bytes) -> None:
    first = Wire()
    first.open()
    first.send(capture[:250_000])
    for second in (
        Wire(client_port=40_001, sequence=77, now_ns=first.now_ns),
        Wire(sequence=77, now_ns=first.now_ns),  # the same ports again
    ):
        second.open()
        second.send(capture[182016:])
        chunks, _ = read(tmp_path / "c", pcap(first.frames + second.frames))
        assert {chunk.link for chunk in chunks} == {"sonar"}
        assert [chunk.gap_before for chunk in chunks].count(True) == 1
        info = described(tmp_path / "c", pcap(first.frames + second.frames))
        assert [ping.id for ping in info.ping_list] == [415323, 415324, 415325]
        assert info.rejects == {"truncated": 1}


def test_several_sonars_and_their_statuses_are_kept_apart(
    tmp_path: Path, make_ping: MakePing
) -> None:
    left = Wire()
    right = Wire(source=bytes((192, 168, 2, 4)), port=9000)  # served on another port
    frames = []
    for index in range(3):
        for sonar in (left, right):
            sonar.send(make_ping(ping_id=index))
        status = udp(encode_status(device_id=7), ports=(52102, 52102))
        left.frames.append((left.now_ns, ethernet(ipv4(17, status, SONAR, b"\xff" * 4))))
    frames = [item for pair in zip(left.frames, right.frames, strict=False) for item in pair]
    chunks, recording = read(tmp_path / "c", pcap(frames))
    assert {chunk.link for chunk in chunks} == {"sonar", "sonar-2", "status"}
    assert {c.encoding for c in chunks if c.link == "status"} == {OCULUS_STATUS}
    info = described(recording.path, pcap(frames))
    assert info.statuses == sum(chunk.link == "status" for chunk in chunks) > 0
    assert [ping.link for ping in info.ping_list].count("sonar") >= 2
    assert [ping.link for ping in info.ping_list].count("sonar-2") == 3


def test_other_traffic_is_left_out(tmp_path: Path, make_ping: MakePing) -> None:
    wire = Wire()
    wire.send(make_ping())
    noise = [
        ethernet(ipv4(6, tcp(1, encode_fire(), ports=(40_000, 52100)), HOST, SONAR)),
        ethernet(ipv4(6, tcp(1, b"SSH-2.0-x" * 9, ports=(22, 40_002)), SONAR, HOST)),
        ethernet(ipv4(17, udp(bytes(200), ports=(52102, 52102)), SONAR, HOST)),
        ethernet(ipv4(1, bytes(64), SONAR, HOST)),
        bytes(60),
    ]
    data = pcap([(5, frame) for frame in noise] + wire.frames + [(6, frame) for frame in noise])
    chunks, recording = read(tmp_path / "c", data)
    assert b"".join(chunk.data for chunk in chunks) == make_ping()
    assert recording.damage is None


def test_packets_are_read_through_all_their_layers() -> None:
    body = tcp(9, b"data", ports=(52100, 1))
    six = ipv6(6, body, bytes(16), bytes(range(16)))
    four = ipv4(6, body, SONAR, HOST)
    offloaded = four[:2] + bytes(2) + four[4:]
    for link_type, data in (
        (1, ethernet(four)),
        (1, ethernet(four) + b"\xee" * 6),
        (1, ethernet(four, vlan=5)),
        (1, ethernet(six)),
        (0, struct.pack("<I", 2) + four),
        (101, four),
        (228, four),
        (229, six),
        (101, offloaded),
        (113, bytes(14) + b"\x08\x00" + four),
        (276, b"\x08\x00" + bytes(18) + four),
    ):
        segment = segment_of(link_type, data)
        assert segment is not None
        assert (segment.sequence, segment.payload) == (9, b"data")
        assert (segment.flow.source_port, segment.flags) == (52100, 0x10)
        for cut in range(len(data)):
            shorter = segment_of(link_type, data[:cut])
            assert shorter is None or b"data".startswith(shorter.payload)
    fragment = four[:6] + b"\x20\x00" + four[8:]
    assert segment_of(101, fragment) is None
    assert segment_of(147, four) is None


def test_cut_captures_give_what_is_there(tmp_path: Path, capture: bytes, wire: Wire) -> None:
    for whole, kind in (
        (pcap(wire.frames), PCAP),
        (section() + interface() + b"".join(packet(*item) for item in wire.frames), PCAPNG),
    ):
        for cut in (10, 30, 50, 5000, len(whole) // 2, len(whole) - 1):
            chunks, recording = read(tmp_path / "c", whole[:cut], kind)
            data = b"".join(chunk.data for chunk in chunks)
            assert capture.startswith(data)
            assert len(data) > cut * 0.9 - 4000
            assert recording.truncated


def test_lengths_that_cannot_be_are_not_believed(tmp_path: Path, wire: Wire) -> None:
    whole = pcap(wire.frames)
    tracemalloc.start()
    lie = whole[:24] + struct.pack("<IIII", 1, 1, 0xFFFFFFFF, 0xFFFFFFFF) + whole[24:]
    chunks, recording = read(tmp_path / "c", lie)
    assert (chunks, recording.truncated) == ([], True)
    for size in (0, 4, 13, 0xFFFFFFF0):
        hurt = section() + struct.pack("<II", 6, size) + bytes(100)
        chunks, recording = read(tmp_path / "c", hurt, PCAPNG)
        assert (chunks, recording.truncated) == ([], True)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 8 << 20


def test_each_section_of_a_pcapng_file_has_its_own_interfaces(
    tmp_path: Path, make_ping: MakePing
) -> None:
    wire = Wire()
    wire.send(make_ping(), size=2000)
    (stamp, frame), (_, other) = wire.frames
    data = section() + interface() + packet(stamp, frame)
    data += section(">") + interface(">", resolution=6) + packet(stamp // 1000 + 10**6, other, ">")
    chunks, recording = read(tmp_path / "c", data, PCAPNG)
    assert b"".join(chunk.data for chunk in chunks) == make_ping()
    assert [chunk.arrival_ns for chunk in chunks] == [stamp, stamp + 10**9]
    assert recording.damage is None


def test_flows_are_bounded_and_the_longest_silent_go_first() -> None:
    sorter = _FlowSorter(Progress())
    data = b""
    for port in range(3000):
        for at in (1, 3):  # what comes last waits for a hole
            flow = Flow(SONAR, 52100, HOST, port)
            chunks = sorter.take(Segment(TCP, flow, 2 * at, 0, b"ab"), 5)
            data += b"".join(chunk.data for chunk in chunks)
        assert len(sorter.flows) <= 256
    data += b"".join(chunk.data for chunk in sorter.finish())
    assert data == b"ab" * 6000


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("flip", [8, 9, 10, 11])
def test_a_damaged_packet_head_costs_packets_and_not_the_rest(
    tmp_path: Path, wire: Wire, order: str, flip: int
) -> None:
    """Flip bits in the captured length of a packet of the second ping."""
    later = [(stamp + 3600 * 10**9, frame) for stamp, frame in wire.frames[200:]]
    for whole, place in (
        (pcap(wire.frames[:200], order=order), flip),
        (
            section(order)
            + interface(order)
            + b"".join(packet(*item, order) for item in wire.frames[:200]),
            flip - 4,  # the block's length
        ),
    ):
        rest = (
            pcap(later, order=order)[24:]
            if whole[0] != 0x0A
            else b"".join(packet(*item, order) for item in later)
        )
        hurt = bytearray(whole + rest)
        hurt[len(whole) + place] ^= 0x10
        info = described(tmp_path / "c", bytes(hurt))
        assert [ping.id for ping in info.ping_list] == [415323, 415325]
        assert (info.faults, info.truncated) == (2, False)  # the head, and the hole in the stream


def test_what_looks_like_a_packet_head_is_not_believed_alone(tmp_path: Path, wire: Wire) -> None:
    stamp, _ = wire.frames[0]
    fake = struct.pack("<IIII", stamp // 10**9, 0, 40, 40)
    noise = ethernet(ipv4(17, udp(fake + bytes(200), ports=(1, 2)), SONAR, HOST))
    broken = struct.pack("<IIII", 0, 0, 1 << 31, 0)
    data = pcap([(stamp, noise)]) + broken + pcap(wire.frames)[24:]
    info = described(tmp_path / "c", data)
    assert (info.pings, info.faults) == (3, 1)


def test_searching_a_file_of_lies_takes_no_longer_than_the_file_is_long(tmp_path: Path) -> None:
    record = struct.pack("<IIII", 5, 0, 1, 1) + b"x" + struct.pack("<IIII", 5, 0, 1, 1) + b"x?"
    _, recording = read(tmp_path / "c", pcap([(5 * 10**9, b"x")]) + record * 5000)
    assert recording.faults > 4000
    lie = packet(0, b"") + b"????"
    _, recording = read(tmp_path / "c", section() + interface() + lie * 5000, PCAPNG)
    assert recording.faults > 4000


def test_no_bytes_make_reading_fail(tmp_path: Path, make_ping: MakePing) -> None:
    rng = np.random.default_rng(6)
    wire = Wire()
    wire.open()
    for index in range(6):
        wire.send(make_ping(ping_id=index) + encode_dummy())
    whole = [
        pcap(wire.frames),
        section() + interface() + b"".join(packet(*item) for item in wire.frames),
    ]
    for turn in range(150):
        hurt = bytearray(whole[turn % 2])
        for at in rng.integers(24, len(hurt), 12):
            hurt[at] = rng.integers(256)
        assert described(tmp_path / "c", bytes(hurt)).pings <= 6
