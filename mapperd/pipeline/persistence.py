"""Interface of the map's persistence, and the one that keeps the map in memory only."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

from mapperd.localization.session import LocalizationSession
from mapperd.mapping.queries import MapContent
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.decoder import SessionDecoder, Work
from mapperd.pipeline.watchdog import Worker
from mapperd.store.position import RecordingOffsets

if TYPE_CHECKING:
    from mapperd.store.tile_store import TileStore

__all__ = ["MapPersistence", "MemoryPersistence", "TilePersistence"]


class MapPersistence(Protocol):
    """Keeps the map. Only `save`, `whole` and `status` may be called outside the mapping thread."""

    @property
    def store(self) -> "TileStore | None":
        """The map's file; None without one."""

    def begin(
        self,
        decoder: SessionDecoder,
        offsets: RecordingOffsets,
        wake: Callable[[], None],
        localization: LocalizationSession | None = None,
    ) -> None:
        """Begin a session, before its first chunk.

        Args:
            decoder: of the session.
            offsets: of the recording.
            wake: makes the mapping thread call `between` soon; any thread.
            localization: the one that affects the map; None without one.
        """

    def between(self, number: int, waiting: int) -> None:
        """Called regularly between two chunks.

        Args:
            number: of the last decoded piece of the recording.
            waiting: number of waiting pieces of work.
        """

    def end(self) -> None:
        """The whole session is in the map."""

    def stop(self) -> None:
        """The session ends, with or without all its work; any thread."""

    def done(self, work: Work) -> None:
        """A piece of work is finished, in order."""

    def lose_ping(self, why: str) -> None:
        """A ping is not in the map, and no later run maps it; `done` follows."""

    def reset(self) -> None:
        """Empty the map.

        Raises:
            StoreError: the map cannot be emptied; it is unchanged.
        """

    def save(self) -> int | None:
        """Write the map to the disk; return the written bytes, None without a file. Blocks.

        Raises:
            StoreError: the file cannot be written.
        """

    def whole(self) -> MapContent:
        """Return the whole map, as last saved; the caller closes it. Blocks.

        Raises:
            StoreError: the file cannot be read.
        """

    def worker(self) -> Worker:
        """Return what the watchdog watches."""

    def status(self) -> dict[str, Any] | None:
        """Return the status for a person; None without a file."""


class MemoryPersistence:
    """A map in memory only.

    Args:
        sonar_map: the map.
    """

    store = None

    def __init__(self, sonar_map: SonarMap) -> None:
        self._map = sonar_map

    def begin(
        self,
        decoder: SessionDecoder,
        offsets: RecordingOffsets,
        wake: Callable[[], None],
        localization: LocalizationSession | None = None,
    ) -> None:
        """Do nothing."""

    def between(self, number: int, waiting: int) -> None:
        """Do nothing."""

    def end(self) -> None:
        """Do nothing."""

    def stop(self) -> None:
        """Do nothing."""

    def done(self, work: Work) -> None:
        """Do nothing."""

    def lose_ping(self, why: str) -> None:
        """Do nothing: the counters state it."""

    def reset(self) -> None:
        """Empty the map."""
        self._map.clear()

    def save(self) -> int | None:
        """Return None: there is no file."""
        return None

    def whole(self) -> MapContent:
        """Return the map itself."""
        return self._map

    def worker(self) -> Worker:
        """Return an idle worker."""
        return Worker("saving", 0, 0)

    def status(self) -> dict[str, Any] | None:
        """Return None: there is no file."""
        return None


class TilePersistence(MemoryPersistence):
    """A map in tiles whose file is needed only while the program runs.

    Args:
        store: the file, open.
        sonar_map: its map.
    """

    def __init__(self, store: "TileStore", sonar_map: SonarMap) -> None:
        super().__init__(sonar_map)
        self._tiles = store

    def done(self, work: Work) -> None:  # noqa: ARG002 each may have changed the map
        """Allow evicting the tiles in their current state."""
        self._tiles.advance(b"")

    def reset(self) -> None:
        """Empty the map and its file."""
        self._tiles.reset()
