"""Full ping results: what the public header names is decoded, the rest is named and counted."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from oculus_driver import FullPing, Reject, StreamParser, decode_full_ping, decode_ping
from oculus_driver.cli.info import _lines
from oculus_driver.link.receiver import PingReceiver
from oculus_driver.recording import describe, open_recording
from oculus_driver.wire import FULL_PING_RESULT, MessageId

if TYPE_CHECKING:
    from pathlib import Path

    from oculus_driver import Message
    from tests.oculus_driver.conftest import MakePing

ROWS, BEAMS = 30, 256


def full_ping(sample: str = "<u2", gap: int = 14, **changes: Any) -> bytes:
    image = np.arange(ROWS * BEAMS).astype(sample).tobytes()
    start = FULL_PING_RESULT.size + 2 * BEAMS + gap
    fields = {
        "message_id": MessageId.FULL_PING_RESULT,
        "source_id": 7892,
        "payload_size": start + len(image) - 16,
        "range_m": 12.5,
        "beams": BEAMS,
        "rows": ROWS,
        "image_offset": start,
        "image_size": len(image),
        "message_size": start + len(image),
    }
    table = np.linspace(-3000, 3000, BEAMS).astype("<i2").tobytes()
    return FULL_PING_RESULT.pack(fields | changes) + table + bytes(gap) + image


def message_of(data: bytes) -> Message:
    parser = StreamParser()
    (message,) = parser.feed(data, 5) + parser.finish()
    return message


def test_the_layout_is_that_of_the_public_header() -> None:
    places = ("range_m", "beams", "rows", "image_offset", "image_size", "message_size")
    assert [FULL_PING_RESULT.offset_of(name) for name in places] == [25, 73, 555, 576, 580, 584]
    assert FULL_PING_RESULT.size == 588


@pytest.mark.parametrize(("sample", "gap"), [("u1", 0), ("<u2", 14), ("<u4", 1)])
def test_what_the_header_names_is_decoded(sample: str, gap: int) -> None:
    ping = decode_full_ping(message_of(full_ping(sample, gap)))
    assert isinstance(ping, FullPing)
    assert (ping.range_m, ping.rows, ping.beams) == (12.5, ROWS, BEAMS)
    assert (ping.arrival_ns, ping.source_id) == (5, 7892)
    assert ping.bearings_rad[[0, -1]] == pytest.approx(np.radians([-30.0, 30.0]))
    assert ping.image is not None
    assert ping.image.tobytes() == ping.image_bytes
    assert ping.image.shape == (ROWS, BEAMS)
    assert not ping.image.flags.writeable


def test_an_image_of_an_unknown_sample_size_stays_bytes() -> None:
    size = ROWS * BEAMS * 2 - 6
    data = full_ping(image_size=size)
    ping = decode_full_ping(message_of(data))
    assert isinstance(ping, FullPing)
    assert ping.image is None
    assert len(ping.image_bytes) == size


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"rows": 0}, "empty"),
        ({"beams": 0}, "empty"),
        ({"image_offset": 588}, "out_of_bounds"),
        ({"image_size": 0xFFFFFFFF}, "out_of_bounds"),
        ({"message_size": 1000}, "size_mismatch"),
        ({"beams": 0xFFFF}, "out_of_bounds"),
    ],
)
def test_contradictions_are_rejected(changes: dict[str, Any], reason: str) -> None:
    rejected = decode_full_ping(message_of(full_ping(**changes)))
    assert isinstance(rejected, Reject)
    assert rejected.reason == reason


def test_a_short_message_and_another_one_are_rejected(make_ping: MakePing) -> None:
    short = bytearray(full_ping()[:100])
    struct.pack_into("<I", short, 10, 84)
    rejected = decode_full_ping(message_of(bytes(short)))
    assert isinstance(rejected, Reject)
    assert rejected.reason == "short_message"
    other = decode_full_ping(message_of(make_ping()))
    assert isinstance(other, Reject)
    assert isinstance(decode_ping(message_of(full_ping())), Reject)


def test_full_pings_are_counted_by_name(tmp_path: Path, make_ping: MakePing) -> None:
    path = tmp_path / "stream.raw"
    stream = make_ping() + full_ping() + full_ping(rows=0) + make_ping(ping_id=8)
    path.write_bytes(stream)
    with open_recording(path) as recording:
        info = describe(recording)
    assert (info.pings, info.full_pings, info.rejects) == (2, 1, {"empty": 1})
    assert "full ping results: 1 (not mapped)" in "\n".join(_lines("x", info, listed=False))
    receiver = PingReceiver()
    receiver.feed(stream, 0)
    assert (receiver.pings, receiver.rejects) == (2, {"full_ping": 2})
