"""A connection to the daemon's control socket: one request after the other, and its events."""

import contextlib
import json
import socket
import ssl
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, Self

from mapperd.cli.mapperctl.errors import CtlError, Exit
from mapperd.wire.auth import proof_of
from mapperd.wire.control_messages import VERSION

__all__ = ["Connection", "Target"]

CONNECT_S = 5.0
MAX_BYTES = 16 << 20
"""Of one line; the daemon's longest are a tenth of a MiB."""

REASONS: Mapping[str, Exit] = MappingProxyType(
    {
        "bad_name": Exit.USAGE,
        "bad_format": Exit.USAGE,
        "bad_pose": Exit.USAGE,
        "no_such_map": Exit.USAGE,
        "unknown_setting": Exit.USAGE,
        "cannot_write": Exit.CANNOT_WRITE,
        "busy": Exit.TRY_AGAIN,
        "too_many_clients": Exit.TRY_AGAIN,
        "locked_out": Exit.TRY_AGAIN,
        "wrong_token": Exit.NO_PERMISSION,
        "bad_version": Exit.PROTOCOL,
        "bad_request": Exit.PROTOCOL,
    }
)
"""Exit codes of the daemon's reasons; all others are `REFUSED`."""


@dataclass(frozen=True, slots=True)
class Target:
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


class Connection:
    """Talks to one daemon, `with`.

    Args:
        target: where it listens.
        patience_s: for an answer.

    Raises:
        CtlError: nobody listens there, it is no mapperd, or it does not let us in.
    """

    def __init__(self, target: Target, patience_s: float) -> None:
        self._target = target
        self._number = 0
        with self._translated():
            self._socket = _connected(target)
            self._lines = self._socket.makefile("rb")
        try:
            self._send_hello()
            self._socket.settimeout(patience_s)
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
        """Hang up."""
        self._lines.close()
        self._socket.close()

    def ask(self, do: str, **more: object) -> dict[str, Any]:
        """Have something done; returns its result.

        Raises:
            CtlError: it was not done.
        """
        self._number += 1
        request = json.dumps({"id": self._number, "do": do} | more)
        with self._translated():
            self._socket.sendall(request.encode() + b"\n")
        answer = self._hear()
        while answer.get("id") != self._number and "error" not in answer:
            answer = self._hear()  # an event
        return self._result(answer)

    def follow(self, since: int) -> Iterator[dict[str, Any]]:
        """Events after one, and from then on all; each with those that were missed before it."""
        batch = self.ask("events", since=since, follow=True)
        self._socket.settimeout(None)
        while True:
            yield batch
            batch = self._hear()

    def _send_hello(self) -> None:
        greeting = self._hear()
        if greeting.get("mapperd") != "control" or VERSION not in greeting.get("versions", ()):
            what = f"speaks versions {greeting.get('versions')}, not {VERSION}"
            raise CtlError(f"{self._target}: {what}", Exit.PROTOCOL)
        more = {}
        if challenge := greeting.get("challenge"):
            if not self._target.token:
                raise CtlError(f"{self._target}: wants a token: --token-file", Exit.NO_PERMISSION)
            more["proof"] = proof_of(self._target.token, str(challenge))
        self.ask("hello", version=VERSION, **more)

    def _hear(self) -> dict[str, Any]:
        with self._translated():
            line = self._lines.readline(MAX_BYTES)
        if not line:
            raise CtlError(f"{self._target}: the daemon hung up", Exit.UNAVAILABLE)
        try:
            heard = json.loads(line)
        except (ValueError, RecursionError):
            heard = None
        if not isinstance(heard, dict):
            raise CtlError(f"{self._target}: is not the control socket of mapperd", Exit.PROTOCOL)
        return heard

    def _result(self, answer: dict[str, Any]) -> dict[str, Any]:
        error, result = answer.get("error"), answer.get("result")
        if isinstance(error, dict):
            reason = str(error.get("reason"))
            code = REASONS.get(reason, Exit.REFUSED)
            raise CtlError(str(error.get("message", reason)), code)
        if not isinstance(result, dict):
            raise CtlError(f"{self._target}: an answer without a result", Exit.PROTOCOL)
        return result

    @contextlib.contextmanager
    def _translated(self) -> Iterator[None]:
        try:
            yield
        except TimeoutError as error:
            raise CtlError(f"{self._target}: no answer", Exit.UNAVAILABLE) from error
        except PermissionError as error:
            text = f"{self._target}: you may not: {error.strerror}"
            raise CtlError(text, Exit.NO_PERMISSION) from error
        except ssl.SSLCertVerificationError as error:
            text = f"{self._target}: not trusted: {error.verify_message}"
            raise CtlError(text, Exit.NO_PERMISSION) from error
        except OSError as error:
            text = f"{self._target}: no daemon answers: {error.strerror or error}"
            raise CtlError(text, Exit.UNAVAILABLE) from error


def _connected(target: Target) -> socket.socket:
    if target.path is None:
        connected = socket.create_connection((target.host, target.port), timeout=CONNECT_S)
    else:
        connected = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        connected.settimeout(CONNECT_S)
        if target.path is not None:
            connected.connect(str(target.path))
        if target.tls is not None:
            return target.tls.wrap_socket(connected, server_hostname=target.host)
    except BaseException:
        connected.close()
        raise
    return connected
