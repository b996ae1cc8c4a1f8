"""A connection to the daemon: one request after the other, and its events; errors."""

import contextlib
import select
import socket
import ssl
import time
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, Self

import msgspec

from mapperd.errors import ExportError, ExportExtraError, MapError, MapperdError, StoreError
from mapperd.wire.auth import proof_of
from mapperd.wire.framing import StreamError, client_inbox, framed
from mapperd.wire.messages import (
    PROTOCOL,
    VERSION,
    AckMessage,
    AnswerMessage,
    AskMessage,
    ByeMessage,
    ChangeMessage,
    EventMessage,
    FromClient,
    FromServer,
    GreetingMessage,
    HelloMessage,
    WelcomeMessage,
)
from oculus_driver.command_line import ExitCode
from oculus_driver.errors import (
    RecordingError,
    RecordingMissingError,
    RecordingUnwritableError,
)

__all__ = [
    "ControlConnection",
    "CtlError",
    "DaemonTarget",
    "file_error_code",
    "no_daemon",
    "plain",
    "refused",
]


class CtlError(MapperdError):
    """A command failed; the text is one line for people.

    Attributes:
        code: exit code.
    """

    def __init__(self, message: str, code: ExitCode) -> None:
        super().__init__(plain(message))
        self.code = code


def plain(text: object) -> str:
    """Replace unprintable characters, such as a terminal's escape sequences."""
    return "".join(letter if letter.isprintable() else "?" for letter in str(text))


NO_PERMISSION = frozenset({"wrong_token", "needs_token", "no_permission", "not_trusted"})


def no_daemon(target: object, reason: object) -> CtlError:
    """Return the error of a daemon that does not answer."""
    return CtlError(f"{target}: no daemon answers: {reason}; {NO_DAEMON}", ExitCode.UNAVAILABLE)


def refused(error: StreamError) -> CtlError:
    """Convert an error of the stream to an error with an exit code."""
    code = ExitCode.NO_PERMISSION if error.reason in NO_PERMISSION else ExitCode.PROTOCOL
    return CtlError(str(error), code)


def file_error_code(error: Exception) -> ExitCode:
    """Return the exit code of a file that cannot be read or written."""
    if isinstance(error, StoreError):
        return _STORE.get(error.reason, ExitCode.BAD_DATA)
    if isinstance(error, MapError):
        reasons = {"unreadable": ExitCode.NO_INPUT, "bad_tolerance": ExitCode.USAGE}
        return reasons.get(error.reason, ExitCode.BAD_DATA)
    found = (code for kind, code in _FILES.items() if isinstance(error, kind))
    return next(found, ExitCode.USAGE)


_STORE = {
    "cannot_open": ExitCode.NO_INPUT,
    "read_only": ExitCode.CANNOT_WRITE,
    "disk_full": ExitCode.CANNOT_WRITE,
    "busy": ExitCode.TRY_AGAIN,
    "in_use": ExitCode.TRY_AGAIN,
    "other_parameters": ExitCode.BAD_CONFIG,
}
"""By reason of a `StoreError`; all others are of files that are no maps, or damaged ones."""

_FILES = {
    ExportExtraError: ExitCode.BAD_CONFIG,
    ExportError: ExitCode.CANNOT_WRITE,
    RecordingMissingError: ExitCode.NO_INPUT,
    RecordingUnwritableError: ExitCode.CANNOT_WRITE,
    RecordingError: ExitCode.BAD_DATA,
}

CONNECT_TIMEOUT_S = 5.0
NO_DAEMON = "check that mapperd runs there and that its server.address is this one"
READ_BYTES = 65536

REASONS: Mapping[str, ExitCode] = MappingProxyType(
    {
        "bad_name": ExitCode.USAGE,
        "bad_format": ExitCode.USAGE,
        "bad_pose": ExitCode.USAGE,
        "no_such_map": ExitCode.USAGE,
        "unknown_setting": ExitCode.USAGE,
        "cannot_write": ExitCode.CANNOT_WRITE,
        "busy": ExitCode.TRY_AGAIN,
        "too_many_clients": ExitCode.TRY_AGAIN,
        "locked_out": ExitCode.TRY_AGAIN,
        "wrong_token": ExitCode.NO_PERMISSION,
        "needs_token": ExitCode.NO_PERMISSION,
        "bad_version": ExitCode.PROTOCOL,
        "bad_request": ExitCode.PROTOCOL,
        "bad_message": ExitCode.PROTOCOL,
        "closing": ExitCode.UNAVAILABLE,
    }
)
"""Exit codes of the daemon's reasons; all others are `REFUSED`."""


@dataclass(frozen=True, slots=True)
class DaemonTarget:
    """Where a daemon listens.

    Attributes:
        path: of a Unix socket; None where it is an address.
        host, port: of TCP.
        token: that a TCP socket asks for.
        tls: TLS context for TCP.
    """

    path: Path | None
    host: str = ""
    port: int = 0
    token: bytes = b""
    tls: ssl.SSLContext | None = None

    def __str__(self) -> str:
        """For a person."""
        return str(self.path) if self.path is not None else f"{self.host}:{self.port}"


class ControlConnection:
    """A connection to one daemon, `with`.

    Args:
        target: where it listens.
        timeout_s: for an answer.

    Raises:
        CtlError: no daemon listens there, or it refuses the connection.
    """

    def __init__(self, target: DaemonTarget, timeout_s: float) -> None:
        self._target = target
        self._timeout_s = timeout_s
        self._number = self._acknowledged = 0
        self._inbox = client_inbox()
        self._received: deque[FromServer] = deque()
        self._is_welcome = False
        with self._translated():
            self._socket = _connected(target)
        try:
            self._greet()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()

    def ask(self, do: str, **more: object) -> dict[str, Any]:
        """Send a request and return its result.

        Raises:
            CtlError: the daemon did not do it.
        """
        self._number += 1
        try:
            request = msgspec.msgpack.encode({"id": self._number, "do": do} | more)
        except OverflowError as error:
            raise CtlError("integers have 64 bits", ExitCode.USAGE) from error
        self._send(AskMessage(ask=msgspec.Raw(request)))
        until_s = time.monotonic() + self._timeout_s
        while True:
            message = self._receive(until_s)
            if isinstance(message, AnswerMessage) and message.id in (self._number, None):
                return self._result(message)

    def wait(self, seconds: float) -> None:
        """Wait; what the daemon sends meanwhile is acknowledged.

        Raises:
            CtlError: the daemon ended the connection.
        """
        until_s = time.monotonic() + seconds
        while (left_s := until_s - time.monotonic()) > 0:
            if select.select([self._socket], [], [], left_s)[0]:
                self._receive(time.monotonic() + self._timeout_s)

    def follow(self, since: int) -> Iterator[dict[str, Any]]:
        """Events after one, and from then on all; each with those that were missed before it."""
        batch = self.ask("events", since=since)
        yield batch
        while batch["more"]:
            since = batch["events"][-1]["number"]
            batch = self.ask("events", since=since)
            yield batch
        last = max([since, *(event["number"] for event in batch["events"])])
        self._send(ChangeMessage(wants=["events"]))
        while True:
            message = self._receive(None)
            if isinstance(message, EventMessage) and message.event["number"] > last:
                yield {"events": [message.event], "missed": message.lost, "more": False}

    def _greet(self) -> None:
        until_s = time.monotonic() + CONNECT_TIMEOUT_S
        greeting = self._receive(until_s)
        if not isinstance(greeting, GreetingMessage) or greeting.mapperd != PROTOCOL:
            raise CtlError(f"{self._target}: is not the socket of mapperd", ExitCode.PROTOCOL)
        if VERSION not in greeting.versions:
            what = f"speaks versions {list(greeting.versions)}, not {VERSION}"
            raise CtlError(f"{self._target}: {what}", ExitCode.PROTOCOL)
        proof = ""
        if greeting.challenge:
            if not self._target.token:
                raise CtlError(
                    f"{self._target}: needs a token: give --token-file a copy of the file that "
                    "server.token_file of the daemon names",
                    ExitCode.NO_PERMISSION,
                )
            proof = proof_of(self._target.token, greeting.challenge)
        self._send(HelloMessage(version=VERSION, proof=proof, name="mapperctl"))
        if not isinstance(self._receive(until_s), WelcomeMessage):
            raise CtlError(f"{self._target}: no welcome", ExitCode.PROTOCOL)
        self._is_welcome = True

    def _send(self, message: FromClient) -> None:
        with self._translated():
            self._socket.settimeout(self._timeout_s)
            self._socket.sendall(framed(message))

    def _receive(self, until_s: float | None) -> FromServer:
        """The next message, if it comes in time."""
        while not self._received:
            self._read(until_s)
        message = self._received.popleft()
        if isinstance(message, ByeMessage):
            code = REASONS.get(message.reason, ExitCode.FAULT)
            raise CtlError(f"{self._target}: {message.message or message.reason}", code)
        return message

    def _read(self, until_s: float | None) -> None:
        with self._translated():
            if until_s is not None and time.monotonic() >= until_s:
                raise TimeoutError
            left_s = None if until_s is None else max(until_s - time.monotonic(), 1e-3)
            self._socket.settimeout(left_s)
            data = self._socket.recv(READ_BYTES)
        if not data:
            raise CtlError(f"{self._target}: the daemon hung up", ExitCode.UNAVAILABLE)
        try:
            self._received.extend(self._inbox.feed(data))
        except StreamError as error:
            text = f"{self._target}: is not the socket of mapperd: {error}"
            raise CtlError(text, ExitCode.PROTOCOL) from error
        if self._is_welcome and self._inbox.received > self._acknowledged:
            self._acknowledged = self._inbox.received
            self._send(AckMessage(bytes=self._acknowledged))

    def _result(self, answer: AnswerMessage) -> dict[str, Any]:
        error, result = answer.error, answer.result
        if error is not None:
            reason = str(error.get("reason"))
            code = REASONS.get(reason, ExitCode.FAULT)
            raise CtlError(str(error.get("message", reason)), code)
        if result is None:
            raise CtlError(f"{self._target}: an answer without a result", ExitCode.PROTOCOL)
        return result

    @contextlib.contextmanager
    def _translated(self) -> Iterator[None]:
        try:
            yield
        except TimeoutError as error:
            raise CtlError(
                f"{self._target}: no answer; {NO_DAEMON}", ExitCode.UNAVAILABLE
            ) from error
        except PermissionError as error:
            text = (
                f"{self._target}: {error.strerror}; join the group that owns it, and log in again"
            )
            raise CtlError(text, ExitCode.NO_PERMISSION) from error
        except ssl.SSLCertVerificationError as error:
            text = f"{self._target}: not trusted: {error.verify_message}"
            raise CtlError(text, ExitCode.NO_PERMISSION) from error
        except OSError as error:
            raise no_daemon(self._target, error.strerror or error) from error


def _connected(target: DaemonTarget) -> socket.socket:
    if target.path is None:
        connected = socket.create_connection((target.host, target.port), timeout=CONNECT_TIMEOUT_S)
    else:
        connected = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        connected.settimeout(CONNECT_TIMEOUT_S)
        if target.path is not None:
            connected.connect(str(target.path))
        if target.tls is not None:
            return target.tls.wrap_socket(connected, server_hostname=target.host)
    except BaseException:
        connected.close()
        raise
    return connected
