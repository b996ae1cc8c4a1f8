"""At the start of the daemon: the map's file is opened, brought up to date, and repaired."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from mapperd.config.paths import map_path, recordings_folder
from mapperd.config.tree import Config
from mapperd.errors import StoreError
from mapperd.events import EventLog, Severity
from mapperd.io import make_folder
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.persistence import MapPersistence, MemoryPersistence
from mapperd.session.recovery import (
    Recovered,
    headless_in,
    map_recorded_sessions,
    recover,
    replay_sessions,
    sessions_for,
)
from mapperd.session.store_session import SqlitePersistence
from mapperd.store.maintenance import put_aside, rebuild_lost
from mapperd.store.position import Position, position_in
from mapperd.store.tile_store import TileStore

__all__ = ["OpenMap", "open_map"]


@dataclass(frozen=True, slots=True)
class OpenMap:
    """A map that a session can go into.

    Attributes:
        sonar_map: the map.
        persistence: of it.
        close: lets go of its file.
        origin_deg: latitude and longitude of its zero; None where nobody said a place on Earth.
    """

    sonar_map: SonarMap
    persistence: MapPersistence
    close: Callable[[], None]
    origin_deg: tuple[float, float] | None = None


def open_map(
    config: Config,
    session: str,
    events: EventLog,
    environ: Mapping[str, str],
    interval_s: Callable[[], float],
) -> OpenMap:
    """Open the map of the settings, with all that earlier sessions brought.

    Args:
        config: the settings.
        session: id of the one that begins.
        events: is told what was missing and what became of it.
        environ: the process's variables.
        interval_s: between saves.

    Raises:
        StoreError: the file cannot be used.
        ExportError: its folder cannot be made.
    """
    if not config.outofcore.use:
        sonar_map = SonarMap(config)
        return OpenMap(sonar_map, MemoryPersistence(sonar_map), lambda: None)
    opening = _Startup(
        config, map_path(config, environ), recordings_folder(config, environ), events
    )
    make_folder(opening.path.parent)
    sonar_map, store, position = opening.opened()
    sessions = () if position is None else position.sessions

    def tell(problem: str | None) -> None:
        opening.tell_trouble(problem)

    persistence = SqlitePersistence(
        store, sonar_map, session, sessions, interval_s=interval_s, on_trouble=tell
    )
    if sessions:
        text = (
            f"the map of {len(sessions)} earlier sessions goes on: the odometry's world has to be "
            "theirs (docs/reference/store.md)"
        )
        events.add(Severity.NOTICE, "map_continued", text, sessions=len(sessions))
    origin_deg = None if position is None else position.origin_deg
    return OpenMap(sonar_map, persistence, store.close, origin_deg)


class _Startup:
    def __init__(self, config: Config, path: Path, folder: Path, events: EventLog) -> None:
        self.path = path
        self._config = config
        self._folder = folder
        self._events = events
        self._trouble: str | None = None

    def opened(self) -> tuple[SonarMap, TileStore, Position | None]:
        """The map, up to date and whole as far as the recordings go."""
        sonar_map, store = self._open()
        position = position_in(store.position)
        try:
            if position is not None:
                if not position.whole:
                    self._say_recovered(recover(store, sonar_map, position, self._folder))
                    sonar_map, store = self._again(store)
                    position = position_in(store.position)
                if store.lost and position is not None and position.whole:
                    self._rebuild(store, sonar_map, position)
                    sonar_map, store = self._again(store)
        except BaseException:
            store.close()
            raise
        return sonar_map, store, position

    def tell_trouble(self, problem: str | None) -> None:
        """Say when saving begins to fail, and when it works again."""
        before, self._trouble = self._trouble, problem
        if problem is not None and before is None:
            self._events.add(Severity.WARNING, "store_stuck", f"not saved: {problem}")
        elif problem is None and before is not None:
            self._events.add(Severity.NOTICE, "store_saves", "the map is saved again")

    @property
    def _rebuilding(self) -> Path:
        """Lies beside a file that the recordings are being mapped into."""
        return self.path.with_name(f"{self.path.name}.rebuilding")

    def _open(self) -> tuple[SonarMap, TileStore]:
        try:
            if self._rebuilding.exists():
                self._at_path()[1].close()  # refused where another mapperd is at it
                return self._anew(
                    StoreError(f"{self.path}: mapping again was cut short", "damaged")
                )
            return self._checked()
        except StoreError as error:
            if error.reason != "damaged":
                raise
            return self._anew(error)

    def _checked(self) -> tuple[SonarMap, TileStore]:
        """Open the file; whoever was cut short may have left damage."""
        sonar_map, store = self._at_path()
        position = position_in(store.position)
        try:
            if position is not None and not position.whole:
                store.check()
        except BaseException:
            store.close()
            raise
        return sonar_map, store

    def _anew(self, error: StoreError) -> tuple[SonarMap, TileStore]:
        """Put the damaged file aside, and map what was recorded into a new one."""
        mark = self._rebuilding
        try:
            mark.touch()
        except OSError as problem:
            raise StoreError(f"{mark}: {problem.strerror}", "read_only") from problem
        aside = put_aside(self.path)
        text = f"{error}; it is put aside as {aside.name}, and a new one begins"
        self._events.add(Severity.ERROR, "store_damaged", text, path=str(aside))
        sessions = sessions_for(self._config, self._folder)
        sonar_map, store = self._at_path()
        if not sessions:
            mark.unlink()
            return sonar_map, store
        try:
            pings = map_recorded_sessions(store, sonar_map, sessions, self._folder)
        except BaseException:
            store.close()
            raise
        mark.unlink()
        text = f"{pings} pings of {len(sessions)} recorded sessions are mapped again"
        self._events.add(Severity.WARNING, "map_rebuilt", text, pings=pings)
        if headless := headless_in(self._folder):
            text = (
                f"{headless} recorded sessions have lost their first files to the disk budget: "
                "what they mapped is not in the map"
            )
            self._events.add(Severity.ERROR, "sessions_lost", text, sessions=headless)
        return self._again(store)

    def _at_path(self) -> tuple[SonarMap, TileStore]:
        sonar_map = SonarMap(self._config)
        settings = self._config.outofcore
        store = TileStore(
            self.path,
            sonar_map,
            tile_size_m=settings.tile_size,
            cache_tiles=settings.cache_size,
        )
        return sonar_map, store

    def _again(self, store: TileStore) -> tuple[SonarMap, TileStore]:
        store.close()
        return self._at_path()

    def _rebuild(self, store: TileStore, sonar_map: SonarMap, position: Position) -> None:
        count = rebuild_lost(
            store,
            sonar_map,
            lambda scratch: replay_sessions(scratch, position.sessions, self._folder),
        )
        left = len(store.lost)
        if left:
            text = f"{left} of {count} damaged bricks of the map could not be rebuilt as a whole"
            self._events.add(Severity.ERROR, "bricks_lost", text, bricks=left)
        else:
            text = f"{count} damaged bricks of the map were rebuilt from recordings"
            self._events.add(Severity.WARNING, "bricks_rebuilt", text, bricks=count)

    def _say_recovered(self, recovered: Recovered | None) -> None:
        if recovered is None:
            return
        session, pings = recovered.session, recovered.pings
        if recovered.problem is None:
            text = f"session {session} was cut short: its last {pings} pings are mapped now"
            if recovered.from_start:
                text += f", read from the recording's start because {recovered.from_start}"
            self._events.add(Severity.NOTICE, "recovered", text, session=session, pings=pings)
        else:
            text = f"the end of session {session} is not in the map: {recovered.problem}"
            self._events.add(Severity.ERROR, "not_recovered", text, session=session)
