"""The sockets that the daemon listens at, opened so that nobody is in who should not be."""

import contextlib
import errno
import fcntl
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
from typing import Literal

from mapperd.errors import ConfigError, LiveError

__all__ = [
    "Listener",
    "Section",
    "address_of",
    "inherited_listener",
    "open_tcp_listener",
    "open_unix_listener",
    "peer_of",
    "server_tls",
]

BACKLOG = 64

KEEPALIVE = ((socket.TCP_KEEPIDLE, 30), (socket.TCP_KEEPINTVL, 10), (socket.TCP_KEEPCNT, 3))
"""Who listens and is gone without a word is noticed after a minute."""

ADDRESS = re.compile(
    r"(?:(?P<v4>localhost|[0-9.]+)|\[(?P<v6>[0-9A-Fa-f:.]+)\]):(?P<port>[0-9]{1,5})"
)


Section = Literal["control", "stream"]


@dataclass(frozen=True, slots=True)
class Listener:
    """A socket that listens.

    Attributes:
        name: for people.
        socket: does not block.
        token: who comes has to prove that it knows it; None where file permissions decide, or
            where everybody on this computer may come in.
        tls: encrypts; None does not.
        close: lets go of it.
        section: of the settings; limits the clients of its listeners together.
    """

    name: str
    socket: socket.socket
    token: bytes | None
    tls: ssl.SSLContext | None
    close: Callable[[], None]
    section: Section = "control"


def open_unix_listener(path: Path, mode: int, section: Section = "control") -> Listener:
    """Listen at a Unix socket; one that a dead process left is replaced.

    It comes into its place with its permissions, and only who holds the lock beside it puts it
    there: at no moment may others connect, and no living daemon loses its socket.

    Raises:
        LiveError: another process listens there, something else is there, or it cannot be made.
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
            raise LiveError(f"{path}: cannot be listened at: {_why(error)}") from error
        listening.settimeout(0)
        mine = path.stat().st_ino
        undo.pop_all()

    def close() -> None:
        listening.close()
        with contextlib.suppress(OSError):
            if path.stat().st_ino == mine:
                path.unlink()
        os.close(lock)

    return Listener(f"unix {path}", listening, None, None, close, section)


def inherited_listener(listening: socket.socket, section: Section = "control") -> Listener:
    """A Unix socket that the service manager opened: its permissions are the manager's.

    Args:
        listening: the socket.
        section: of the settings, for messages.

    Raises:
        ConfigError: it is not a listening Unix socket; anybody could come in by another.
    """
    is_unix = listening.family == socket.AF_UNIX and listening.type == socket.SOCK_STREAM
    if not is_unix or not listening.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN):
        listening.close()
        text = f"the inherited {section} socket is not a listening Unix socket"
        raise ConfigError(text, f"$.{section}")
    listening.settimeout(0)
    name = f"unix {os.fsdecode(listening.getsockname())}"
    return Listener(name, listening, None, None, listening.close, section)


def open_tcp_listener(
    address: str, token: bytes | None, tls: ssl.SSLContext | None, section: Section = "control"
) -> Listener:
    """Listen at a TCP address.

    Args:
        address: `127.0.0.1:7470`, `[::1]:7470`; port 0 takes any.
        token: has to be known; None lets everybody in.
        tls: encrypts.
        section: of the settings, for messages.

    Raises:
        ConfigError: it is no address.
        LiveError: it cannot be listened at.
    """
    host, port = address_of(address, section)
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
        raise LiveError(f"{address}: cannot be listened at: {_why(error)}") from error
    listening.settimeout(0)
    shown = f"[{host}]" if is_v6 else f"{host}"
    name = f"{'tls' if tls else 'tcp'} {shown}:{listening.getsockname()[1]}"
    return Listener(name, listening, token, tls, listening.close, section)


def address_of(
    text: str, section: str = "control"
) -> tuple[ipaddress.IPv4Address | ipaddress.IPv6Address, int]:
    """IP address and port of a text.

    Args:
        text: as `open_tcp_listener` takes it.
        section: of the settings, for messages.

    Raises:
        ConfigError: it is none.
    """
    found = ADDRESS.fullmatch(text)
    try:
        if found is None or int(found["port"]) >= 1 << 16:
            raise ConfigError(
                f"{text[:100]!a}: no address; such as 127.0.0.1:7470 or [::1]:7470",
                f"$.{section}.address",
            )
        if found["v6"]:
            return ipaddress.IPv6Address(found["v6"]), int(found["port"])
        v4 = "127.0.0.1" if found["v4"] == "localhost" else found["v4"]
        return ipaddress.IPv4Address(v4), int(found["port"])
    except ValueError as error:
        raise ConfigError(f"{text[:100]!a}: {error}", f"$.{section}.address") from error


def server_tls(certificate: str, key: str, section: str = "control") -> ssl.SSLContext:
    """Encryption with a certificate and its key.

    Args:
        certificate: chain in PEM.
        key: its private key; "" is in the same file.
        section: of the settings, for messages.

    Raises:
        ConfigError: they cannot be read, or do not belong together.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        context.load_cert_chain(certificate, key or None, password=lambda: "")
    except (OSError, ValueError) as error:  # SSLError is an OSError
        raise ConfigError(
            f"{certificate}, {key or 'no key'}: no certificate with its key: {error}",
            f"$.{section}.tls_certificate",
        ) from error
    return context


def peer_of(connection: socket.socket, address: object) -> tuple[str, str]:
    """Who connected: its network address, empty for a Unix socket; and what people call it."""
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
    """Be the only one who puts a socket there, until the handle is closed or the process ends."""
    flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
    handle = os.open(path.with_name(f".{path.name}.lock"), flags, 0o600)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        raise
    return handle


def _require_free(path: Path) -> None:
    """Nothing is there, or a socket that nobody listens at any more."""
    try:
        kind = path.lstat().st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(kind):
        raise FileExistsError(errno.EEXIST, "something is there that is not a socket")
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
        return "another process listens there"
    return error.strerror or str(error)  # a path that is too long has no errno
