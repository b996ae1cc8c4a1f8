"""Opening files: recordings by content, and everything else by a clear line."""

from __future__ import annotations

import io
import os
import sqlite3
from contextlib import closing
from typing import TYPE_CHECKING

import numpy as np
import pytest
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.writer import Writer

from oculus_driver.encode import encode_dummy
from oculus_driver.errors import RecordingError
from oculus_driver.recording import (
    MCAP,
    OCULUS,
    OCULUS_RAW,
    RecordingWriter,
    convert,
    open_recording,
)
from oculus_driver.stream import StreamParser

if TYPE_CHECKING:
    from pathlib import Path

    from tests.oculus_driver.recording.conftest import Written

STARTS = [0, 182016, 364032]


def opened(path: Path, data: bytes) -> tuple[str, bytes, bool, str | None]:
    path.write_bytes(data)
    with open_recording(path) as recording:
        assert recording.size_bytes == len(data)
        whole = b"".join(chunk.data for chunk in recording)
        return recording.format, whole, recording.truncated, recording.damage


def test_an_mcap_file_is_known_by_its_content(written: Written) -> None:
    with open_recording(written.path) as recording:
        assert (recording.format, recording.has_time) == (MCAP, True)
        assert recording.path == written.path
        assert recording.size_bytes == len(written.data)
        assert (recording.start_ns, recording.end_ns) == (written.rows[0][2], written.rows[-1][2])
        assert recording.metadata["format_version"] == "3"
        assert recording.bytes_read == 0
        iterator = iter(recording)
        for _ in range(60):
            next(iterator)
        assert 0 < recording.bytes_read < recording.size_bytes
        assert len(list(iterator)) == 60
        assert recording.bytes_read == recording.size_bytes
        assert len(list(recording)) == 120
        assert (recording.truncated, recording.damage, recording.faults) == (False, None, 0)


def test_a_cut_mcap_file_is_known_down_to_its_first_byte(written: Written, tmp_path: Path) -> None:
    for size in (1, 5, 8, 9, 30, 200, 3000):
        kind, _, truncated, damage = opened(tmp_path / "cut", written.data[:size])
        assert (kind, truncated) == (MCAP, True)
        assert damage is not None


def test_the_span_of_a_cut_file_is_known_after_reading(written: Written, tmp_path: Path) -> None:
    path = tmp_path / "cut"
    path.write_bytes(written.data[: written.ends[30]])
    with open_recording(path) as recording:
        assert (recording.start_ns, recording.end_ns) == (written.rows[0][2], None)
        list(recording)
        assert recording.end_ns == written.rows[30][2]


def test_a_raw_stream_is_known_by_its_content(capture_path: Path, capture: bytes) -> None:
    with open_recording(capture_path) as recording:
        assert (recording.format, recording.has_time) == (OCULUS_RAW, False)
        assert (recording.start_ns, recording.end_ns) == (None, None)
        chunks = list(recording)
    assert {(chunk.link, chunk.encoding, chunk.arrival_ns) for chunk in chunks} == {
        ("sonar", OCULUS, None)
    }
    assert b"".join(chunk.data for chunk in chunks) == capture
    assert recording.bytes_read == recording.size_bytes == len(capture)
    assert (recording.truncated, recording.damage) == (False, None)


@pytest.mark.parametrize(
    ("start", "found"),
    [
        (1, STARTS[1:]),
        (634, STARTS[1:]),
        (1000, STARTS[1:]),
        (2048, STARTS[1:]),
        (182015, STARTS[1:]),
        (182017, STARTS[2:]),
    ],
)
def test_a_raw_stream_without_its_beginning_is_known(
    capture: bytes, tmp_path: Path, start: int, found: list[int]
) -> None:
    kind, data, truncated, damage = opened(tmp_path / "late", capture[start:])
    parser = StreamParser()
    messages = parser.feed(data) + parser.finish()
    assert kind == OCULUS_RAW
    assert [message.offset + start for message in messages] == found
    assert not truncated
    assert (damage or "").startswith(f"{found[0] - start} bytes ")


def test_a_raw_stream_without_one_whole_message_is_reported(capture: bytes, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no sonar messages"):
        opened(tmp_path / "late", capture[364033:])


@pytest.mark.parametrize("cut", [16, 1000, 182015, 182017, 500_000])
def test_a_cut_raw_stream_is_truncated(capture: bytes, tmp_path: Path, cut: int) -> None:
    kind, data, truncated, damage = opened(tmp_path / "cut", capture[:cut])
    assert (kind, data, truncated) == (OCULUS_RAW, capture[:cut], True)
    assert damage is not None
    assert "ends inside a message" in damage


def test_a_stream_of_a_sonar_in_standby_is_known(tmp_path: Path) -> None:
    assert opened(tmp_path / "standby", b"??" + encode_dummy() * 2)[0] == OCULUS_RAW


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"", "is empty; nothing was recorded"),
        (bytes(1), "only zeros"),
        (bytes(200_000), "only zeros"),
        (b"hello\nworld\n" * 1000, "is a text file"),
        (b"SO what, asks the text", "is a text file"),
        (np.random.default_rng(5).bytes(200_000), "no sonar messages"),
        (b"SO\0\0\0\0\x23\0\0\0\xff\xff\xff\xff\0\0" + bytes(5000), "no sonar messages"),
    ],
)
def test_what_is_no_recording_is_reported_in_one_line(
    tmp_path: Path, content: bytes, text: str
) -> None:
    path = tmp_path / "capture.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=text) as failure:
        open_recording(path)
    assert str(path) in str(failure.value)
    assert "\n" not in str(failure.value)


def ros_bag(kind: str) -> bytes:
    file = io.BytesIO()
    writer = Writer(file)
    writer.start(profile=kind)
    schema = writer.register_schema("sensor_msgs/msg/Image", "ros2msg", b"")
    link = writer.register_channel("/image", "cdr", schema)
    writer.add_message(link, 1, b"image", 1)
    writer.finish()  # type: ignore[no-untyped-call]
    return file.getvalue()


def test_a_ros_bag_is_named_with_a_remedy(tmp_path: Path) -> None:
    (tmp_path / "one.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(9000))
    (tmp_path / "two.mcap").write_bytes(ros_bag("ros2"))
    with closing(sqlite3.connect(tmp_path / "two.db3")) as database:
        database.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT)")
        database.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, data BLOB)")
        database.commit()
    for name in ("one.bag", "two.mcap", "two.db3"):
        with pytest.raises(RecordingError, match=r"ROS( 1| 2)? bag: .*--replay") as failure:
            open_recording(tmp_path / name)
        assert "\n" not in str(failure.value)
    (tmp_path / "other.mcap").write_bytes(ros_bag("other"))
    open_recording(tmp_path / "other.mcap").close()


def test_a_recording_cut_by_a_kill_becomes_one_for_every_reader(
    tmp_path: Path, written: Written
) -> None:
    cut, whole = tmp_path / "cut.mcap", tmp_path / "whole.mcap"
    with RecordingWriter(tmp_path / "open.mcap") as writer:
        links: dict[str, int] = {}
        for name, encoding, stamp_ns, data in written.rows[:71]:
            links[name] = links.get(name) or writer.add_link(name, encoding)
            writer.write(links[name], data, stamp_ns)
        cut.write_bytes(writer.path.read_bytes())
    with cut.open("rb") as file, pytest.raises(McapError):
        list(make_reader(file).iter_messages())
    convert(cut, whole)
    with whole.open("rb") as file:
        messages = [message.data for _, _, message in make_reader(file).iter_messages()]
    assert messages == [row[3] for row in written.rows[:71]]


def test_what_is_no_file_is_reported(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no such file"):
        open_recording(tmp_path / "missing")
    with pytest.raises(RecordingError, match="is a directory"):
        open_recording(tmp_path)
    with pytest.raises(RecordingError, match=r"no such file|cannot be opened"):
        open_recording("a\0b")
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(RecordingError, match="not a regular file"):
        open_recording(tmp_path / "pipe")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_what_may_not_be_read_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "secret"
    path.write_bytes(b"x")
    path.chmod(0)
    with pytest.raises(RecordingError, match="permission denied"):
        open_recording(path)
