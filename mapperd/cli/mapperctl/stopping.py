"""How commands that go on and on are told to stop."""

import asyncio
import signal

__all__ = ["told_to_stop"]


async def told_to_stop() -> None:
    """Wait for SIGINT or SIGTERM, which do nothing else meanwhile."""
    loop = asyncio.get_running_loop()
    told = asyncio.Event()
    handled = []
    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            try:
                loop.add_signal_handler(number, told.set)
            except (NotImplementedError, RuntimeError, ValueError):  # a thread, or no Unix
                continue
            handled.append(number)
        await told.wait()
    finally:
        for number in handled:
            loop.remove_signal_handler(number)
