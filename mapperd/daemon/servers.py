"""What runs beside the mapping: map stream, control, telemetry."""

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from types import MappingProxyType

from mapperd.api import DaemonApi
from mapperd.config.daemon import ServerConfig
from mapperd.config.paths import socket_path
from mapperd.config.tree import Config
from mapperd.daemon.daemon import Daemon
from mapperd.daemon.session import Live
from mapperd.errors import ConfigError
from mapperd.events import EventLog, Severity
from mapperd.server.listeners import (
    Listener,
    address_of,
    inherited_listener,
    open_tcp_listener,
    open_unix_listener,
    server_tls,
)
from mapperd.server.map_source import Source
from mapperd.server.state_feed import StateFeed
from mapperd.server.stream_server import StreamServer
from mapperd.telemetry.telemetry import Telemetry
from mapperd.wire.auth import CREDENTIALS, read_token, token_file

__all__ = [
    "FOLLOWS",
    "open_listeners",
    "serving",
    "stream_server",
]


@contextlib.asynccontextmanager
async def serving(
    daemon: Daemon, folder: Path, environment: Mapping[str, str], clock: Callable[[], int]
) -> AsyncIterator[None]:
    """Run the servers; they end after the daemon, so that its end is reported.

    Args:
        daemon: source of data and target of requests.
        folder: for its state.
        environment: gives the systemd credentials directory.
        clock: Unix time in nanoseconds that is never set back.

    Raises:
        ConfigError: the settings name a broker that cannot be talked to.
    """
    tasks = []
    if daemon.settings.current.mqtt.host:
        telemetry = Telemetry(daemon, (folder,), environment, clock)
        daemon.servers["mqtt"] = telemetry.status
        tasks.append(asyncio.create_task(telemetry.run()))
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


FOLLOWS = ("stream.rate",)
"""Live settings of the server, read when needed."""


def stream_server(
    operations: DaemonApi,
    live: Live,
    source: Source,
    environ: Mapping[str, str],
    *,
    now_ns: Callable[[], int],
    inherited: Mapping[str, socket.socket] = MappingProxyType({}),
) -> StreamServer:
    """Open the listeners and follow the pings; clients are served once the server is entered.

    Args:
        operations: the daemon; its settings give the addresses.
        live: its session.
        source: the map.
        environ: the process's variables: folders and credentials of systemd, or the user's.
        now_ns: Unix time that is never set back.
        inherited: Unix sockets that the service manager opened, by name; they replace our own.

    Raises:
        ConfigError: an address, a token or a certificate is wrong or missing.
        LiveError: an address cannot be listened on.
    """
    settings, events = operations.settings, operations.events
    listeners = open_listeners(settings.current, events, environ, inherited)
    feed = StateFeed(operations, lambda: live.mapping.snapshot, settings.current.stream.path_points)
    live.mapping.pipeline.executor.on_ping = feed.put
    settings.follow(FOLLOWS, lambda _: None)
    return StreamServer(operations, listeners, feed, source, now_ns=now_ns)


def open_listeners(
    config: Config,
    events: EventLog,
    environ: Mapping[str, str],
    inherited: Mapping[str, socket.socket] = MappingProxyType({}),
) -> list[Listener]:
    """Open the Unix socket, and the TCP socket if `server.address` is set.

    Args:
        config: the settings.
        events: for warnings.
        environ: as of `stream_server`.
        inherited: as of `stream_server`.

    Raises:
        ConfigError, LiveError: as `stream_server`.
    """
    settings = config.server
    mode = int(settings.mode, 8)
    with ExitStack() as undo:
        if inherited:
            listeners = [inherited_listener(given) for given in inherited.values()]
        else:
            listeners = [open_unix_listener(socket_path(config, environ), mode)]
        for listener in listeners:
            undo.callback(listener.close)
        if not inherited and mode & 0o007:
            text = (
                f"server.mode {settings.mode}: every user of this computer may control the "
                "mapper; 660 restricts it to the socket's group"
            )
            events.add(Severity.WARNING, "server_for_all", text)
        if settings.address:
            listeners.append(_tcp_listener(settings, environ, events))
        undo.pop_all()
    return listeners


def _tcp_listener(settings: ServerConfig, environ: Mapping[str, str], events: EventLog) -> Listener:
    host, _ = address_of(settings.address)
    if settings.tls_key and not settings.tls_certificate:
        raise ConfigError("server.tls_key has no certificate", "$.server.tls_certificate")
    tls = None
    if settings.tls_certificate:
        tls = server_tls(settings.tls_certificate, settings.tls_key)
    path = token_file(settings.token_file, environ)
    token = None if path is None else read_token(path)
    if token is None and not host.is_loopback:
        raise ConfigError(
            f"server.address {settings.address} needs a token: set server.token_file, or give "
            f"systemd the credential {CREDENTIALS[0]}; only addresses of the loopback may go "
            "without",
            "$.server.token_file",
        )
    if tls is None and not host.is_loopback:
        text = (
            f"server.address {settings.address}: everyone on that network can read along and take "
            "over a connection; server.tls_certificate prevents it"
        )
        events.add(Severity.WARNING, "server_in_clear", text)
    return open_tcp_listener(settings.address, token, tls)
