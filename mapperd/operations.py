"""What a running daemon can be asked, by whatever way: its socket, a broker, a signal."""

from typing import Any, Protocol

from mapperd.config_store import ConfigStore
from mapperd.errors import MapperdError
from mapperd.events import EventLog

__all__ = ["OperationError", "Operations"]


class OperationError(MapperdError):
    """What was asked cannot be done; nothing changed.

    Attributes:
        reason: short and stable: `bad_name`, `bad_format`, `cannot_write`, `no_store`, `busy`.
    """

    def __init__(self, message: str, reason: str) -> None:
        super().__init__(message)
        self.reason = reason


class Operations(Protocol):
    """The daemon, as its servers see it. Coroutines run in the daemon's event loop."""

    @property
    def settings(self) -> ConfigStore:
        """The settings in force; changes go through it."""

    @property
    def events(self) -> EventLog:
        """What happened."""

    def status(self) -> dict[str, Any]:
        """How it goes, in plain values with units in the keys; cheap, from any thread.

        Keys: `phase`, `reason`, `version`, `uptime_s`, `sonar`, `odometry`, `pose` (None before the
        first), `pings`, `latency_ms`, `behind`, `map`, `store`, `recording`, `robots`, `servers`.
        """

    async def save(self, name: str, origin: str) -> dict[str, Any]:
        """Write the map into a file of the folder for maps.

        Args:
            name: of the file, without a folder; its suffix says the format.
            origin: who asks.

        Returns:
            `path`, `bytes`, `seconds`.

        Raises:
            OperationError: it cannot be written.
        """

    async def reset(self, origin: str) -> dict[str, Any]:
        """Empty the map; pings from the next one on fill it again.

        Raises:
            OperationError: the store cannot be emptied.
        """

    async def reload(self, origin: str) -> dict[str, Any]:
        """Read the settings' files again.

        Returns:
            `changed` (name to value), `refused` (name to reason), `waiting` (names).
        """

    async def snapshot(self, origin: str) -> dict[str, Any]:
        """Bring the map and the recording to the disk now.

        Returns:
            `bytes`, `seconds`.

        Raises:
            OperationError: there is no store, or it cannot be written.
        """
