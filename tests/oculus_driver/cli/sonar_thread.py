"""A played sonar in a thread of its own, for commands that run in the foreground."""

from __future__ import annotations

import asyncio
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from oculus_driver import PlaybackSonar
from tests.support.process import free_port

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@contextmanager
def played(path: Path, **values: Any) -> Iterator[tuple[PlaybackSonar, int]]:
    """A sonar in a thread of its own, and the port that it sends statuses to."""
    status_port = free_port()
    ready, stop = threading.Event(), asyncio.Event()
    made: list[tuple[PlaybackSonar, asyncio.AbstractEventLoop]] = []

    async def work() -> None:
        options = {"loops": None, "status_period_s": 0.05, "dummy_period_s": 0.05} | values
        async with PlaybackSonar(path, status_to=[("127.0.0.1", status_port)], **options) as sonar:
            made.append((sonar, asyncio.get_running_loop()))
            ready.set()
            await stop.wait()

    thread = threading.Thread(target=asyncio.run, args=(work(),))
    thread.start()
    assert ready.wait(20.0)
    try:
        yield made[0][0], status_port
    finally:
        made[0][1].call_soon_threadsafe(stop.set)
        thread.join(20.0)
