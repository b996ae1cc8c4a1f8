"""What runs beside the mapping: map stream, control, telemetry, debug pictures."""

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import ExitStack
from pathlib import Path

from mapperd.api import DaemonApi
from mapperd.config.tree import Config
from mapperd.daemon.daemon import Daemon
from mapperd.daemon.debug_pictures import draw_pictures
from mapperd.daemon.session import Live
from mapperd.errors import ConfigError
from mapperd.events import EventLog, Severity
from mapperd.server.control_server import ControlServer
from mapperd.server.listeners import (
    Listener,
    address_of,
    inherited_listener,
    open_tcp_listener,
    open_unix_listener,
    server_tls,
)
from mapperd.server.source_protocol import Source
from mapperd.server.state_feed import Feed
from mapperd.server.stream_server import StreamServer
from mapperd.telemetry.telemetry import Telemetry
from mapperd.wire.auth import CREDENTIAL as CONTROL_CREDENTIAL
from mapperd.wire.auth import Limits, read_token, token_file
from mapperd.wire.socket_paths import map_socket_path, socket_path
from oculus_driver.ping import Ping

__all__ = [
    "FOLLOWS",
    "STREAM_CREDENTIAL",
    "control_server",
    "map_listeners",
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

    def newest() -> Ping | None:
        result = daemon.live.mapping.newest
        return None if result is None else result.posed.ping

    tasks = []
    if daemon.settings.current.mqtt.host:
        telemetry = Telemetry(daemon, (folder,), environment, clock)
        daemon.servers["mqtt"] = telemetry.status
        tasks.append(asyncio.create_task(telemetry.run()))
    pictures = draw_pictures(
        newest,
        daemon.settings,
        daemon.events,
        folder / "debug",
        lambda: daemon.live.mapping.snapshot.localization,
    )
    tasks.append(asyncio.create_task(pictures))
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


STREAM_CREDENTIAL = "stream-token"
"""Name of systemd's credential."""

FOLLOWS = ("stream.rate",)
"""Live settings of the server, read when needed."""


def stream_server(
    operations: DaemonApi,
    live: Live,
    source: Source,
    environ: Mapping[str, str],
    *,
    now_ns: Callable[[], int],
    inherited: socket.socket | None = None,
) -> StreamServer:
    """Open the doors and listen to the pings; nobody is served before the server is entered.

    Args:
        operations: the daemon; its settings give the addresses.
        live: its session.
        source: the map.
        environ: the process's variables: folders and credentials of systemd, or the user's.
        now_ns: Unix time that is never set back.
        inherited: a Unix socket that the service manager opened, instead of our own.

    Raises:
        ConfigError: an address, a token, a certificate is wrong or missing.
        LiveError: something cannot be listened at.
    """
    settings = operations.settings
    doors = map_listeners(settings.current, operations.events, environ, inherited)
    feed = Feed(operations, lambda: live.mapping.snapshot, settings.current.stream.path_points)
    live.mapping.pipeline.executor.on_ping = feed.put
    settings.follow(FOLLOWS, lambda _: None)
    return StreamServer(operations, doors, feed, source, now_ns=now_ns)


def map_listeners(
    config: Config,
    events: EventLog,
    environ: Mapping[str, str],
    inherited: socket.socket | None = None,
) -> list[Listener]:
    """The Unix socket, and that of TCP where the settings have one. Raises as `stream_server`."""
    mode = int(config.stream.mode, 8)
    with ExitStack() as undo:
        if inherited is None:
            doors = [open_unix_listener(map_socket_path(config, environ), mode)]
        else:
            doors = [inherited_listener(inherited, "stream")]
        undo.callback(doors[0].close)
        if inherited is None and mode & 0o007:
            warning = (
                f"stream.mode {config.stream.mode}: every user of this computer may steer the "
                "mapper; 660 lets its group alone"
            )
            events.add(Severity.WARNING, "stream_for_all", warning)
        if config.stream.address:
            doors.append(_stream_tcp_listener(config, environ, events))
        undo.pop_all()
    return doors


def _stream_tcp_listener(config: Config, environ: Mapping[str, str], events: EventLog) -> Listener:
    stream = config.stream
    path = token_file(stream.token_file, environ, STREAM_CREDENTIAL)
    token = None if path is None else read_token(path, "$.stream.token_file")
    host, _ = address_of(stream.address, "stream")
    if token is None and not host.is_loopback:
        raise ConfigError(
            f"stream.address {stream.address} needs a token: set stream.token_file, or give "
            f"systemd the credential {STREAM_CREDENTIAL}; allowed without one: addresses of the "
            "loopback",
            "$.stream.token_file",
        )
    if stream.tls_key and not stream.tls_certificate:
        raise ConfigError("stream.tls_key has no certificate", "$.stream.tls_certificate")
    tls = None
    if stream.tls_certificate:
        tls = server_tls(stream.tls_certificate, stream.tls_key, "stream")
    elif not host.is_loopback:
        warning = (
            f"map stream at {stream.address}: everybody on that network can read along, and take "
            "over a connection; stream.tls_certificate prevents it"
        )
        events.add(Severity.WARNING, "stream_in_clear", warning)
    return open_tcp_listener(stream.address, token, tls, "stream")


def control_server(
    operations: DaemonApi, environ: Mapping[str, str], inherited: socket.socket | None = None
) -> ControlServer:
    """Open the doors; nobody is served before the server is entered, `async with`.

    Args:
        operations: the daemon; its settings give the addresses.
        environ: the process's variables: folders and credentials of systemd, or the user's.
        inherited: a Unix socket that the service manager opened, instead of our own; it stays,
            and clients wait at it, when we end.

    Raises:
        ConfigError: an address, a token, a certificate is wrong or missing.
        LiveError: something cannot be listened at.
    """
    config = operations.settings.current
    with ExitStack() as undo:
        if inherited is None:
            doors = [open_unix_listener(socket_path(config, environ), int(config.control.mode, 8))]
        else:
            doors = [inherited_listener(inherited)]
        undo.callback(doors[0].close)
        if inherited is None and int(config.control.mode, 8) & 0o007:
            _warn_of_all(config, operations.events)
        if config.control.address:
            doors.append(_control_tcp_listener(config, environ, operations.events))
        undo.pop_all()
    return ControlServer(operations, doors, Limits(clients=config.control.max_clients))


def _warn_of_all(config: Config, events: EventLog) -> None:
    events.add(
        Severity.WARNING,
        "control_for_all",
        f"control.mode {config.control.mode}: every user of this computer may steer the mapper; "
        "660 lets its group alone",
    )


def _control_tcp_listener(config: Config, environ: Mapping[str, str], events: EventLog) -> Listener:
    control = config.control
    path = token_file(control.token_file, environ)
    if path is None:
        raise ConfigError(
            "control.address needs a token: set control.token_file, or give systemd the "
            f"credential {CONTROL_CREDENTIAL}",
            "$.control.token_file",
        )
    if control.tls_key and not control.tls_certificate:
        raise ConfigError("control.tls_key has no certificate", "$.control.tls_certificate")
    tls = server_tls(control.tls_certificate, control.tls_key) if control.tls_certificate else None
    host, _ = address_of(control.address)
    if tls is None and not host.is_loopback:
        events.add(
            Severity.WARNING,
            "control_in_clear",
            f"control at {control.address}: everybody on that network can read along, and take "
            "over a connection; control.tls_certificate prevents it",
        )
    return open_tcp_listener(control.address, read_token(path), tls)
