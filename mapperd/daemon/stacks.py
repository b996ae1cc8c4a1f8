"""What every thread and task does at this moment, for whoever looks for what hangs."""

import asyncio
import io
import sys
import threading
import traceback
from collections.abc import Iterator

__all__ = ["stack_lines"]


def stack_lines() -> Iterator[str]:
    """Lines about the threads, then about the tasks of the running loop."""
    frames = sys._current_frames()  # noqa: SLF001 the documented way to the other threads
    for thread in threading.enumerate():
        frame = frames.get(thread.ident or 0)
        if frame is not None:
            yield f"thread {thread.name}"
            for line in traceback.format_stack(frame):
                yield from line.rstrip().splitlines()
    for task in asyncio.all_tasks():
        text = io.StringIO()
        task.print_stack(file=text)
        yield from text.getvalue().rstrip().splitlines()
