"""The control server that the settings ask for."""

import socket
from collections.abc import Mapping
from contextlib import ExitStack

from mapperd.api import Operations
from mapperd.config.tree import Config
from mapperd.errors import ConfigError
from mapperd.events import EventLog, Severity
from mapperd.server.control_server import ControlServer
from mapperd.server.listeners import (
    Door,
    address_of,
    inherited_door,
    open_tcp_door,
    open_unix_door,
    server_tls,
)
from mapperd.wire.auth import CREDENTIAL, read_token, token_file
from mapperd.wire.limits import Limits
from mapperd.wire.socket_paths import socket_path

__all__ = ["control_server"]


def control_server(
    operations: Operations, environ: Mapping[str, str], inherited: socket.socket | None = None
) -> ControlServer:
    """Open the doors; nobody is served before the server is entered, `async with`.

    Args:
        operations: the daemon; its settings say where to listen.
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
            doors = [open_unix_door(socket_path(config, environ), int(config.control.mode, 8))]
        else:
            doors = [inherited_door(inherited)]
        undo.callback(doors[0].close)
        if inherited is None and int(config.control.mode, 8) & 0o007:
            _warn_of_all(config, operations.events)
        if config.control.address:
            doors.append(_tcp_door(config, environ, operations.events))
        undo.pop_all()
    return ControlServer(operations, doors, Limits(clients=config.control.max_clients))


def _warn_of_all(config: Config, events: EventLog) -> None:
    events.add(
        Severity.WARNING,
        "control_for_all",
        f"control.mode {config.control.mode}: every user of this computer may steer the mapper; "
        "660 lets its group alone",
    )


def _tcp_door(config: Config, environ: Mapping[str, str], events: EventLog) -> Door:
    control = config.control
    path = token_file(control.token_file, environ)
    if path is None:
        raise ConfigError(
            "control.address needs a token: set control.token_file, or give systemd the "
            f"credential {CREDENTIAL}",
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
    return open_tcp_door(control.address, read_token(path), tls)
