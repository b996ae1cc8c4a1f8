"""Where the daemon keeps things."""

from collections.abc import Mapping
from pathlib import Path

from mapperd.config.tree import Config

__all__ = ["map_path", "pose_path", "recordings_folder", "state_folder"]


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
    """Of the estimate that localization goes on from after a restart."""
    if config.localization.pose_path:
        return Path(config.localization.pose_path)
    return state_folder(config, environ) / "localization-pose.json"


def map_path(config: Config, environ: Mapping[str, str]) -> Path:
    """Of the map's file."""
    if config.outofcore.map_path:
        return Path(config.outofcore.map_path)
    return state_folder(config, environ) / "mapperd.map"
