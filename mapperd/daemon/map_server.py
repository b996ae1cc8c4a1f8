"""The map stream of a map that no live session changes: a map file, or a running replay."""

import contextlib
import tempfile
import time
from collections.abc import AsyncIterator, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mapperd import __version__
from mapperd.api import OperationError, PoseRequest, ReportedChanges
from mapperd.config.layers import Layered
from mapperd.config.live import ConfigStore
from mapperd.config.tree import Config
from mapperd.daemon.problems import lost_bricks
from mapperd.events import EventLog
from mapperd.mapping.sonar_map import SonarMap
from mapperd.server.listeners import open_unix_listener
from mapperd.server.map_source import MapSource
from mapperd.server.state_feed import StateFeed
from mapperd.server.stream_server import StreamServer
from mapperd.store.map_files import map_in
from mapperd.store.metadata import MapIdentity, fresh
from mapperd.store.stored_map import StoredMap
from mapperd.store.tiles import Key

if TYPE_CHECKING:
    from mapperd.pipeline.worker import StatusSnapshot

__all__ = ["MapServer", "StoredFile", "saved_map"]


@dataclass(slots=True)
class StoredFile:
    """A map file that others may write to, as `MapSource` reads it.

    Attributes:
        path: of the file.
        identity: of its map for clients of this process.
        lost: bricks that were damaged when it was opened.
        remarks: which sessions were incomplete in it then, for people; empty if none was.
    """

    path: Path
    identity: MapIdentity = field(default_factory=fresh)
    lost: frozenset[Key] = frozenset()
    remarks: str = ""

    def suspect(self, keys: Iterable[Key]) -> None:
        """Ignore damage: `MapSource` counts it, and only the file's writer can repair it."""


def saved_map(path: Path, config: Config) -> tuple[SonarMap, StoredFile | None]:
    """Open a map file to be shown.

    Args:
        path: as of `map_in`; a daemon's file stays on disk and is followed while it is written.
        config: settings that the file does not contain.

    Returns:
        the map in memory, and the file that holds the rest of it.

    Raises:
        MapError, StoreError, ConfigError: as of `map_in`.
    """
    source = map_in(path, config, allow_damaged=True)
    found = source.map
    if isinstance(found, SonarMap):
        return found, None
    config, lost = found.config, found.lost if isinstance(found, StoredMap) else frozenset()
    found.close()
    empty = SonarMap(config)
    empty.core.cut_into_tiles(1, lambda _: None)  # none of which is in memory
    return empty, StoredFile(path, lost=lost, remarks=source.remarks())


class _NoSession:
    """Refuses the requests of `DaemonApi` that need a live session."""

    async def save(self, name: str, origin: str) -> dict[str, Any]:
        """Refuse."""
        raise self._refusal(name, origin)

    async def reset(self, origin: str) -> dict[str, Any]:
        """Refuse."""
        raise self._refusal(origin)

    async def reload(self, origin: str) -> dict[str, Any]:
        """Refuse."""
        raise self._refusal(origin)

    async def snapshot(self, origin: str) -> dict[str, Any]:
        """Refuse."""
        raise self._refusal(origin)

    def localization(self, particles: int = 0) -> dict[str, Any]:
        """Refuse."""
        raise self._refusal(particles)

    async def initial_pose(self, asked: PoseRequest, origin: str) -> dict[str, Any]:
        """Refuse."""
        raise self._refusal(asked, origin)

    async def global_localization(self, origin: str) -> dict[str, Any]:
        """Refuse."""
        raise self._refusal(origin)

    async def request_nomotion_update(self, origin: str) -> dict[str, Any]:
        """Refuse."""
        raise self._refusal(origin)

    async def set_map(self, name: str, asked: PoseRequest | None, origin: str) -> dict[str, Any]:
        """Refuse."""
        raise self._refusal(name, asked, origin)

    def _refusal(self, *_: object) -> OperationError:
        return OperationError("no daemon maps live here", "no_session")


class MapServer(_NoSession):
    """Serves one map on a private socket; implements `DaemonApi`.

    Args:
        sonar_map: the map; create this before mapping begins.
        store: file that holds the rest of the map; None if it is in memory.
        what: what is shown, for people.
        phase: as of `DaemonApi.status`.

    Raises:
        StoreError: the file cannot be read.

    Attributes:
        store, phase: as given; the phase may change.
        settings: of the map; none may change.
        events, changes: none.
        feed: takes the pings of a replay.
        replayed: newest status of a replay; None without.
    """

    def __init__(
        self, sonar_map: SonarMap, store: StoredFile | None, what: str, phase: str
    ) -> None:
        stream = sonar_map.config.stream
        self.store = store
        self.settings = ConfigStore(Layered(sonar_map.config))
        self.events = EventLog(time.time_ns)
        self.changes = ReportedChanges()
        self.phase = phase
        self.replayed: StatusSnapshot | None = None
        self._what = what
        self.feed = StateFeed(self, lambda: self.replayed, stream.path_points)
        self._source = MapSource(sonar_map, self, log_odds_step=stream.log_odds_step)

    @contextlib.asynccontextmanager
    async def serving(self) -> AsyncIterator[str]:
        """Serve clients in this event loop; yields the address; once."""
        with tempfile.TemporaryDirectory(prefix="mapperd-") as folder, self._source:
            path = Path(folder) / "map.sock"
            listener = open_unix_listener(path, 0o600)
            async with StreamServer(self, [listener], self.feed, self._source):
                yield str(path)

    def status(self) -> dict[str, Any]:
        """Return what applies of `DaemonApi.status`."""
        pings = {} if self.replayed is None else {"pings": self.replayed.pings}
        store = {"bricks_lost": self._source.info().bricks_lost}
        problems = [{"code": one.code, "text": one.text} for one in lost_bricks(store)]
        if self.store is not None and self.store.remarks:
            problems.append({"code": "map_incomplete", "text": self.store.remarks})
        return {
            "version": __version__,
            "phase": self.phase,
            "reason": self._what,
            "problems": problems,
        } | pings
