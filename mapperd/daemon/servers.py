"""What runs beside the mapping: map stream, control, telemetry, debug pictures."""

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from types import MappingProxyType

from mapperd.api import DaemonApi
from mapperd.config.daemon import ControlConfig, StreamConfig
from mapperd.config.tree import Config
from mapperd.daemon.daemon import Daemon
from mapperd.daemon.debug_pictures import draw_pictures
from mapperd.daemon.session import Live
from mapperd.errors import ConfigError
from mapperd.events import EventLog, Severity
from mapperd.server.listeners import (
    Listener,
    Section,
    address_of,
    inherited_listener,
    open_tcp_listener,
    open_unix_listener,
    server_tls,
)
from mapperd.server.map_source import Source
from mapperd.server.state_feed import Feed
from mapperd.server.stream_server import StreamServer
from mapperd.telemetry.telemetry import Telemetry
from mapperd.wire.auth import CREDENTIAL as CONTROL_CREDENTIAL
from mapperd.wire.auth import read_token, token_file
from mapperd.wire.socket_paths import map_socket_path, socket_path
from oculus_driver.ping import Ping

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


CREDENTIALS: Mapping[Section, str] = MappingProxyType(
    {"control": CONTROL_CREDENTIAL, "stream": "stream-token"}
)
"""Names of systemd's credentials with tokens, by section of the settings."""

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
        inherited: Unix sockets that the service manager opened, `control` and `map`, instead of
            our own.

    Raises:
        ConfigError: an address, a token, a certificate is wrong or missing.
        LiveError: something cannot be listened at.
    """
    settings, events = operations.settings, operations.events
    with ExitStack() as undo:
        doors = open_listeners(
            "control", settings.current, events, environ, inherited.get("control")
        )
        for door in doors:
            undo.callback(door.close)
        doors += open_listeners("stream", settings.current, events, environ, inherited.get("map"))
        undo.pop_all()
    feed = Feed(operations, lambda: live.mapping.snapshot, settings.current.stream.path_points)
    live.mapping.pipeline.executor.on_ping = feed.put
    settings.follow(FOLLOWS, lambda _: None)
    return StreamServer(operations, doors, feed, source, now_ns=now_ns)


def open_listeners(
    section: Section,
    config: Config,
    events: EventLog,
    environ: Mapping[str, str],
    inherited: socket.socket | None = None,
) -> list[Listener]:
    """Open the Unix socket of a section of the settings, and its TCP socket if it has an address.

    Args:
        section: of the settings.
        config: the settings.
        events: for warnings.
        environ: as of `stream_server`.
        inherited: a Unix socket that the service manager opened, instead of our own.

    Raises:
        ConfigError, LiveError: as `stream_server`.
    """
    settings = config.control if section == "control" else config.stream
    place = socket_path if section == "control" else map_socket_path
    mode = int(settings.mode, 8)
    with ExitStack() as undo:
        if inherited is None:
            listeners = [open_unix_listener(place(config, environ), mode, section)]
        else:
            listeners = [inherited_listener(inherited, section)]
        undo.callback(listeners[0].close)
        if inherited is None and mode & 0o007:
            text = (
                f"{section}.mode {settings.mode}: every user of this computer may steer the "
                "mapper; 660 lets its group alone"
            )
            events.add(Severity.WARNING, f"{section}_for_all", text)
        if settings.address:
            listeners.append(_tcp_listener(section, settings, environ, events))
        undo.pop_all()
    return listeners


def _tcp_listener(
    section: Section,
    settings: ControlConfig | StreamConfig,
    environ: Mapping[str, str],
    events: EventLog,
) -> Listener:
    host, _ = address_of(settings.address, section)
    if settings.tls_key and not settings.tls_certificate:
        place = f"$.{section}.tls_certificate"
        raise ConfigError(f"{section}.tls_key has no certificate", place)
    tls = None
    if settings.tls_certificate:
        tls = server_tls(settings.tls_certificate, settings.tls_key, section)
    place = f"$.{section}.token_file"
    path = token_file(settings.token_file, environ, CREDENTIALS[section])
    token = None if path is None else read_token(path, place)
    if token is None and (section == "control" or not host.is_loopback):
        also = "" if section == "control" else "; allowed without one: addresses of the loopback"
        raise ConfigError(
            f"{section}.address {settings.address} needs a token: set {section}.token_file, or "
            f"give systemd the credential {CREDENTIALS[section]}{also}",
            place,
        )
    if tls is None and not host.is_loopback:
        text = (
            f"{section} at {settings.address}: everybody on that network can read along, and take "
            f"over a connection; {section}.tls_certificate prevents it"
        )
        events.add(Severity.WARNING, f"{section}_in_clear", text)
    return open_tcp_listener(settings.address, token, tls, section)
