"""The daemon and its service manager: signals, readiness, signs of life."""

import asyncio
import contextlib
import io
import signal
import sys
import threading
import time
import traceback
from collections.abc import AsyncIterator, Callable, Coroutine, Iterable, Iterator, Mapping
from typing import Any

from mapperd.api import DaemonApi
from mapperd.daemon.systemd import EXTENSION_S, Notifier
from mapperd.errors import MapperdError
from mapperd.events import Severity
from mapperd.pipeline.watchdog import Watchdog, Worker

__all__ = [
    "StatusLine",
    "deferred_interrupt",
    "graceful_stop",
    "is_main_thread",
    "stack_lines",
    "supervised",
]

MIB = 1 << 20


class StatusLine:
    """Makes the line from the daemon's status; rates are those since the last line."""

    def __init__(self) -> None:
        self._before: tuple[float, int] | None = None

    def of(self, status: Mapping[str, Any], now_s: float) -> str:
        """The line.

        Args:
            status: as `DaemonApi.status` gives it.
            now_s: a clock that only goes forward.
        """
        pings: Mapping[str, Any] = status.get("pings") or {}
        mapped = int(pings.get("mapped", 0))
        parts = [str(status.get("activity") or status.get("phase", "running"))]
        if self._before is not None and now_s > self._before[0]:
            rate_hz = max(0, mapped - self._before[1]) / (now_s - self._before[0])
            parts.append(f"{rate_hz:.1f} pings/s")
        self._before = (now_s, mapped)
        parts.append(f"{mapped} mapped")
        dropped = sum((pings.get("dropped") or {}).values())
        if dropped:
            parts.append(f"{dropped} dropped")
        if link := (status.get("sonar") or {}).get("state"):
            parts.append(f"sonar {link}")
        memory_bytes = (status.get("map") or {}).get("memory_bytes")
        if memory_bytes is not None:
            parts.append(f"map {memory_bytes / MIB:.0f} MiB")
        return ", ".join(parts)


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


POLL_INTERVAL_S = 2.0
"""Between looks at how it goes; the watchdog's third where that is shorter."""

MIN_POLL_INTERVAL_S = 0.05
WATCHDOG_SHARE = 0.5
"""Of the watchdog's time: a worker may be silent so long before the manager is let to act."""

ASKING = (signal.SIGHUP, signal.SIGUSR1, signal.SIGUSR2)
ORIGINS = {signal.SIGHUP: "SIGHUP", signal.SIGUSR1: "SIGUSR1"}


@contextlib.contextmanager
def graceful_stop() -> Iterator[None]:
    """Ignore what asks for work while there is nobody who could do it: at the start and the end.

    Unheard, SIGHUP and the others would end the program, and systemd takes that for a clean end.
    """
    if not is_main_thread():  # signals are not its business
        yield
        return
    stops = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    before = {number: signal.signal(number, signal.SIG_IGN) for number in ASKING}
    try:
        yield
    finally:
        for number, action in (before | stops).items():
            signal.signal(number, action)


@contextlib.contextmanager
def deferred_interrupt() -> Iterator[None]:
    """Hold Ctrl-C back while short work runs, then raise KeyboardInterrupt; a second one at once.

    Libraries lose the exception in a callback of a weak reference, or make another one of it. An
    error of the work becomes the context of the KeyboardInterrupt. Where SIGINT has another
    handler, and in other threads, nothing changes.
    """
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler or not is_main_thread():
        yield
        return
    pressed: list[int] = []

    def press(number: int, _: object) -> None:
        if pressed:
            raise KeyboardInterrupt
        pressed.append(number)

    signal.signal(signal.SIGINT, press)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        if pressed:
            raise KeyboardInterrupt


def is_main_thread() -> bool:
    """Return whether this thread may set what signals do."""
    return threading.current_thread() is threading.main_thread()


@contextlib.asynccontextmanager
async def supervised(
    daemon: DaemonApi,
    workers: Callable[[], Iterable[Worker]],
    notifier: Notifier,
    *,
    watchdog_s: float | None,
    stop: Callable[[], None],
    abandon: Callable[[int], None] | None = None,
    print_line: Callable[[str], None],
) -> AsyncIterator[None]:
    """Report readiness, feed the watchdog while the daemon works, and handle signals; `async with`.

    SIGINT and SIGTERM stop, a second one at once; SIGHUP reads the settings again; SIGUSR1 brings
    the map to the disk; SIGUSR2 writes what every thread does.

    Args:
        daemon: works already: settings read, sockets bound, map loaded.
        workers: the daemon's threads, now.
        notifier: of the manager.
        watchdog_s: how long the manager waits for a sign of life; None where it does not.
        stop: makes the daemon end.
        abandon: ends the process at once, for the second of those signals, whose number it gets;
            None leaves that to Python.
        print_line: prints diagnostics of a hang.
    """
    session = _SupervisedTasks(daemon, workers, notifier, watchdog_s, print_line)
    loop = asyncio.get_running_loop()
    actions: dict[signal.Signals, Callable[[], None]] = {
        signal.SIGHUP: lambda: session.begin(session.reload()),
        signal.SIGUSR1: lambda: session.begin(session.snapshot()),
        signal.SIGUSR2: session.dump,
    }

    def stop_requested() -> None:
        session.is_stopping = True
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.remove_signal_handler(number)
            if abandon is not None:
                signal.signal(number, lambda again, _: abandon(again))
        notifier.stopping("stopping")
        stop()

    for number in (signal.SIGINT, signal.SIGTERM):
        actions[number] = stop_requested
    before = {number: signal.getsignal(number) for number in actions}
    for number, action in actions.items():
        loop.add_signal_handler(number, action)
    notifier.ready(session.line())
    looking = asyncio.create_task(session.look())
    try:
        yield
    finally:
        notifier.stopping("stopping")
        looking.cancel()
        await asyncio.gather(looking, *session.tasks, return_exceptions=True)
        for number in actions:
            loop.remove_signal_handler(number)
            is_stop = number in (signal.SIGINT, signal.SIGTERM)  # they end at once from now on
            if not is_stop and signal.getsignal(number) != before[number]:
                signal.signal(number, before[number])


class _SupervisedTasks:
    def __init__(
        self,
        daemon: DaemonApi,
        workers: Callable[[], Iterable[Worker]],
        notifier: Notifier,
        watchdog_s: float | None,
        print_line: Callable[[str], None],
    ) -> None:
        self.tasks: set[asyncio.Task[None]] = set()
        self.is_stopping = False
        self._daemon = daemon
        self._workers = workers
        self._notifier = notifier
        self._print = print_line
        self._line = StatusLine()
        self._feeds = watchdog_s is not None
        self._period_s = min(
            POLL_INTERVAL_S, max(MIN_POLL_INTERVAL_S, (watchdog_s or POLL_INTERVAL_S * 3) / 3)
        )
        self._watchdog = Watchdog((watchdog_s or 60.0) * WATCHDOG_SHARE)
        self._stuck: tuple[str, ...] = ()

    def begin(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self.tasks.add(task)
        task.add_done_callback(self.tasks.discard)

    def line(self) -> str:
        return self._line.of(self._daemon.status(), time.monotonic())

    async def look(self) -> None:
        """Report the status to systemd; feed its watchdog if every thread makes progress."""
        while True:
            stuck = self._watchdog.stuck(self._workers(), time.monotonic())
            if stuck != self._stuck:
                self._report_stuck(stuck)
            self._notifier.status(f"stuck: {', '.join(stuck)}" if stuck else self.line())
            if self._feeds and not stuck:
                self._notifier.alive()
            if self.is_stopping and not stuck:
                self._notifier.extend(EXTENSION_S)
            await asyncio.sleep(self._period_s)

    def _report_stuck(self, stuck: tuple[str, ...]) -> None:
        self._stuck = stuck
        if stuck:
            names = ", ".join(stuck)
            self._daemon.events.add(
                Severity.ERROR, "stuck", f"{names}: no work was finished for too long"
            )
            self.dump()

    async def reload(self) -> None:
        self._notifier.reloading(time.monotonic_ns())
        try:
            await self._daemon.reload(ORIGINS[signal.SIGHUP])
        except MapperdError as error:
            self._daemon.events.add(Severity.ERROR, "reload_failed", str(error))
        self._notifier.ready(self.line())

    async def snapshot(self) -> None:
        try:
            await self._daemon.snapshot(ORIGINS[signal.SIGUSR1])
        except MapperdError as error:
            self._daemon.events.add(Severity.ERROR, "snapshot_failed", str(error))

    def dump(self) -> None:
        for line in stack_lines():
            self._print(line)
        self._print(f"status: {self._daemon.status()}")
