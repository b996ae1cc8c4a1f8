"""Where the Unix socket is: for the daemon that makes it, and for those who look for it."""

from collections.abc import Mapping
from pathlib import Path

from mapperd.config.paths import state_folder
from mapperd.config.tree import Config

__all__ = [
    "MAP_SOCKET",
    "SOCKET",
    "SYSTEM",
    "map_socket_path",
    "map_socket_places",
    "socket_path",
    "socket_places",
]

SOCKET = "mapperd.sock"

MAP_SOCKET = "mapperd-map.sock"
"""Of the map stream, in the same folder."""

SYSTEM = Path("/run/mapperd")
"""What systemd makes of `RuntimeDirectory=mapperd`."""


def socket_path(config: Config, environ: Mapping[str, str]) -> Path:
    """Where a daemon listens: `control.socket`, else in systemd's runtime folder, or the user's.

    Args:
        config: the settings.
        environ: the process's variables: $RUNTIME_DIRECTORY is systemd's, $XDG_RUNTIME_DIR the
            user's; with neither, the socket is in the folder of the maps.
    """
    if config.control.socket:
        return Path(config.control.socket)
    given = environ.get("RUNTIME_DIRECTORY", "").partition(":")[0]
    for folder in (given, environ.get("XDG_RUNTIME_DIR", "")):
        if Path(folder).is_absolute():
            return Path(folder) / SOCKET
    return state_folder(config, environ) / SOCKET


def socket_places(config: Config, environ: Mapping[str, str], system: Path = SYSTEM) -> list[Path]:
    """Where to look for a daemon, in this order: the user's own, then the machine's."""
    if config.control.socket:
        return [Path(config.control.socket)]
    bare = {name: value for name, value in environ.items() if name != "RUNTIME_DIRECTORY"}
    own = socket_path(config, bare)
    return list(dict.fromkeys((own, system / SOCKET, state_folder(config, bare) / SOCKET)))


def map_socket_path(config: Config, environ: Mapping[str, str]) -> Path:
    """Where a daemon serves the map stream: `stream.socket`, else beside the control socket."""
    if config.stream.socket:
        return Path(config.stream.socket)
    return socket_path(config, environ).with_name(MAP_SOCKET)


def map_socket_places(
    config: Config, environ: Mapping[str, str], system: Path = SYSTEM
) -> list[Path]:
    """Where to look for a daemon's map stream, in this order."""
    if config.stream.socket:
        return [Path(config.stream.socket)]
    return [path.with_name(MAP_SOCKET) for path in socket_places(config, environ, system)]
