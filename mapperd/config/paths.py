"""The daemon's folders and socket, and files that hold secrets."""

import os
import stat
from collections.abc import Mapping
from pathlib import Path

from mapperd.config.tree import Config
from mapperd.errors import ConfigError, os_reason

__all__ = [
    "SOCKET",
    "SYSTEM",
    "map_path",
    "pose_path",
    "read_secret",
    "recordings_folder",
    "socket_path",
    "socket_places",
    "state_folder",
]


def state_folder(config: Config, environ: Mapping[str, str]) -> Path:
    """For maps and the store: of the settings, else systemd's, else the user's.

    Args:
        config: for `service.state_folder`.
        environ: the process's variables.
    """
    if config.service.state_folder:
        return Path(config.service.state_folder)
    if environ.get("STATE_DIRECTORY"):
        return Path(environ["STATE_DIRECTORY"].split(":")[0])
    user = environ.get("XDG_STATE_HOME") or Path(environ.get("HOME", "/"), ".local", "state")
    return Path(user) / "mapperd"


def recordings_folder(config: Config, environ: Mapping[str, str]) -> Path:
    """For the recordings: of the settings, else systemd's for logs, else beside the maps."""
    if config.recording.folder:
        return Path(config.recording.folder)
    if environ.get("LOGS_DIRECTORY"):
        return Path(environ["LOGS_DIRECTORY"].split(":")[0])
    return state_folder(config, environ) / "recordings"


def pose_path(config: Config, environ: Mapping[str, str]) -> Path:
    """Path of the estimate that localization resumes from after a restart."""
    if config.localization.pose_path:
        return Path(config.localization.pose_path)
    return state_folder(config, environ) / "localization-pose.json"


MAP_NAME = "mapperd.map"


def map_path(config: Config, environ: Mapping[str, str]) -> Path:
    """Path of the map's file; in a folder of that name if there is one."""
    if config.outofcore.map_path:
        path = Path(config.outofcore.map_path)
        return path / MAP_NAME if path.is_dir() else path
    return state_folder(config, environ) / MAP_NAME


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


MAX_BYTES = 4096


def read_secret(
    setting: str, path: str, credential: str, environment: Mapping[str, str]
) -> str | None:
    """Read a secret: the first line of a file.

    Args:
        setting: name of the setting with the path, for messages.
        path: the file; "" takes systemd's credential where there is one.
        credential: its name among systemd's.
        environment: gives the systemd credentials directory.

    Returns:
        None where neither is there.

    Raises:
        ConfigError: the file cannot be read, everybody may write to it, or it holds no secret.
    """
    folder = environment.get("CREDENTIALS_DIRECTORY", "")
    place = Path(path) if path else Path(folder, credential)
    if not path and (not folder or not place.exists()):
        return None
    try:
        with place.open("rb") as file:
            mode = os.fstat(file.fileno()).st_mode
            data = file.read(MAX_BYTES + 1)
        line = data.decode().split("\n", 1)[0].strip("\r")
    except OSError as error:
        raise ConfigError(f"{setting}: {place}: {os_reason(error)}", f"$.{setting}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{setting}: {place}: is no text", f"$.{setting}") from error
    if mode & stat.S_IWOTH:
        what = "everybody may write to it; chmod 600 it"
        raise ConfigError(f"{setting}: {place}: {what}", f"$.{setting}")
    if not line or len(data) > MAX_BYTES:
        what = "is empty" if not line else f"is longer than {MAX_BYTES} bytes"
        raise ConfigError(f"{setting}: {place}: {what}", f"$.{setting}")
    return line
