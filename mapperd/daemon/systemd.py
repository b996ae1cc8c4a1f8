"""Systemd: the protocols of sd_notify(3) and sd_listen_fds(3), and events as lines of a journal.

Lines have a priority where journald reads, and no repeats.
"""

import contextlib
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from dataclasses import dataclass
from typing import Protocol

from mapperd.events import Event, Severity

__all__ = [
    "Journal",
    "Notifier",
    "goes_to_journal",
    "inherited_sockets",
    "watchdog_s",
]

EXTENSION_S = 30.0
"""Time that long work requests while it makes progress, and may take without progress."""

MAX_STATUS = 200
"""Characters of a status line; more is cut."""


class Notifier:
    """Sends datagrams to systemd's socket, if there is one. Never blocks.

    Args:
        environ: `NOTIFY_SOCKET` names the socket: a path, or `@` and an abstract name.

    Attributes:
        lost: messages that the manager did not take.
    """

    def __init__(self, environ: Mapping[str, str]) -> None:
        self.lost = 0
        self._address = _address(environ.get("NOTIFY_SOCKET", ""))
        self._socket: socket.socket | None = None

    @property
    def is_supervised(self) -> bool:
        """Whether anybody listens."""
        return self._address is not None

    def ready(self, status: str = "") -> None:
        """The daemon works: settings read, sockets bound, map loaded."""
        self._send("READY=1", _status(status))

    def status(self, text: str) -> None:
        """One line for a person."""
        self._send(_status(text))

    def reloading(self, monotonic_ns: int) -> None:
        """Report that settings are being reloaded; `ready` reports the end."""
        self._send("RELOADING=1", f"MONOTONIC_USEC={monotonic_ns // 1000}")

    def stopping(self, status: str = "") -> None:
        """The daemon ends."""
        self._send("STOPPING=1", _status(status))

    def alive(self) -> None:
        """Feed the watchdog."""
        self._send("WATCHDOG=1")

    def extend(self, seconds: float) -> None:
        """Starting or stopping takes so much longer."""
        self._send(f"EXTEND_TIMEOUT_USEC={round(seconds * 1e6)}")

    @contextlib.contextmanager
    def extended_timeout(
        self, progress: Callable[[], object], limit_s: float = EXTENSION_S
    ) -> Iterator[None]:
        """Request more time, and feed the watchdog, while the work in this block makes progress.

        Args:
            progress: returns another value whenever a part of the work is finished; any thread.
            limit_s: time without progress after which the manager may act.
        """
        if not self.is_supervised:
            yield
            return
        done = threading.Event()

        def ask() -> None:
            seen, since_s = progress(), time.monotonic()
            while True:
                if (now := progress()) != seen:
                    seen, since_s = now, time.monotonic()
                if time.monotonic() - since_s < limit_s:
                    self.extend(limit_s)
                    self.alive()
                if done.wait(limit_s / 6):
                    return

        thread = threading.Thread(target=ask, name="extend-timeout", daemon=True)
        thread.start()
        try:
            yield
        finally:
            done.set()
            thread.join()

    def close(self) -> None:
        """Close the socket."""
        self._address = None
        if self._socket is not None:
            self._socket.close()

    def _send(self, *lines: str) -> None:
        if self._address is None:
            return
        text = "\n".join(line for line in lines if line)
        try:
            if self._socket is None:
                self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
                self._socket.settimeout(0)
            self._socket.sendto(text.encode(), self._address)
        except OSError:
            self.lost += 1


def watchdog_s(environ: Mapping[str, str], pid: int) -> float | None:
    """How long the manager waits for a sign of life; None where it does not.

    Args:
        environ: `WATCHDOG_USEC`, and `WATCHDOG_PID` if it is meant for one process only.
        pid: of this process.
    """
    with contextlib.suppress(ValueError):
        if environ.get("WATCHDOG_PID") and int(environ["WATCHDOG_PID"]) != pid:
            return None
        microseconds = int(environ.get("WATCHDOG_USEC", ""))
        return microseconds / 1e6 if microseconds > 0 else None
    return None


def _address(name: str) -> bytes | None:
    if name.startswith("@"):
        return b"\0" + os.fsencode(name[1:])
    return os.fsencode(name) if name.startswith("/") else None


def _status(text: str) -> str:
    line = " ".join(text.split())[:MAX_STATUS]
    return f"STATUS={line}" if line else ""


FIRST = 3
MAX = 16


def inherited_sockets(environ: MutableMapping[str, str], pid: int) -> dict[str, socket.socket]:
    """Sockets by the name that the unit gives them; they are ours from now on.

    The variables are removed, so that no child takes them for its own.

    Args:
        environ: `LISTEN_PID`, `LISTEN_FDS`, `LISTEN_FDNAMES`.
        pid: of this process; sockets for another one are not touched.
    """
    meant_for = environ.pop("LISTEN_PID", "")
    number = environ.pop("LISTEN_FDS", "")
    names = environ.pop("LISTEN_FDNAMES", "").split(":")
    if meant_for != str(pid) or not number.isdecimal() or int(number) > MAX:
        return {}
    found: dict[str, socket.socket] = {}
    for i in range(int(number)):
        os.set_inheritable(FIRST + i, False)  # noqa: FBT003 its only argument
        name = names[i] if i < len(names) and names[i] else f"socket{i}"
        found[name] = socket.socket(fileno=FIRST + i)
    return found


PRIORITIES = {
    Severity.ERROR: 3,
    Severity.WARNING: 4,
    Severity.NOTICE: 5,
    Severity.INFO: 6,
    Severity.DEBUG: 7,
}
"""Of syslog(3), as sd-daemon(3) writes them before a line."""

REPEAT_S = 10.0
"""Minimum time between two lines of the same code and subject; doubles while the event repeats."""

MAX_REPEAT_S = 3600.0

MAX_REMEMBERED = 256


@dataclass(slots=True)
class _Logged:
    """The last line of one code and subject: its time, the pause after it, repeats since."""

    at_s: float
    pause_s: float
    repeats: int = 0


class Writable(Protocol):
    """Takes text."""

    def write(self, text: str, /) -> object:
        """Write it."""

    def flush(self) -> None:
        """Bring it out."""


class Journal:
    """Writes events as lines; repeated events are counted and logged once.

    Args:
        stream: standard error.
        priorities: begin each line with `<n>`.
        clock: seconds, only forward.
        min_severity: events that are less severe are left out.
    """

    def __init__(
        self,
        stream: Writable,
        clock: Callable[[], float],
        *,
        priorities: bool,
        min_severity: Severity = Severity.INFO,
    ) -> None:
        self._stream = stream
        self._clock = clock
        self._priorities = priorities
        self._max_priority = PRIORITIES[min_severity]
        self._logged: dict[tuple[str, str], _Logged] = {}

    def write(self, event: Event) -> None:
        """Write an event, unless the same was written just now."""
        if PRIORITIES[event.severity] > self._max_priority:
            return
        key, now_s = (event.code, event.subject), self._clock()
        logged = self._logged.get(key)
        if logged is not None and now_s - logged.at_s < logged.pause_s:
            logged.repeats += 1
            return
        self._remember(key, logged, now_s)
        again = f" (repeated {logged.repeats} times since)" if logged and logged.repeats else ""
        self._line(event.severity, f"{event.text}{again}")

    def _remember(self, key: tuple[str, str], before: "_Logged | None", now_s: float) -> None:
        goes_on = before is not None and before.repeats > 0
        pause_s = min(2 * before.pause_s, MAX_REPEAT_S) if before and goes_on else REPEAT_S
        self._logged.pop(key, None)
        while len(self._logged) >= MAX_REMEMBERED:
            self._logged.pop(next(iter(self._logged)))
        self._logged[key] = _Logged(now_s, pause_s)

    def _line(self, severity: Severity, text: str) -> None:
        mark = f"<{PRIORITIES[severity]}>" if self._priorities else "mapperd: "
        line = " ".join(text.split("\n"))  # one event is one line, whatever is in it
        try:
            self._stream.write(f"{mark}{line}\n")
            self._stream.flush()
        except (OSError, ValueError):  # nobody reads any more, which is no reason to end
            return


def goes_to_journal(environ: Mapping[str, str], file_number: int) -> bool:
    """Return whether journald reads a stream: `JOURNAL_STREAM` gives device and inode."""
    try:
        facts = os.fstat(file_number)
    except OSError:
        return False
    return environ.get("JOURNAL_STREAM", "") == f"{facts.st_dev}:{facts.st_ino}"
