"""A progress bar of one line: how far, how fast, how long yet."""

import contextlib
from collections.abc import Callable
from typing import TextIO

__all__ = ["ProgressBar"]

WIDTH = 28
TTY_PERIOD_S = 0.1
LOG_PERIOD_S = 5.0
"""Period of progress lines where the output is not a terminal."""


class ProgressBar:
    """Draws itself on a terminal, or writes a line every few seconds elsewhere.

    tqdm counts one unit and writes no lines for a journal; this bar is filled by bytes read, counts
    pings and needs no further package on a vehicle.

    Args:
        out: where to, stderr as a rule.
        clock: seconds.
        name: what lines begin with where there is no terminal.
        unit: what is counted.
    """

    def __init__(
        self,
        out: TextIO,
        clock: Callable[[], float],
        name: str = "mapperd",
        unit: str = "pings",
    ) -> None:
        self._out = out
        self._name = name
        self._unit = unit
        self._clock = clock
        self._tty = out.isatty()
        self._began_s = clock()
        self._shown_s = self._began_s

    def show(self, fraction: float, count: int) -> None:
        """Draw, if it is time to.

        Args:
            fraction: of the work that is done, 0..1.
            count: of pings mapped so far, or of another unit.
        """
        now_s = self._clock()
        if now_s - self._shown_s >= (TTY_PERIOD_S if self._tty else LOG_PERIOD_S):
            self._shown_s = now_s
            self._draw(fraction, count, now_s - self._began_s)

    def close(self, count: int) -> None:
        """Draw the end state and leave the line."""
        if self._tty:
            self._draw(1.0, count, self._clock() - self._began_s)
            self._write("\n")

    def _draw(self, fraction: float, count: int, elapsed_s: float) -> None:
        done = min(max(fraction, 0.0), 1.0)
        rate = count / elapsed_s if elapsed_s > 0 else 0.0
        left = _time(elapsed_s * (1 - done) / done) if done > 0 else "?"
        unit = self._unit
        text = f"{100 * done:5.1f} %  {count} {unit}  {rate:.1f} {unit}/s  {left} left"
        if self._tty:
            bar = "#" * round(WIDTH * done)
            self._write(f"\r[{bar:<{WIDTH}}] {text}\x1b[K")
        else:
            self._write(f"{self._name}: {text}\n")

    def _write(self, text: str) -> None:
        with contextlib.suppress(OSError):  # output closed: not a reason to stop the work
            self._out.write(text)
            self._out.flush()


def _time(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
