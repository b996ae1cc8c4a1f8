"""Output of commands, as text or as JSON lines, and running until a signal."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import os
import signal
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Coroutine, Mapping

    from oculus_driver.command_line import ExitCode


def discard_stdout() -> None:
    """Discard all further and buffered output."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class Output:
    """Writes results to standard output and failures to standard error.

    Attributes:
        as_json: write fields instead of text.
        keep_running: continue without output if standard output is closed: a recording is more
            important than its output.
    """

    def __init__(self, *, as_json: bool) -> None:
        self.as_json = as_json
        self.keep_running = False

    def report(self, fields: Mapping[str, Any], text: str) -> None:
        """Write one result: `fields` as a line of JSON, or `text`, which may have several lines."""
        line = json.dumps(_plain(fields), allow_nan=False) if self.as_json else text
        try:
            sys.stdout.write(line + "\n")
            sys.stdout.flush()
        except OSError as error:
            if not self.keep_running:
                raise
            discard_stdout()
            self.note(f"oculus: standard output failed ({error}): continuing without it")

    def note(self, text: str) -> None:
        """Write a message for the user; never mixed with results."""
        with contextlib.suppress(OSError):
            sys.stderr.write(text + "\n")
            sys.stderr.flush()

    def failure(self, error: object, code: ExitCode) -> ExitCode:
        """Report why the command ends, and return its exit code."""
        if self.as_json:
            self.report({"error": str(error)}, "")
        self.note(f"oculus: {error}")
        return code


def _plain(value: Any) -> Any:  # noqa: ANN401 - values of any type
    """Convert to types of JSON; NaN and infinities become null."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        items = sorted(value) if isinstance(value, (set, frozenset)) else value
        return [_plain(item) for item in items]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, (bool, int)):
        return value
    return str(value)


STOPS = (signal.SIGINT, signal.SIGTERM)


def run_until_stopped(work: Coroutine[None, None, None], limit_s: float | None = None) -> None:
    """Run to the end, the time limit, SIGINT or SIGTERM; none of these is a failure."""

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
