"""What a recording holds, as counted."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from oculus_driver.encode import encode_dummy, encode_status
from oculus_driver.recording import OCULUS, OCULUS_STATUS, RecordingWriter, describe, open_recording
from oculus_driver.recording import info as info_module

if TYPE_CHECKING:
    from pathlib import Path

    import pytest

    from oculus_driver.recording import RecordingInfo
    from tests.oculus_driver.conftest import MakePing


def described(path: Path, data: bytes | None = None) -> RecordingInfo:
    if data is not None:
        path.write_bytes(data)
    with open_recording(path) as recording:
        return describe(recording)


def test_a_real_capture_is_described(capture_path: Path) -> None:
    info = described(capture_path)
    assert (info.format, info.messages, info.pings) == ("oculus-raw", 3, 3)
    assert (info.bytes_total, info.bytes_rejected, info.rejects) == (546048, 0, {})
    assert [ping.id for ping in info.ping_list] == [415323, 415324, 415325]
    assert {(p.rows, p.beams, p.range_m, p.frequency_hz) for p in info.ping_list} == {
        (703, 256, 1.9980588466688405, 2098880.5970149254)
    }
    assert (info.truncated, info.damage, info.lost_pings) == (False, None, 0)


def test_the_description_is_json(capture_path: Path) -> None:
    whole = json.loads(json.dumps(described(capture_path).as_json(), allow_nan=False))
    assert whole["messages_by_id"] == {"35": 3}
    assert whole["links"] == {"sonar": {"encoding": "oculus", "chunks": 9, "bytes": 546048}}
    assert whole["ping_list"][2]["id"] == 415325
    assert whole["rejects"] == {}


def test_garbage_is_counted_by_reason(tmp_path: Path, make_ping: MakePing) -> None:
    odd = make_ping(ping_id=9, range_resolution_m=0.0)
    data = make_ping() + b"?" * 100 + make_ping(ping_id=8) + odd + make_ping(ping_id=10)[:500]
    info = described(tmp_path / "bad", data)
    assert (info.messages, info.pings, info.bytes_rejected) == (3, 2, 600)
    assert info.rejects == {"bad_magic": 1, "bad_resolution": 1, "truncated": 1}
    assert info.truncated
    assert info.lost_pings == 0


def test_statuses_and_several_sonars_are_kept_apart(tmp_path: Path, make_ping: MakePing) -> None:
    path = tmp_path / "two.mcap"
    with RecordingWriter(path) as writer:
        left, right = writer.add_link("left", OCULUS), writer.add_link("right", OCULUS)
        status = writer.add_link("status", OCULUS_STATUS)
        for index in range(4):
            ping = make_ping(ping_id=index)
            for link in (left, right):  # in halves, one between the other
                writer.write(link, ping[:1000], 1000 + index)
            for link in (left, right):
                writer.write(link, ping[1000:] + encode_dummy(), 1500 + index)
            writer.write(status, encode_status(device_id=7), 1600 + index)
        writer.write(status, b"short", 2000)
    info = described(path)
    assert (info.format, info.pings, info.messages, info.statuses) == ("mcap", 8, 16, 4)
    assert info.messages_by_id == {0x23: 8, 0xFF: 8}
    assert info.rejects == {"short_message": 1}
    assert (info.start_ns, info.end_ns) == (1000, 2000)
    assert [ping.link for ping in info.ping_list].count("left") == 4
    assert info.ping_list[0].arrival_ns == 1000


def test_frequencies_that_are_no_numbers_are_null(tmp_path: Path, make_ping: MakePing) -> None:
    info = described(tmp_path / "odd", make_ping(frequency_hz=float("nan")))
    assert info.ping_list[0].frequency_hz is None
    assert info.warnings == {"bad_frequency": 1}


def test_the_lists_are_bounded(
    tmp_path: Path, make_ping: MakePing, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(info_module, "MAX_LISTED_PINGS", 2)
    monkeypatch.setattr(info_module, "_MAX_STREAMS", 1)
    path = tmp_path / "many.mcap"
    with RecordingWriter(path) as writer:
        first, second = writer.add_link("a", OCULUS), writer.add_link("b", OCULUS)
        for index in range(3):
            writer.write(first, make_ping(ping_id=index), None)
        writer.write(second, make_ping(), None)
    info = described(path)
    assert (info.pings, len(info.ping_list)) == (3, 2)
    assert info.rejects == {"too_many_links": 1}
