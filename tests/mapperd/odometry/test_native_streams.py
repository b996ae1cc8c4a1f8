"""The native record as JSON lines and as stuffed frames."""

import json
import zlib
from itertools import accumulate, pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapperd.config.odometry import FormatName, FormatSettings
from mapperd.errors import Reject
from mapperd.odometry.decoder import Decoder
from mapperd.odometry.formats import make_decoder
from mapperd.odometry.native import (
    MAX_FRAME_BYTES,
    MAX_LINE_BYTES,
    NativeRecord,
    cobs_decoded,
    cobs_encoded,
    encode_native,
    encode_native_json,
    encode_native_serial,
)
from mapperd.odometry.records import Odometry
from tests.support.odometry import assert_sound
from tests.support.peers.misbehaviour import Misbehaviour

NAMES: tuple[FormatName, ...] = ("native_json", "native_serial")
BOTH = pytest.mark.parametrize("name", NAMES)


def native(x_m: float = 1.0) -> NativeRecord:
    return NativeRecord(
        v=1, clk="boot", w="ned", b="frd", t=5, p=(x_m, 2.0, 3.0), u=(0.1, 0.2, 0.3), src="rov"
    )


def encoded(name: FormatName, record: NativeRecord) -> bytes:
    return encode_native_json(record) if name == "native_json" else encode_native_serial(record)


def link(name: FormatName, *, datagrams: bool = False) -> Decoder:
    return make_decoder(FormatSettings(format=name), datagrams=datagrams)


def norths(decoder: Decoder, *pieces: bytes) -> list[float]:
    results = [r for piece in pieces for r in decoder.feed(piece, None)]
    positions = (r.position_m for r in results if isinstance(r, Odometry))
    return [float(position[1]) for position in positions if position is not None]


@BOTH
def test_record_is_read_back_in_our_frames(name: FormatName) -> None:
    (record,) = link(name).feed(encoded(name, native()), None)
    assert isinstance(record, Odometry)
    assert record.position_m == pytest.approx([2, 1, -3])
    assert record.velocity_mps == pytest.approx([0.1, -0.2, -0.3])
    assert (record.stamp_ns, record.clock, record.source) == (5, "boot", "rov")


def test_json_has_the_keys_of_the_record() -> None:
    assert json.loads(encode_native_json(native())) == {
        "v": 1,
        "clk": "boot",
        "w": "ned",
        "b": "frd",
        "t": 5,
        "p": [1, 2, 3],
        "u": [0.1, 0.2, 0.3],
        "src": "rov",
    }


@BOTH
@given(st.lists(st.integers(1, 60), max_size=10))
def test_split_of_the_stream_does_not_matter(name: FormatName, cuts: list[int]) -> None:
    stream = b"".join(encoded(name, native(n)) for n in range(3))
    ends = [0, *accumulate(cuts), len(stream)]
    pieces = [stream[a:b] for a, b in pairwise(ends)]
    assert norths(link(name), *pieces) == [0, 1, 2]


@BOTH
def test_bad_line_loses_only_what_it_spoils(name: FormatName) -> None:
    decoder = link(name)
    bad = Misbehaviour(drop=0.1, garble=0.1, noise=0.1, max_bytes=50, stall_from=50, stall_for=20)
    found = norths(decoder, *bad.pieces(encoded(name, native(n)) for n in range(400)))
    assert len(found) > 250
    assert decoder.counters.rejects.total() > 30
    if name == "native_serial":  # its check leaves no wrong record through
        assert found == sorted(set(found))
        assert set(found) <= set(range(400))


@BOTH
@given(st.lists(st.binary(max_size=60), max_size=10))
def test_any_bytes_give_records_or_rejects(name: FormatName, pieces: list[bytes]) -> None:
    decoder = link(name)
    for piece in [*pieces, b"\n\0"]:
        assert_sound(decoder.feed(piece, None))
    assert decoder.counters.bytes_total == sum(map(len, pieces)) + 2


@BOTH
def test_too_long_is_refused_once_and_skipped(name: FormatName) -> None:
    decoder, longest = link(name), max(MAX_LINE_BYTES, MAX_FRAME_BYTES)
    endless = [b"x" * 1000] * 20
    end = b"\n" if name == "native_json" else b"\0"
    assert norths(decoder, *endless, end, encoded(name, native(7))) == [7]
    assert decoder.counters.rejects == {"too_long": 1}
    assert decoder.counters.bytes_skipped == 20_000
    one_piece = b"x" * (longest + 1) + end
    assert norths(decoder, one_piece, encoded(name, native(8))) == [8]
    assert decoder.counters.rejects == {"too_long": 2}


@BOTH
def test_memory_is_bounded(name: FormatName) -> None:
    decoder = link(name)
    for _ in range(100):
        list(decoder.feed(b"x" * 1000, None))
        assert len(decoder._rest) <= MAX_LINE_BYTES  # type: ignore[attr-defined]


@BOTH
def test_restart_forgets_half_a_record(name: FormatName) -> None:
    decoder, data = link(name), encoded(name, native(3))
    list(decoder.feed(data[:20], None))
    decoder.restart()
    assert norths(decoder, data) == [3]
    assert decoder.counters.bytes_skipped == 20


def test_datagram_of_json_needs_no_line_end() -> None:
    decoder = link("native_json", datagrams=True)
    data = encode_native_json(native(3)).rstrip()
    assert norths(decoder, data, data + b"\n" + data) == [3, 3, 3]


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"{}", "wrong_shape"),
        (b"5", "wrong_shape"),
        (b'{"v": 1, "x": 2}', "wrong_shape"),
        (b'{"v": 1', "not_json"),
        (b'{"v": NaN}', "not_json"),
        (b"\xff", "not_json"),
        (b"[" * 3000, "wrong_shape"),
        (b'{"v":1,"clk":"unix","w":"ned","b":"frd"}', "no_stamp"),
        (b'{"v":1,"clk":"boot","w":"ned","b":"frd","t":1,"q":[0,0,0,0]}', "zero_quaternion"),
    ],
)
def test_bad_line_is_rejected_with_a_reason(line: bytes, reason: str) -> None:
    (reject,) = link("native_json").feed(line + b"\n", None)
    assert isinstance(reject, Reject)
    assert reject.reason == reason


def test_frame_is_the_record_and_its_crc_stuffed() -> None:
    data = encode_native(native())
    frame = encode_native_serial(native())
    assert frame[-1] == 0
    assert cobs_decoded(frame[:-1]) == data + zlib.crc32(data).to_bytes(4, "little")
    assert zlib.crc32(b"123456789") == 0xCBF43926  # the published check of this CRC


def test_every_garbled_byte_is_noticed() -> None:
    frame = encode_native_serial(native())
    for place in range(len(frame) - 1):
        for change in (0x01, 0x80, 0xFF):
            spoilt = bytearray(frame)
            spoilt[place] ^= change
            results = list(link("native_serial").feed(bytes(spoilt), None))
            assert results
            assert all(isinstance(result, Reject) for result in results)


@pytest.mark.parametrize(
    ("plain", "stuffed"),  # the examples of the paper's readers, in hexadecimal
    [
        ("", "01"),
        ("00", "0101"),
        ("0000", "010101"),
        ("001100", "01021101"),
        ("11220033", "0311220233"),
        ("11223344", "0511223344"),
        ("11000000", "0211010101"),
        ("01" * 254, "ff" + "01" * 254),
        ("00" + "01" * 254, "01ff" + "01" * 254),
        ("01" * 255, "ff" + "01" * 254 + "0201"),
        ("01" * 254 + "00", "ff" + "01" * 254 + "0101"),
        ("01" * 253 + "00", "fe" + "01" * 253 + "01"),
    ],
)
def test_stuffing_of_known_bytes(plain: str, stuffed: str) -> None:
    assert cobs_encoded(bytes.fromhex(plain)).hex() == stuffed
    assert cobs_decoded(bytes.fromhex(stuffed)) == bytes.fromhex(plain)


@given(st.lists(st.sampled_from((b"\0", b"a", b"b" * 253, b"c" * 254)), max_size=8))
def test_stuffing_is_undone(pieces: list[bytes]) -> None:
    data = b"".join(pieces)
    stuffed = cobs_encoded(data)
    assert 0 not in stuffed
    assert len(stuffed) <= len(data) + len(data) // 254 + 1
    assert cobs_decoded(stuffed) == data


@pytest.mark.parametrize("data", [b"", b"\x05abc", b"\x02\0"])
def test_bytes_that_were_never_stuffed(data: bytes) -> None:
    assert cobs_decoded(data) is None
