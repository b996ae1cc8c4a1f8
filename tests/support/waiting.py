"""Coroutines with a time limit, and waiting for what has no event."""

import asyncio
import time
from collections.abc import Callable, Coroutine
from typing import Any

LIMIT_S = 60.0
POLL_S = 0.005


async def until(holds: Callable[[], object], within_s: float = LIMIT_S) -> None:
    """Wait until a condition holds that another task, thread or process brings about."""
    end_s = time.monotonic() + within_s
    while not holds():
        assert time.monotonic() < end_s, f"it did not come about within {within_s:g} s"
        await asyncio.sleep(POLL_S)


def run(
    work: Coroutine[Any, Any, None], within_s: float = LIMIT_S, *, nothing_left: bool = False
) -> None:
    """Run a coroutine in a new event loop.

    Args:
        work: the coroutine.
        within_s: time limit.
        nothing_left: debug the loop, and require that no task of it is left over.
    """

    async def limited() -> None:
        async with asyncio.timeout(within_s):
            await work
        if nothing_left:
            assert asyncio.all_tasks() == {asyncio.current_task()}

    asyncio.run(limited(), debug=nothing_left or None)
