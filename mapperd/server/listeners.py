"""Sockets that the daemon listens on, with permissions, token and TLS."""

import contextlib
import errno
import ipaddress
import os
import re
import socket
import ssl
import stat
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mapperd.errors import ConfigError, LiveError, os_reason
from mapperd.io import lock_file

__all__ = [
    "Listener",
    "address_of",
    "inherited_listener",
    "open_tcp_listener",
    "open_unix_listener",
    "peer_of",
    "server_tls",
]

BACKLOG = 64

KEEPALIVE = ((socket.TCP_KEEPIDLE, 30), (socket.TCP_KEEPINTVL, 10), (socket.TCP_KEEPCNT, 3))
"""Detects a client that vanished without closing within a minute."""

ADDRESS = re.compile(
    r"(?:(?P<v4>localhost|[0-9.]+)|\[(?P<v6>[0-9A-Fa-f:.]+)\]):(?P<port>[0-9]{1,5})"
)


@dataclass(frozen=True, slots=True)
class Listener:
    """A socket that listens.

    Attributes:
        name: address, for people.
        socket: non-blocking.
        token: clients prove that they know it; None where file permissions decide, or where
            everybody on this computer may read.
        tls: encryption; None for plain connections.
        close: closes the socket and removes its file.
    """

    name: str
    socket: socket.socket
    token: bytes | None
    tls: ssl.SSLContext | None
    close: Callable[[], None]


def open_unix_listener(path: Path, mode: int) -> Listener:
    """Listen on a Unix socket; the socket of a dead process is replaced.

    The socket gets its permissions before it is renamed into place, under a lock beside it: other
    users can never connect, and a living daemon never loses its socket.

    Raises:
        LiveError: another process listens there, another file is there, or it cannot be created.
    """
    listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    with contextlib.ExitStack() as undo:
        undo.callback(listening.close)
        try:
            path.parent.mkdir(mode=0o755, parents=True, exist_ok=True)
            lock = _lock(path)
            undo.callback(os.close, lock)
            _require_free(path)
            partial.unlink(missing_ok=True)
            undo.callback(partial.unlink, missing_ok=True)
            _bind(listening, partial, mode)
            partial.rename(path)
        except OSError as error:
            raise LiveError(f"{path}: cannot be listened on: {_why(error)}") from error
        listening.settimeout(0)
        mine = path.stat().st_ino
        undo.pop_all()

    def close() -> None:
        listening.close()
        with contextlib.suppress(OSError):
            if path.stat().st_ino == mine:
                path.unlink()
        os.close(lock)

    return Listener(f"unix {path}", listening, None, None, close)


def inherited_listener(listening: socket.socket) -> Listener:
    """Use a Unix socket that the service manager opened, with the manager's permissions.

    Raises:
        ConfigError: it is not a listening Unix socket; other sockets have no access control.
    """
    is_unix = listening.family == socket.AF_UNIX and listening.type == socket.SOCK_STREAM
    if not is_unix or not listening.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN):
        listening.close()
        raise ConfigError("the inherited socket is not a listening Unix socket", "$.server")
    listening.settimeout(0)
    name = f"unix {os.fsdecode(listening.getsockname())}"
    return Listener(name, listening, None, None, listening.close)


def open_tcp_listener(address: str, token: bytes | None, tls: ssl.SSLContext | None) -> Listener:
    """Listen on a TCP address.

    Args:
        address: `127.0.0.1:7471`, `[::1]:7471`; port 0 takes any free port.
        token: clients must know it; None admits everyone, for reading.
        tls: encryption; None for plain connections.

    Raises:
        ConfigError: the address is invalid.
        LiveError: the address cannot be listened on.
    """
    host, port = address_of(address)
    is_v6 = isinstance(host, ipaddress.IPv6Address)
    family = socket.AF_INET6 if is_v6 else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if is_v6:
            listening.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        listening.bind((str(host), port))
        listening.listen(BACKLOG)
    except OSError as error:
        listening.close()
        raise LiveError(f"{address}: cannot be listened on: {_why(error)}") from error
    listening.settimeout(0)
    shown = f"[{host}]" if is_v6 else f"{host}"
    name = f"{'tls' if tls else 'tcp'} {shown}:{listening.getsockname()[1]}"
    return Listener(name, listening, token, tls, listening.close)


def address_of(text: str) -> tuple[ipaddress.IPv4Address | ipaddress.IPv6Address, int]:
    """Parse an IP address and port, as `open_tcp_listener` takes them.

    Raises:
        ConfigError: the text is not an address with a port.
    """
    found = ADDRESS.fullmatch(text)
    try:
        if found is None or int(found["port"]) >= 1 << 16:
            raise ConfigError(
                f"{text[:100]!a}: not an address; expected 127.0.0.1:7471 or [::1]:7471",
                "$.server.address",
            )
        if found["v6"]:
            return ipaddress.IPv6Address(found["v6"]), int(found["port"])
        v4 = "127.0.0.1" if found["v4"] == "localhost" else found["v4"]
        return ipaddress.IPv4Address(v4), int(found["port"])
    except ValueError as error:
        raise ConfigError(f"{text[:100]!a}: {error}", "$.server.address") from error


def server_tls(certificate: str, key: str) -> ssl.SSLContext:
    """Return the TLS context of a certificate and its key.

    Args:
        certificate: chain in PEM.
        key: its private key; "" if the same file holds it.

    Raises:
        ConfigError: the files cannot be read, or do not belong together.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        context.load_cert_chain(certificate, key or None, password=lambda: "")
    except (OSError, ValueError) as error:  # SSLError is an OSError
        raise ConfigError(
            f"{certificate}, {key or 'no key'}: not a certificate with its key: {error}",
            "$.server.tls_certificate",
        ) from error
    return context


def peer_of(connection: socket.socket, address: object) -> tuple[str, str]:
    """Return a client's network address, "" for a Unix socket, and its name for people."""
    if connection.family == socket.AF_UNIX:
        size = struct.calcsize("3i")
        credentials = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, size)
        _, user, _ = struct.unpack("3i", credentials)
        return "", f"user {user}"
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for option, value in KEEPALIVE:
        connection.setsockopt(socket.IPPROTO_TCP, option, value)
    peer = str(address[0]) if isinstance(address, tuple) else ""
    return peer, peer


def _lock(path: Path) -> int:
    """Lock the path of a socket until the handle is closed or the process ends."""
    flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW
    return lock_file(path.with_name(f".{path.name}.lock"), flags)


def _require_free(path: Path) -> None:
    """Raise OSError unless the path is free or holds the socket of a dead process."""
    try:
        kind = path.lstat().st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(kind):
        raise FileExistsError(errno.EEXIST, "something other than a socket is there")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.settimeout(1.0)
        try:
            probe.connect(str(path))
        except (ConnectionRefusedError, FileNotFoundError):
            return
        except (TimeoutError, BlockingIOError):
            pass  # its queue is full: somebody has it
    raise BlockingIOError(errno.EADDRINUSE, "another process listens there")


def _bind(listening: socket.socket, path: Path, mode: int) -> None:
    before = os.umask(0o177)  # until the chmod, nobody else
    try:
        listening.bind(str(path))
    finally:
        os.umask(before)
    path.chmod(mode)
    listening.listen(BACKLOG)


def _why(error: OSError) -> str:
    if isinstance(error, BlockingIOError):
        return (
            "another process listens there, such as another mapperd: stop it, or set server.socket"
        )
    return os_reason(error)
