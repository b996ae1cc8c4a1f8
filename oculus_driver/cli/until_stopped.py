"""Run something that goes on until somebody stops it."""

from __future__ import annotations

import asyncio
import contextlib
import signal
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Coroutine

STOPS = (signal.SIGINT, signal.SIGTERM)


def run_until_stopped(work: Coroutine[None, None, None], limit_s: float | None = None) -> None:
    """Run to the end, to the time limit, or to SIGINT or SIGTERM; all of them are a good end."""

    async def limited() -> None:
        task = asyncio.current_task()
        stopped = False

        def stop() -> None:
            nonlocal stopped
            stopped = True
            if task is not None:
                task.cancel()

        loop = asyncio.get_running_loop()
        for number in STOPS:
            loop.add_signal_handler(number, stop)
        try:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(limit_s):
                    await work
        except asyncio.CancelledError:
            if not stopped:
                raise
        finally:
            for number in STOPS:
                loop.remove_signal_handler(number)

    asyncio.run(limited())
