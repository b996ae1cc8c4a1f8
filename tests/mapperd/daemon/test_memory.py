import asyncio
import contextlib
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

from mapperd.daemon import run as daemon_run
from mapperd.export.trajectory import TrajectoryWriter
from tests.support.process import resident_bytes

HOLDS = """
from mapperd.daemon.run import keep_large_pieces_apart
from tests.support.process import resident_bytes
keep_large_pieces_apart()
small, large = [], []
for _ in range(3):  # the first large pieces that are freed teach glibc to keep such ones
    large = [bytes([n % 251]) * 400_000 for n in range(250)]
    before = resident_bytes()
    large = [piece for piece in large if not small.append(bytes(piece[:3000]))]
    large.clear()
print(before - resident_bytes())
"""


def test_large_pieces_return_to_the_system_at_once() -> None:
    command = [sys.executable, "-c", HOLDS]
    done = subprocess.run(command, check=True, capture_output=True, text=True)  # noqa: S603
    assert int(done.stdout) > 90_000_000


def test_free_memory_between_used_pieces_is_returned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(daemon_run, "STATUS_PERIOD_S", 0.0)
    pieces = [bytes([n % 251]) * 40_000 for n in range(2500)]  # 100 MB, with what stays between
    kept = pieces[::50]
    before = resident_bytes()
    del pieces

    async def until_returned() -> None:
        while resident_bytes() > before - 80_000_000:  # noqa: ASYNC110 nothing tells
            await asyncio.sleep(0.01)

    async def run() -> None:
        with closing(TrajectoryWriter(tmp_path)) as trajectory:
            freeing = asyncio.create_task(daemon_run.free_memory(trajectory))
            async with asyncio.timeout(20):
                await until_returned()
            freeing.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await freeing

    asyncio.run(run())
    assert len(kept) == 50
