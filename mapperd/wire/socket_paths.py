"""The path of the daemon's Unix socket, for the daemon and for its clients."""

from collections.abc import Mapping
from pathlib import Path

from mapperd.config.paths import state_folder
from mapperd.config.tree import Config

__all__ = ["SOCKET", "SYSTEM", "socket_path", "socket_places"]

SOCKET = "mapperd.sock"

SYSTEM = Path("/run/mapperd")
"""The folder that systemd makes for `RuntimeDirectory=mapperd`."""


def socket_path(config: Config, environ: Mapping[str, str]) -> Path:
    """Return the path that a daemon listens on.

    Args:
        config: the settings; `server.socket` comes first.
        environ: the process's variables: $RUNTIME_DIRECTORY is systemd's, $XDG_RUNTIME_DIR the
            user's; with neither, the socket is in the folder of the maps.
    """
    if config.server.socket:
        return Path(config.server.socket)
    given = environ.get("RUNTIME_DIRECTORY", "").partition(":")[0]
    for folder in (given, environ.get("XDG_RUNTIME_DIR", "")):
        if Path(folder).is_absolute():
            return Path(folder) / SOCKET
    return state_folder(config, environ) / SOCKET


def socket_places(config: Config, environ: Mapping[str, str], system: Path = SYSTEM) -> list[Path]:
    """Return where a client looks for a daemon, in order: the user's socket, then the machine's."""
    if config.server.socket:
        return [Path(config.server.socket)]
    bare = {name: value for name, value in environ.items() if name != "RUNTIME_DIRECTORY"}
    own = socket_path(config, bare)
    return list(dict.fromkeys((own, system / SOCKET, state_folder(config, bare) / SOCKET)))
