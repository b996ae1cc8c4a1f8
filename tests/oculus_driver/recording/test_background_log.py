"""A log that never holds up an event loop."""

from __future__ import annotations

import asyncio
import threading
from typing import TYPE_CHECKING

import pytest

from oculus_driver.encode import encode_status
from oculus_driver.recording import BackgroundLog, LogPolicy, SonarLog, describe, open_recording

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

    def write(self, data: bytes, arrival_ns: int, *, gap_before: bool = False) -> bool:
        self.busy.set()
        assert self.go.wait(30)
        return super().write(data, arrival_ns, gap_before=gap_before)


def described(folder: Path) -> RecordingInfo:
    (path,) = folder.iterdir()
    with open_recording(path) as recording:
        return describe(recording)


def test_everything_given_is_in_the_file_when_the_block_is_left(
    tmp_path: Path, make_ping: MakePing
) -> None:
    async def run() -> None:
        async with BackgroundLog(SonarLog(tmp_path, POLICY)) as log:
            for index in range(200):
                assert log.write(make_ping(ping_id=index), index)
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
            log.write(ping, 0)
            assert await asyncio.to_thread(slow.busy.wait, 30)
            taken = [log.write(make_ping(ping_id=8 + index)[:2000], index) for index in range(20)]
            assert taken == [True] * taken.count(True) + [False] * taken.count(False)
            assert log.waiting_bytes <= 3 * len(ping)
            slow.go.set()
            while log.waiting_bytes:  # noqa: ASYNC110 - the thread has no event to give
                await asyncio.sleep(0)
            assert log.write(make_ping(ping_id=99), 50)
            assert log.bytes_dropped == 2000 * taken.count(False)
            return log.bytes_dropped

    assert asyncio.run(run()) > 0
    info = described(tmp_path)
    assert info.ping_list[0].id == 7
    assert info.ping_list[-1].id == 99  # the gap is noted: its beginning is not taken for a rest


def test_what_goes_wrong_in_the_thread_is_raised_when_the_block_is_left(
    tmp_path: Path, make_ping: MakePing
) -> None:
    class BadLog(SonarLog):
        def write(self, data: bytes, arrival_ns: int, *, gap_before: bool = False) -> bool:
            del data, arrival_ns, gap_before
            raise ValueError("bad log")

    async def run() -> None:
        async with BackgroundLog(BadLog(tmp_path, POLICY)) as log:
            assert log.write(make_ping(), 0)

    with pytest.raises(ValueError, match="bad log"):
        asyncio.run(run())
