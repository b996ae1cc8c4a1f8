import asyncio
import contextlib
from contextlib import closing
from pathlib import Path

import pytest

from mapperd.daemon import run as daemon_run
from mapperd.export.trajectory import TrajectoryWriter
from tests.support.process import resident_bytes


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
