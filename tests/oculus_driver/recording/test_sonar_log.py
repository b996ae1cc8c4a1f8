"""A log of a sonar on a disk that fills, fails and comes back."""

from __future__ import annotations

import errno
import os
from typing import TYPE_CHECKING

import numpy as np
import pytest

from oculus_driver.encode import encode_dummy, encode_status
from oculus_driver.errors import RecordingError
from oculus_driver.recording import LogPolicy, SonarLog, describe, open_recording
from oculus_driver.recording.log_files import MIB
from oculus_driver.stream import MessageBounds, StreamParser

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from oculus_driver.recording import RecordingInfo
    from tests.oculus_driver.conftest import MakePing

SECOND = 10**9
UNIX_NS = 1_790_000_000 * SECOND
SMALL = LogPolicy(max_file_bytes=MIB, free_floor_bytes=0, sync_interval_ns=None)


def described(path: Path) -> RecordingInfo:
    with open_recording(path) as recording:
        return describe(recording)


def everything(folder: Path) -> list[RecordingInfo]:
    return [described(path) for path in sorted(folder.iterdir())]


def ids(infos: list[RecordingInfo]) -> list[int]:
    return [ping.id for info in infos for ping in info.ping_list]


def pieces(stream: bytes, seed: int = 2) -> Iterator[bytes]:
    """Yield a stream in pieces that know nothing of messages."""
    rng = np.random.default_rng(seed)
    start = 0
    while start < len(stream):
        size = int(rng.integers(1, 60_000))
        yield stream[start : start + size]
        start += size


def writer_of(log: SonarLog) -> Callable[[bytes, int], bool]:
    """Return a function that writes pieces with their message boundaries, as the driver does."""
    parser = StreamParser()

    def write(data: bytes, arrival_ns: int) -> bool:
        messages = parser.feed(data, arrival_ns)
        return log.write(data, arrival_ns, parser.bounds(messages, len(data)))

    return write


@pytest.fixture(scope="module")
def stream(make_ping: MakePing) -> bytes:
    return b"".join(make_ping(ping_id=i, rows=300, beams=512) for i in range(40))


def test_a_log_is_rotated_by_size_between_messages(tmp_path: Path, stream: bytes) -> None:
    with SonarLog(tmp_path, SMALL, monotonic_to_unix_ns=UNIX_NS) as log:
        write = writer_of(log)
        assert log.state == "waiting"
        for index, piece in enumerate(pieces(stream)):
            assert write(piece, index * 1000)
        assert log.state == "logging"
        assert log.path is not None
    infos = everything(tmp_path)
    assert ids(infos) == list(range(40))
    assert all(info.bytes_rejected == 0 and info.damage is None for info in infos)
    assert sum(info.bytes_total for info in infos) == len(stream) == log.counters.bytes_written
    assert log.counters.rotations == {"size": len(infos) - 1}
    assert all(MIB <= info.size_bytes < 1.4 * MIB for info in infos[:-1])
    assert infos[0].start_ns == UNIX_NS
    names = [path.name for path in sorted(tmp_path.iterdir())]
    assert names[:2] == [
        "sonar_000001_20260921T141320Z.mcap",
        "sonar_000002_20260921T141320Z.mcap",
    ]


def test_a_log_is_rotated_by_time_also_while_nothing_comes(
    tmp_path: Path, make_ping: MakePing
) -> None:
    policy = LogPolicy(max_file_ns=10 * SECOND, free_floor_bytes=0)
    ping = make_ping()
    with SonarLog(tmp_path, policy) as log:
        write = writer_of(log)
        write(ping + ping[:100], SECOND)
        log.tick(11 * SECOND)
        assert log.path is not None  # in the middle of a message
        write(ping[100:], 12 * SECOND)
        assert log.path is None
        write(encode_dummy(), 13 * SECOND)
        log.tick(22 * SECOND)
        assert log.path is not None
        log.tick(23 * SECOND)
        assert log.path is None
    assert log.counters.rotations == {"time": 2}
    assert [info.messages for info in everything(tmp_path)] == [2, 1]


def test_a_clock_that_is_set_later_starts_a_file_that_records_the_change(
    tmp_path: Path, make_ping: MakePing
) -> None:
    offset_ns = [UNIX_NS]
    ping = make_ping()
    with SonarLog(tmp_path, SMALL, monotonic_to_unix_ns=lambda: offset_ns[0]) as log:
        write = writer_of(log)
        for second in range(10):
            if second == 3:
                offset_ns[0] += 3600 * SECOND
            if second == 6:
                offset_ns[0] += SECOND // 10  # a clock that drifts
            write(ping[:500], second * SECOND)
            write(ping[500:], second * SECOND + 1)
    first, second_file = everything(tmp_path)
    assert log.counters.rotations == {"clock": 1}
    assert (first.pings, second_file.pings) == (4, 6)  # a file ends with a message
    assert (first.start_ns, first.end_ns) == (UNIX_NS, UNIX_NS + 3 * SECOND + 1)
    assert second_file.start_ns == UNIX_NS + 3604 * SECOND
    assert second_file.metadata["clock_change_ns"] == str(3600 * SECOND)
    assert "clock_change_ns" not in first.metadata


def test_statuses_are_recorded_beside_the_stream(tmp_path: Path, make_ping: MakePing) -> None:
    with SonarLog(tmp_path, SMALL, prefix="m750d", metadata={"site": "quay"}) as log:
        write = writer_of(log)
        assert log.write_status(encode_status(device_id=5), 1)
        assert write(make_ping(), 2)
    (info,) = everything(tmp_path)
    assert (info.statuses, info.pings, info.metadata["site"]) == (1, 1, "quay")


def test_the_oldest_files_go_and_the_budget_holds(tmp_path: Path, stream: bytes) -> None:
    foreign = tmp_path / "sonar_notes.mcap"
    foreign.write_bytes(b"mine")
    (tmp_path / "sonar_000009_20260921T141320Z.mcap").mkdir()
    policy = LogPolicy(
        max_file_bytes=MIB, budget_bytes=4 * MIB, free_floor_bytes=0, sync_interval_ns=None
    )
    used = 0
    with SonarLog(tmp_path, policy) as log:
        write = writer_of(log)
        for index, piece in enumerate(pieces(stream)):
            assert write(piece, index)
            used = max(
                used,
                sum(path.stat().st_size for path in tmp_path.glob("*Z.mcap") if path.is_file()),
            )
    assert 2.5 * MIB < used <= 4 * MIB + 4
    assert log.counters.files_deleted >= 2
    assert foreign.read_bytes() == b"mine"
    foreign.unlink()
    (tmp_path / "sonar_000009_20260921T141320Z.mcap").rmdir()
    assert max(path.name for path in tmp_path.iterdir()) < "sonar_000009"
    kept = ids(everything(tmp_path))
    assert kept == list(range(40 - len(kept), 40))
    assert log.counters.bytes_dropped == 0


def test_files_of_earlier_runs_count_and_go_first(tmp_path: Path, stream: bytes) -> None:
    policy = LogPolicy(
        max_file_bytes=MIB, budget_bytes=4 * MIB, free_floor_bytes=0, sync_interval_ns=None
    )
    for turn in range(3):
        with SonarLog(tmp_path, policy) as log:
            write = writer_of(log)
            for piece in pieces(stream[: len(stream) // 3]):
                assert write(piece, turn)
    sizes = [path.stat().st_size for path in tmp_path.iterdir()]
    assert 2 * MIB < sum(sizes) <= 4 * MIB
    assert min(path.name for path in tmp_path.iterdir()) > "sonar_000003"


def test_a_log_goes_on_where_another_stopped(tmp_path: Path, make_ping: MakePing) -> None:
    for number in range(3):
        with SonarLog(tmp_path, SMALL, monotonic_to_unix_ns=-number) as log:  # clock set back
            write = writer_of(log)
            write(make_ping(ping_id=number), 5 * SECOND)
    paths = sorted(tmp_path.iterdir())
    assert [path.name[:12] for path in paths] == ["sonar_000001", "sonar_000002", "sonar_000003"]
    assert ids(everything(tmp_path)) == [0, 1, 2]


def test_below_the_free_space_floor_nothing_is_written_until_there_is_room(
    tmp_path: Path, make_ping: MakePing
) -> None:
    free = [100 * MIB]
    policy = LogPolicy(free_floor_bytes=50 * MIB, sync_interval_ns=None, retry_ns=5 * SECOND)
    pings = [make_ping(ping_id=index) for index in range(7)]
    with SonarLog(tmp_path, policy, free_bytes=lambda _: free[0]) as log:
        write = writer_of(log)
        assert write(pings[0] + pings[1][:500], 0)
        free[0] = 50 * MIB + MIB // 2  # no room for the index
        assert not write(pings[1][500:] + pings[2][:500], 2 * SECOND)
        assert (log.state, log.reason) == ("paused", "free_space")
        free[0] = 100 * MIB
        assert not write(pings[2][500:] + pings[3] + pings[4][:300], 4 * SECOND)  # too early
        assert not write(pings[4][300:400], 8 * SECOND)  # the middle of a message
        assert not write(pings[4][400:] + pings[5][:50], 9 * SECOND)
        assert (log.state, log.reason) == ("logging", None)
        assert write(pings[5][50:] + pings[6], 10 * SECOND)
    (info,) = everything(tmp_path)
    assert ids([info]) == [0, 5, 6]
    # The part of ping 1, not joined with what followed:
    assert (info.rejects, info.bytes_rejected) == ({"truncated": 1}, 500)
    assert log.counters.drops == {"free_space": 2, "resuming": 3}
    total = len(b"".join(pings))
    assert log.counters.bytes_written + log.counters.bytes_dropped == total


def test_a_disk_that_fails_costs_bytes_and_never_raises(
    tmp_path: Path, stream: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    os_write = os.pwrite
    broken = [False]

    def faulty(file: int, data: bytes, offset: int) -> int:
        if broken[0]:
            raise OSError(errno.EIO, "Input/output error")
        return os_write(file, data, offset)

    monkeypatch.setattr(os, "pwrite", faulty)
    with SonarLog(tmp_path, SMALL) as log:
        write = writer_of(log)
        for index, piece in enumerate(pieces(stream)):
            broken[0] = 20 <= index < 40
            write(piece, index * SECOND // 4)
            if broken[0]:
                assert log.state == "paused"
                assert log.reason is not None
                assert "Input/output error" in log.reason
        assert log.state == "logging"
    assert log.counters.drops["disk"] >= 5
    assert log.counters.rotations["failure"] >= 1
    assert log.counters.bytes_written + log.counters.bytes_dropped == len(stream)
    paths = [path for path in sorted(tmp_path.iterdir()) if path.stat().st_size]
    found = ids([described(path) for path in paths])
    assert found == sorted(set(found))
    assert len(found) >= 15
    assert found[-1] == 39


def test_a_file_that_cannot_be_created_leaves_no_hole_in_the_numbers(
    tmp_path: Path, stream: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    os_open, full = os.open, [True]

    def faulty(path: Path, flags: int, *rest: int, **more: int) -> int:
        if full[0] and flags & os.O_CREAT:
            raise OSError(errno.ENOSPC, "No space left on device")
        return os_open(path, flags, *rest, **more)

    monkeypatch.setattr(os, "open", faulty)
    with SonarLog(tmp_path, SMALL) as log:
        write = writer_of(log)
        for index, piece in enumerate(pieces(stream)):
            full[0] = index < 20
            write(piece, index * SECOND)
    assert min(path.name.split("_")[1] for path in tmp_path.iterdir()) == "000001"


def test_a_folder_that_vanishes_is_reported_and_nothing_raised(
    tmp_path: Path, make_ping: MakePing
) -> None:
    folder = tmp_path / "log"
    log = SonarLog(folder, SMALL)
    write = writer_of(log)
    folder.rmdir()
    assert not write(make_ping(), 0)
    assert log.state == "paused"
    assert log.reason is not None
    folder.mkdir()
    assert write(make_ping(ping_id=8), 2 * SECOND)
    log.close()
    assert ids(everything(folder)) == [8]


def test_data_are_brought_to_the_disk_as_often_as_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[int] = []
    names: list[int] = []
    monkeypatch.setattr(os, "fdatasync", synced.append)
    monkeypatch.setattr(os, "fsync", names.append)
    for interval, expected in ((0, 10), (3 * SECOND, 3), (None, 0)):
        policy = LogPolicy(free_floor_bytes=0, sync_interval_ns=interval)
        log = SonarLog(tmp_path, policy)
        write = writer_of(log)
        for second in range(10):
            write(encode_dummy(), second * SECOND)
        assert log.counters.syncs == len(synced) == expected
        log.close()
        assert len(synced) == expected + (interval is not None)
        assert len(names) == (interval is not None)  # the new file's name
        synced.clear()
        names.clear()


def test_a_log_that_is_killed_holds_what_it_was_given(tmp_path: Path, make_ping: MakePing) -> None:
    log = SonarLog(tmp_path, SMALL)
    write = writer_of(log)
    write(make_ping() + make_ping(ping_id=8), 1)
    (info,) = everything(tmp_path)  # not closed
    assert ids([info]) == [7, 8]
    log.close()


def test_a_name_that_is_no_name_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="letters"):
        SonarLog(tmp_path, prefix="../x")
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(RecordingError, match="folder"):
        SonarLog(tmp_path / "file")


@pytest.mark.parametrize("cause", ["write", "sync"])
def test_a_file_closed_by_a_failure_is_flushed_before_its_data_count_as_synced(
    tmp_path: Path, stream: bytes, monkeypatch: pytest.MonkeyPatch, cause: str
) -> None:
    synced: list[int] = []
    broken = {"write": False, "sync": False}
    os_write, os_sync = os.pwrite, os.fdatasync

    def write(file: int, data: bytes, offset: int) -> int:
        if broken["write"]:
            raise OSError(errno.ENOSPC, "No space left on device")
        return os_write(file, data, offset)

    def sync(file: int) -> None:
        if broken["sync"]:
            raise OSError(errno.EIO, "Input/output error")
        os_sync(file)
        synced.append(os.fstat(file).st_ino)

    monkeypatch.setattr(os, "pwrite", write)
    monkeypatch.setattr(os, "fdatasync", sync)
    first, second, *_ = pieces(stream)
    whole = MessageBounds(0, 0)
    with SonarLog(tmp_path, SMALL) as log:
        log.write(first, 0, whole)
        assert log.path is not None
        inode = log.path.stat().st_ino
        broken[cause] = True
        if cause == "write":
            assert not log.write(second, SECOND, whole)
        assert log.sync(SECOND) is (cause == "write")
        broken[cause] = False
        assert log.sync(2 * SECOND)
        assert inode in synced
        synced.clear()
        assert log.sync(3 * SECOND)
        assert inode not in synced
