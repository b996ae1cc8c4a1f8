"""The server of the map stream that the settings ask for."""

import socket
from collections.abc import Callable, Mapping
from contextlib import ExitStack

from mapperd.api import Operations
from mapperd.config.tree import Config
from mapperd.daemon.session import Live
from mapperd.errors import ConfigError
from mapperd.events import EventLog, Severity
from mapperd.server.listeners import (
    Door,
    address_of,
    inherited_door,
    open_tcp_door,
    open_unix_door,
    server_tls,
)
from mapperd.server.source_protocol import Source
from mapperd.server.state_feed import Feed
from mapperd.server.stream_server import StreamServer
from mapperd.wire.auth import read_token, token_file
from mapperd.wire.socket_paths import map_socket_path

__all__ = ["CREDENTIAL", "FOLLOWS", "map_doors", "stream_server"]

CREDENTIAL = "stream-token"
"""Name of systemd's credential."""

FOLLOWS = ("stream.rate",)
"""Live settings of its own, read anew whenever they count."""


def stream_server(
    operations: Operations,
    live: Live,
    source: Source,
    environ: Mapping[str, str],
    *,
    now_ns: Callable[[], int],
    inherited: socket.socket | None = None,
) -> StreamServer:
    """Open the doors and listen to the pings; nobody is served before the server is entered.

    Args:
        operations: the daemon; its settings say where to listen.
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
    doors = map_doors(settings.current, operations.events, environ, inherited)
    feed = Feed(operations, lambda: live.mapping.facts, settings.current.stream.path_points)
    live.mapping.integration.on_ping = feed.put
    settings.follow(FOLLOWS, lambda _: None)
    return StreamServer(operations, doors, feed, source, now_ns=now_ns)


def map_doors(
    config: Config,
    events: EventLog,
    environ: Mapping[str, str],
    inherited: socket.socket | None = None,
) -> list[Door]:
    """The Unix socket, and that of TCP where the settings have one. Raises as `stream_server`."""
    mode = int(config.stream.mode, 8)
    with ExitStack() as undo:
        if inherited is None:
            doors = [open_unix_door(map_socket_path(config, environ), mode)]
        else:
            doors = [inherited_door(inherited, "stream")]
        undo.callback(doors[0].close)
        if inherited is None and mode & 0o007:
            said = (
                f"stream.mode {config.stream.mode}: every user of this computer may steer the "
                "mapper; 660 lets its group alone"
            )
            events.add(Severity.WARNING, "stream_for_all", said)
        if config.stream.address:
            doors.append(_tcp_door(config, environ, events))
        undo.pop_all()
    return doors


def _tcp_door(config: Config, environ: Mapping[str, str], events: EventLog) -> Door:
    stream = config.stream
    path = token_file(stream.token_file, environ, CREDENTIAL)
    token = None if path is None else read_token(path, "$.stream.token_file")
    host, _ = address_of(stream.address, "stream")
    if token is None and not host.is_loopback:
        raise ConfigError(
            f"stream.address {stream.address} needs a token: set stream.token_file, or give "
            f"systemd the credential {CREDENTIAL}; allowed without one: addresses of the loopback",
            "$.stream.token_file",
        )
    if stream.tls_key and not stream.tls_certificate:
        raise ConfigError("stream.tls_key has no certificate", "$.stream.tls_certificate")
    tls = None
    if stream.tls_certificate:
        tls = server_tls(stream.tls_certificate, stream.tls_key, "stream")
    elif not host.is_loopback:
        said = (
            f"map stream at {stream.address}: everybody on that network can read along, and take "
            "over a connection; stream.tls_certificate prevents it"
        )
        events.add(Severity.WARNING, "stream_in_clear", said)
    return open_tcp_door(stream.address, token, tls, "stream")
