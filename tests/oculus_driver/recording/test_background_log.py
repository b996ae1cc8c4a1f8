"""A log that never holds up an event loop."""

from __future__ import annotations

import asyncio
import errno
import os
import threading
from typing import TYPE_CHECKING

import pytest

from oculus_driver.encode import encode_status
from oculus_driver.recording import BackgroundLog, LogPolicy, SonarLog, describe, open_recording
from oculus_driver.stream import MessageBounds, StreamParser

if TYPE_CHECKING:
    from pathlib import Path

    from oculus_driver.recording import RecordingInfo
    from tests.oculus_driver.conftest import MakePing

POLICY = LogPolicy(free_floor_bytes=0, sync_interval_ns=None)


class SlowLog(SonarLog):
    """A log whose disk waits until it is let go."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, POLICY)
        self.busy = threading.Event()
        self.go = threading.Event()

    def write(
        self, data: bytes, arrival_ns: int, bounds: MessageBounds, *, gap_before: bool = False
    ) -> bool:
        self.busy.set()
        assert self.go.wait(30)
        return super().write(data, arrival_ns, bounds, gap_before=gap_before)


def whole(data: bytes | bytearray) -> MessageBounds:
    """Return the boundaries of whole messages."""
    return MessageBounds(0, len(data))


def described(folder: Path) -> RecordingInfo:
    (path,) = folder.iterdir()
    with open_recording(path) as recording:
        return describe(recording)


def test_everything_given_is_in_the_file_when_the_block_is_left(
    tmp_path: Path, make_ping: MakePing
) -> None:
    async def run() -> None:
        async with BackgroundLog(SonarLog(tmp_path, POLICY)) as log:
            buffer = bytearray(len(make_ping()))
            for index in range(200):
                buffer[:] = make_ping(ping_id=index)  # a reader may use its buffer again
                assert log.write(buffer, index, whole(buffer))
            assert log.write_status(encode_status(device_id=1), 300)

    asyncio.run(run())
    info = described(tmp_path)
    assert [ping.id for ping in info.ping_list] == list(range(200))
    assert info.statuses == 1


def test_a_disk_that_hangs_costs_the_newest_bytes_and_the_loop_goes_on(
    tmp_path: Path, make_ping: MakePing
) -> None:
    slow = SlowLog(tmp_path)
    ping = make_ping()

    async def run() -> int:
        async with BackgroundLog(slow, max_waiting_bytes=3 * len(ping)) as log:
            log.write(ping, 0, whole(ping))
            assert await asyncio.to_thread(slow.busy.wait, 30)
            cut = [make_ping(ping_id=8 + index)[:2000] for index in range(20)]
            taken = [log.write(data, n, MessageBounds(0, 0)) for n, data in enumerate(cut)]
            assert taken == [True] * taken.count(True) + [False] * taken.count(False)
            assert log.waiting_bytes <= 3 * len(ping)
            slow.go.set()
            while log.waiting_bytes:  # noqa: ASYNC110 - the thread has no event to give
                await asyncio.sleep(0)
            last = make_ping(ping_id=99)
            assert log.write(last, 50, whole(last))
            assert log.bytes_dropped == 2000 * taken.count(False)
            return log.bytes_dropped

    assert asyncio.run(run()) > 0
    info = described(tmp_path)
    assert info.ping_list[0].id == 7
    assert (info.ping_list[-1].id, info.faults, info.link_losses) == (99, 0, 1)  # the gap


def test_what_goes_wrong_in_the_thread_is_raised_when_the_block_is_left(
    tmp_path: Path, make_ping: MakePing
) -> None:
    class BadLog(SonarLog):
        def write(
            self, data: bytes, arrival_ns: int, bounds: MessageBounds, *, gap_before: bool = False
        ) -> bool:
            del data, arrival_ns, bounds, gap_before
            raise ValueError("bad log")

    async def run() -> None:
        async with BackgroundLog(BadLog(tmp_path, POLICY)) as log:
            assert log.write(make_ping(), 0, whole(make_ping()))

    with pytest.raises(ValueError, match="bad log"):
        asyncio.run(run())


FLOOR = LogPolicy(free_floor_bytes=10 << 20, sync_interval_ns=None, retry_ns=0)


class FullDisk:
    """A disk that is full until somebody makes room."""

    def __init__(self) -> None:
        self.free = 0

    def __call__(self, _: Path) -> int:
        return self.free


def holding(folder: Path, disk: FullDisk) -> SonarLog:
    return SonarLog(folder, FLOOR, others={"vehicle": "native"}, free_bytes=disk, hold=True)


@pytest.mark.slow
def test_what_comes_while_the_disk_is_full_is_written_when_there_is_room(
    tmp_path: Path, make_ping: MakePing
) -> None:
    disk = FullDisk()

    async def run() -> None:
        log = holding(tmp_path, disk)
        async with BackgroundLog(log) as background:
            for index in range(50):
                ping = make_ping(ping_id=index)
                assert background.write(ping, index, whole(ping))
                assert background.write_other("vehicle", b"x", index)
            assert not background.wait_for(1, 0.05)
            assert log.state == "paused"
            assert background.position_of(1) is None
            disk.free = 1 << 30
            assert await asyncio.to_thread(background.wait_for, 100, 30)
            assert background.position_of(60) == (1, 60)
        assert log.counters.bytes_dropped == background.bytes_dropped == 0

    asyncio.run(run())
    info = described(tmp_path)
    assert [ping.id for ping in info.ping_list] == list(range(50))
    assert info.damage is None


def test_waiting_for_a_piece_flushes_it_to_the_disk(
    tmp_path: Path, make_ping: MakePing, monkeypatch: pytest.MonkeyPatch
) -> None:
    flushed = 0  # bytes

    def flush(file: int) -> None:
        nonlocal flushed
        flushed = os.fstat(file).st_size

    monkeypatch.setattr(os, "fdatasync", flush)
    ping = make_ping()

    async def run() -> None:
        async with BackgroundLog(SonarLog(tmp_path, POLICY)) as log:
            for number in range(1, 4):
                log.write(ping, number, whole(ping))
                assert await asyncio.to_thread(log.wait_for, number, 30)
                assert log.synced >= number
                assert flushed > number * len(ping)

    asyncio.run(run())


def test_a_disk_that_cannot_flush_pauses_the_log(
    tmp_path: Path, make_ping: MakePing, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: int) -> None:
        raise OSError(errno.EIO, "the disk failed")

    monkeypatch.setattr(os, "fdatasync", fail)
    ping = make_ping()

    async def run() -> None:
        log = SonarLog(tmp_path, POLICY)
        async with BackgroundLog(log) as background:
            background.write(ping, 1, whole(ping))
            assert not await asyncio.to_thread(background.wait_for, 1, 0.2)
            assert (log.state, background.synced) == ("paused", 0)

    asyncio.run(run())


def test_what_cannot_be_held_any_more_is_counted_and_leaves_a_gap(
    tmp_path: Path, make_ping: MakePing
) -> None:
    disk = FullDisk()
    size = len(make_ping())

    async def run() -> None:
        async with BackgroundLog(holding(tmp_path, disk), max_waiting_bytes=5 * size) as log:
            pings = [make_ping(ping_id=index) for index in range(21)]
            taken = [log.write(pings[k], k, whole(pings[k])) for k in range(20)]
            assert log.bytes_dropped == size * taken.count(False) > 0
            disk.free = 1 << 30
            assert await asyncio.to_thread(log.wait_for, taken.index(False), 30)
            assert log.write(pings[20], 20, whole(pings[20]))

    asyncio.run(run())
    (path,) = tmp_path.iterdir()
    with open_recording(path) as recording:
        assert [chunk.gap_before for chunk in recording][-1]


def test_a_disk_that_stays_full_does_not_hold_up_the_end(
    tmp_path: Path, make_ping: MakePing
) -> None:
    log = holding(tmp_path, FullDisk())

    async def run() -> None:
        async with BackgroundLog(log) as background:
            for index in range(3):
                ping = make_ping(ping_id=index)
                background.write(ping, index, whole(ping))

    asyncio.run(run())
    assert log.counters.drops["free_space"] == 3
    assert log.counters.bytes_dropped == 3 * len(make_ping())
    assert list(tmp_path.iterdir()) == []


def test_places_state_where_to_read_on(tmp_path: Path, make_ping: MakePing) -> None:
    policy = LogPolicy(max_file_bytes=1 << 20, free_floor_bytes=0, sync_interval_ns=None)
    ping = make_ping()
    pieces = [ping[k : k + 700] for k in range(0, len(ping), 700)]
    offered: list[bytes] = []
    parser = StreamParser()

    async def run() -> list[tuple[int, int]]:
        async with BackgroundLog(SonarLog(tmp_path, policy)) as log:
            while len(offered) < 2_500_000 // len(ping) * len(pieces):
                offered.append(pieces[len(offered) % len(pieces)])
                messages = parser.feed(offered[-1])
                bounds = parser.bounds(messages, len(offered[-1]))
                log.write(offered[-1], len(offered), bounds)
            assert await asyncio.to_thread(log.wait_for, len(offered), 30)
            places = [log.position_of(number) for number in range(1, len(offered) + 1)]
            return [place for place in places if place is not None]

    places = asyncio.run(run())
    assert len(places) == len(offered)
    files: list[list[bytes]] = []
    for path in sorted(tmp_path.iterdir()):
        with open_recording(path) as recording:
            files.append([chunk.data for chunk in recording])
    assert len(files) == 3
    for number in range(0, len(offered), 97):
        file, messages = places[number]
        rest = [*files[file - 1][messages:], *(data for more in files[file:] for data in more)]
        assert b"".join(rest) == b"".join(offered[number + 1 :])
