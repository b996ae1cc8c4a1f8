"""The daemon and its service manager: signals in, readiness and signs of life out."""

import asyncio
import contextlib
import signal
import threading
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Iterable, Iterator
from typing import Any

from mapperd.api import Operations
from mapperd.daemon.stacks import stack_lines
from mapperd.daemon.status_line import StatusLine
from mapperd.daemon.systemd import Notifier
from mapperd.errors import MapperdError
from mapperd.events import Severity
from mapperd.pipeline.watchdog import Watchdog, Worker

__all__ = ["only_told_to_stop", "supervised"]

LOOK_S = 2.0
"""Between looks at how it goes; the watchdog's third where that is shorter."""

LEAST_LOOK_S = 0.05
PATIENCE = 0.5
"""Of the watchdog's time: a worker may be silent so long before the manager is let to act."""

ORIGINS = {signal.SIGHUP: "SIGHUP", signal.SIGUSR1: "SIGUSR1"}


@contextlib.contextmanager
def only_told_to_stop() -> Iterator[None]:
    """Ignore what asks for work while there is nobody who could do it: at the start and the end.

    Unheard, SIGHUP and the others would end the program, and systemd takes that for a clean end.
    """
    asking: tuple[signal.Signals, ...] = (signal.SIGHUP, signal.SIGUSR1, signal.SIGUSR2)
    if threading.current_thread() is not threading.main_thread():  # signals are not its business
        asking = ()
    before = {number: signal.signal(number, signal.SIG_IGN) for number in asking}
    try:
        yield
    finally:
        for number, action in before.items():
            signal.signal(number, action)


@contextlib.asynccontextmanager
async def supervised(
    daemon: Operations,
    workers: Callable[[], Iterable[Worker]],
    notifier: Notifier,
    *,
    watchdog_s: float | None,
    stop: Callable[[], None],
    say: Callable[[str], None],
) -> AsyncIterator[None]:
    """Say that the daemon works, feed the watchdog while it does, and obey signals; `async with`.

    SIGINT and SIGTERM stop, a second one at once; SIGHUP reads the settings again; SIGUSR1 brings
    the map to the disk; SIGUSR2 writes what every thread does.

    Args:
        daemon: works already: settings read, sockets bound, map loaded.
        workers: the daemon's threads, now.
        notifier: of the manager.
        watchdog_s: how long the manager waits for a sign of life; None where it does not.
        stop: makes the daemon end.
        say: writes a line for whoever looks for what hangs.
    """
    session = _Session(daemon, workers, notifier, watchdog_s, say)
    loop = asyncio.get_running_loop()
    actions: dict[signal.Signals, Callable[[], None]] = {
        signal.SIGHUP: lambda: session.begin(session.reload()),
        signal.SIGUSR1: lambda: session.begin(session.snapshot()),
        signal.SIGUSR2: session.dump,
    }

    def told_to_stop() -> None:
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.remove_signal_handler(number)
        notifier.stopping("stopping")
        stop()

    for number in (signal.SIGINT, signal.SIGTERM):
        actions[number] = told_to_stop
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


class _Session:
    def __init__(
        self,
        daemon: Operations,
        workers: Callable[[], Iterable[Worker]],
        notifier: Notifier,
        watchdog_s: float | None,
        say: Callable[[str], None],
    ) -> None:
        self.tasks: set[asyncio.Task[None]] = set()
        self._daemon = daemon
        self._workers = workers
        self._notifier = notifier
        self._say = say
        self._line = StatusLine()
        self._feeds = watchdog_s is not None
        self._period_s = min(LOOK_S, max(LEAST_LOOK_S, (watchdog_s or LOOK_S * 3) / 3))
        self._watchdog = Watchdog((watchdog_s or 60.0) * PATIENCE)
        self._stuck: tuple[str, ...] = ()

    def begin(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self.tasks.add(task)
        task.add_done_callback(self.tasks.discard)

    def line(self) -> str:
        return self._line.of(self._daemon.status(), time.monotonic())

    async def look(self) -> None:
        """Tell the manager how it goes; feed its watchdog if every thread gets on."""
        while True:
            stuck = self._watchdog.stuck(self._workers(), time.monotonic())
            if stuck != self._stuck:
                self._tell_stuck(stuck)
            self._notifier.status(f"stuck: {', '.join(stuck)}" if stuck else self.line())
            if self._feeds and not stuck:
                self._notifier.alive()
            await asyncio.sleep(self._period_s)

    def _tell_stuck(self, stuck: tuple[str, ...]) -> None:
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
            self._say(line)
        self._say(f"status: {self._daemon.status()}")
