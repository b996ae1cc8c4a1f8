from itertools import accumulate, pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from mapperd.config.odometry import FormatSettings
from mapperd.errors import Reject
from mapperd.odometry.mavlink import MAX_FRAME_BYTES, MavlinkDecoder
from mapperd.odometry.records import Odometry
from tests.support.odometry import assert_sound
from tests.support.peers.autopilot import Autopilot
from tests.support.peers.misbehaviour import Misbehaviour

SETTINGS = FormatSettings(format="mavlink")


def decoder(*, datagrams: bool = False) -> MavlinkDecoder:
    return MavlinkDecoder(SETTINGS, datagrams=datagrams)


def fed(link: MavlinkDecoder, *pieces: bytes) -> list[Odometry | Reject]:
    return [result for piece in pieces for result in link.feed(piece, None)]


def places(results: list[Odometry | Reject]) -> list[float]:
    """North of each record, in order."""
    positions = (r.position_m for r in results if isinstance(r, Odometry))
    return [float(position[1]) for position in positions if position is not None]


def track(count: int, version: int = 2) -> list[bytes]:
    autopilot = Autopilot(version=version)
    return [autopilot.local_position((n, 0, 0)) for n in range(count)]


@given(st.lists(st.integers(1, 40), max_size=10), st.sampled_from((1, 2)))
def test_split_of_the_stream_does_not_matter(cuts: list[int], version: int) -> None:
    stream = b"".join(track(3, version))
    ends = [0, *accumulate(cuts), len(stream)]
    pieces = [stream[a:b] for a, b in pairwise(ends)]
    assert places(fed(decoder(), *pieces)) == [0, 1, 2]


def test_both_versions_may_share_a_stream() -> None:
    old, new = track(1, 1), track(2, 2)[1:]
    assert places(fed(decoder(), *old, *new)) == [0, 1]


@pytest.mark.parametrize("noise", [b"x", b"\xfd", b"\xfe", b"\xfd\xff", b"hello \xfe\xfd" * 9])
def test_noise_costs_no_frame_but_may_delay_some(noise: bytes) -> None:
    link = decoder()
    results = fed(link, *[noise + data for data in track(20)], bytes(MAX_FRAME_BYTES))
    assert places(results) == list(range(20))
    assert link.counters.bytes_skipped == 20 * len(noise) + MAX_FRAME_BYTES
    assert link.counters.rejects == {"not_a_frame": 21}


@given(st.integers(0, 39), st.integers(1, 255))
def test_garbled_byte_costs_one_frame(place: int, change: int) -> None:
    first, *others = track(20)
    spoilt = bytearray(first)
    spoilt[place % len(spoilt)] ^= change
    link = decoder()
    found = places(fed(link, bytes(spoilt), *others))
    assert found[-19:] == list(range(1, 20))
    assert len(found) - 19 + link.counters.rejects.total() + link.counters.messages["unknown"] >= 1


def test_datagram_does_not_wait_for_the_next_one() -> None:
    whole, other = track(2)
    link = decoder(datagrams=True)
    results = fed(link, whole + other[:-1], b"\xfd\xff", whole)
    assert places(results) == [0, 0]
    assert link.counters.rejects == {"not_a_frame": 1}


def test_restart_forgets_half_a_frame() -> None:
    first, second = track(2)
    link = decoder()
    fed(link, first[:10])
    link.restart()
    assert places(fed(link, second)) == [1]
    assert link.counters.bytes_skipped == 10


def test_memory_is_bounded() -> None:
    link = decoder()
    for _ in range(100):
        fed(link, b"\xfd\xff\x01" * 1000)
    assert len(link._frames._buffer) <= MAX_FRAME_BYTES


def test_signed_frame_is_read() -> None:
    autopilot = Autopilot()
    autopilot.codec.signing.secret_key = bytes(32)
    autopilot.codec.signing.sign_outgoing = True
    data = autopilot.local_position((4, 0, 0))
    assert data[2] == 1
    assert places(fed(decoder(), data, track(2)[1])) == [4, 1]


def test_frame_with_unknown_flags_is_not_taken() -> None:
    data = bytearray(track(1)[0])
    data[2] |= 0x02
    crc = common.x25crc(bytes(data[1:-2]) + bytes([185])).crc  # LOCAL_POSITION_NED
    data[-2:] = crc.to_bytes(2, "little")
    (reject,) = fed(decoder(), bytes(data))
    assert isinstance(reject, Reject)
    assert reject.reason == "incompatible"


def test_message_of_another_dialect_is_passed_over() -> None:
    unknown = b"\xfd\x04\0\0\0\x01\x01\xf3\x2a\0abcdXX"  # 11 011
    link = decoder()
    assert places(fed(link, track(1)[0], unknown, unknown + track(2)[1])) == [0, 1]
    assert link.counters.messages["unknown"] == 2
    assert link.counters.bytes_skipped == 0


@given(st.lists(st.binary(max_size=100), max_size=10), st.booleans())
def test_any_bytes_give_records_or_rejects(pieces: list[bytes], datagrams: bool) -> None:  # noqa: FBT001 generated
    link = decoder(datagrams=datagrams)
    assert_sound(fed(link, *pieces))
    assert link.counters.bytes_total == sum(map(len, pieces))


@given(st.sampled_from(sorted(common.mavlink_map)), st.binary(min_size=1, max_size=255))
def test_any_payload_gives_records_or_rejects(number: int, payload: bytes) -> None:
    head = bytes([len(payload), 0, 0, 0, 1, 1]) + number.to_bytes(3, "little") + payload
    crc = common.x25crc(head + bytes([common.mavlink_map[number].crc_extra])).crc
    link = decoder()
    assert_sound(fed(link, b"\xfd" + head + crc.to_bytes(2, "little"), track(1)[0]))
    assert link.counters.frames == 2


def test_bad_line_loses_only_what_it_spoils() -> None:
    link = decoder()
    bad = Misbehaviour(drop=0.1, garble=0.1, noise=0.2, max_bytes=50)
    found = places(fed(link, *bad.pieces(track(500))))
    assert found == sorted(set(found))
    assert len(found) > 350
    assert link.counters.rejects.total() > 50
