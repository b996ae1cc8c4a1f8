"""Where the map of a daemon is kept: what the mapping thread tells whoever keeps it."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

from mapperd.localization.session import LocalizationSession
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.decoder import SessionDecoder, Work
from mapperd.pipeline.watchdog import Worker
from mapperd.store.position import RecordingOffsets

if TYPE_CHECKING:
    from mapperd.store.tile_store import TileStore

__all__ = ["MapPersistence", "MemoryPersistence"]


class MapPersistence(Protocol):
    """Keeps the map; all but `save`, `whole` and `status` is called in the mapping thread."""

    @property
    def store(self) -> "TileStore | None":
        """The map's file; None where there is none."""

    def begin(
        self,
        engine: SessionDecoder,
        places: RecordingOffsets,
        wake: Callable[[], None],
        localizing: LocalizationSession | None = None,
    ) -> None:
        """Before the first chunk.

        Args:
            engine: of the session.
            places: of the recording.
            wake: lets the thread come to `between` soon; any thread.
            localizing: what the poses depend on; None where they do not.
        """

    def between(self, number: int, waiting: int) -> None:
        """Now and then between two chunks.

        Args:
            number: of the piece of the recording that was taken last.
            waiting: pieces of work that wait.
        """

    def end(self) -> None:
        """All of the session is in the map."""

    def stop(self) -> None:
        """Nothing more comes, whether all is in the map or not; any thread."""

    def done(self, work: Work) -> None:
        """A piece of work is in the map."""

    def reset(self) -> None:
        """Empty the map.

        Raises:
            StoreError: it cannot be; nothing is changed.
        """

    def save(self) -> int | None:
        """Bring the map to the disk, any thread but the event loop's; returns the bytes written.

        Returns:
            None where there is no disk to bring it to.

        Raises:
            StoreError: it cannot be written.
        """

    def whole(self) -> SonarMap:
        """The whole map in memory, to be read only; any thread but the event loop's.

        Raises:
            StoreError: it cannot be read.
        """

    def worker(self) -> Worker:
        """For a watchdog: the thread that writes; any thread."""

    def status(self) -> dict[str, Any] | None:
        """For a person; None where the map is in memory alone."""


class MemoryPersistence:
    """The map ends with the program."""

    store = None

    def __init__(self, sonar_map: SonarMap) -> None:
        self._map = sonar_map

    def begin(
        self,
        engine: SessionDecoder,
        places: RecordingOffsets,
        wake: Callable[[], None],
        localizing: LocalizationSession | None = None,
    ) -> None:
        """Nothing to be done."""

    def between(self, number: int, waiting: int) -> None:
        """Nothing to be done."""

    def end(self) -> None:
        """Nothing to be done."""

    def stop(self) -> None:
        """Nothing to be done."""

    def done(self, work: Work) -> None:
        """Nothing to be done."""

    def reset(self) -> None:
        """Empty the map."""
        self._map.core.clear()

    def save(self) -> int | None:
        """There is no disk."""
        return None

    def whole(self) -> SonarMap:
        """The map itself."""
        return self._map

    def worker(self) -> Worker:
        """There is no thread."""
        return Worker("saving", 0, 0)

    def status(self) -> dict[str, Any] | None:
        """There is nothing to say."""
        return None
