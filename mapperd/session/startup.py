"""Opens the map's file when the daemon starts, brings it up to date and repairs it."""

import contextlib
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
from mapperd.session.recordings import DamagedData
from mapperd.session.recovery import (
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
from mapperd.store.verification import Verification

__all__ = ["OpenMap", "open_map"]

VERIFIED_FIRST_BYTES = 64 << 20
"""A map file up to this size is verified before the session, a larger one during it."""


@dataclass(frozen=True, slots=True)
class OpenMap:
    """An open map for a session.

    Attributes:
        sonar_map: the map.
        persistence: of the map.
        close: closes its file.
        origin_deg: latitude and longitude of its origin; None without a position on Earth.
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
    """Open the map of the settings with the data of all earlier sessions.

    Args:
        config: the settings.
        session: id of the new session.
        events: receives what was missing or damaged, and the result of the repair.
        environ: environment variables of the process.
        interval_s: returns the time between saves.

    Raises:
        StoreError: the file cannot be used.
        ExportError: its folder cannot be created.
    """
    if not config.outofcore.use:
        sonar_map = SonarMap(config)
        return OpenMap(sonar_map, MemoryPersistence(sonar_map), lambda: None)
    startup = _Startup(
        config, map_path(config, environ), recordings_folder(config, environ), events
    )
    make_folder(startup.path.parent)
    sonar_map, store, position = startup.opened()
    sessions = () if position is None else position.sessions

    persistence = SqlitePersistence(
        store,
        sonar_map,
        session,
        sessions,
        interval_s=interval_s,
        on_trouble=startup.log_trouble,
        on_damage=startup.log_damage,
    )
    if sessions:
        text = (
            f"the map of {len(sessions)} earlier sessions goes on: the odometry's world has to be "
            "theirs (docs/reference/store.md)"
        )
        events.add(Severity.NOTICE, "map_continued", text, sessions=len(sessions))
    origin_deg = None if position is None else position.origin_deg
    return OpenMap(sonar_map, persistence, startup.verify(store), origin_deg)


class _Startup:
    def __init__(self, config: Config, path: Path, folder: Path, events: EventLog) -> None:
        self.path = path
        self._config = config
        self._folder = folder
        self._events = events
        self._trouble: str | None = None
        self._damaged = DamagedData(use=config.recording.use_damaged)
        self._is_verified = False

    def opened(self) -> tuple[SonarMap, TileStore, Position | None]:
        """Return the map, up to date and complete as far as the recordings reach."""
        sonar_map, store = self._open()
        position = position_in(store.position)
        try:
            if position is not None and not position.whole:
                self._recover(store, sonar_map, position)
                sonar_map, store = self._again(store)
                position = position_in(store.position)
            if store.lost and position is not None and position.whole:
                self._rebuild(store, sonar_map, position)
                sonar_map, store = self._again(store)
            elif store.lost:
                self._log_lost(len(store.lost), "no recording restores them")
        except BaseException:
            store.close()
            raise
        if self._damaged.bytes:
            text = f"damaged recordings: {self._damaged}"
            self._events.add(Severity.ERROR, "recording_damaged", text)
        return sonar_map, store, position

    def verify(self, store: TileStore) -> Callable[[], None]:
        """Verify a file in the background if that is still to be done; return what closes it."""
        if self._is_verified:
            return store.close
        verification = Verification(store, self._log_verification)

        def close() -> None:
            verification.stop()
            store.close()

        return close

    def log_damage(self, count: int) -> None:
        """Log bricks that were found damaged during the session."""
        self._log_lost(count, "the next start rebuilds them from the recordings")

    def log_trouble(self, problem: str | None) -> None:
        """Log when saving starts to fail, and when it works again."""
        before, self._trouble = self._trouble, problem
        if problem is not None and before is None:
            self._events.add(Severity.WARNING, "store_stuck", f"the map cannot be saved: {problem}")
        elif problem is None and before is not None:
            self._events.add(Severity.NOTICE, "store_saves", "the map is saved again")

    @property
    def _rebuilding(self) -> Path:
        """Marker beside a file that is being rebuilt from recordings."""
        return self.path.with_name(f"{self.path.name}.rebuilding")

    def _open(self) -> tuple[SonarMap, TileStore]:
        try:
            if self._rebuilding.exists():
                self._at_path()[1].close()  # fails if another mapperd uses the file
                text = f"{self.path}: it was found damaged, and is not rebuilt yet"
                return self._rebuild_file(StoreError(text, "damaged"))
            return self._checked()
        except StoreError as error:
            if error.reason != "damaged":
                raise
            return self._rebuild_file(error)

    def _checked(self) -> tuple[SonarMap, TileStore]:
        """Open the file and verify it; a large one only after an interrupted session."""
        sonar_map, store = self._at_path()
        position = position_in(store.position)
        is_interrupted = position is not None and not position.whole
        self._is_verified = is_interrupted or self.path.stat().st_size <= VERIFIED_FIRST_BYTES
        try:
            if self._is_verified:
                store.check()
        except BaseException:
            store.close()
            raise
        return sonar_map, store

    def _rebuild_file(self, error: StoreError) -> tuple[SonarMap, TileStore]:
        """Put the damaged file aside and map the recordings into a new one."""
        mark = self._rebuilding
        self._mark()
        self._is_verified = True
        aside = put_aside(self.path)
        text = f"{error}; it was renamed to {aside.name}, and a new file was created"
        self._events.add(Severity.ERROR, "store_damaged", text, path=str(aside))
        sessions = sessions_for(self._config, self._folder)
        sonar_map, store = self._at_path()
        if not sessions:
            mark.unlink()
            return sonar_map, store
        try:
            pings = map_recorded_sessions(store, sonar_map, sessions, self._folder, self._damaged)
        except BaseException:
            store.close()
            raise
        mark.unlink()
        text = f"{pings} pings of {len(sessions)} recorded sessions were mapped again"
        self._events.add(Severity.WARNING, "map_rebuilt", text, pings=pings)
        if headless := headless_in(self._folder):
            text = (
                f"{headless} recorded sessions cannot be mapped again: the disk budget has "
                "deleted their first files"
            )
            self._events.add(Severity.ERROR, "sessions_lost", text, sessions=headless)
        return self._again(store)

    def _mark(self) -> None:
        try:
            self._rebuilding.touch()
        except OSError as problem:
            text = f"{self._rebuilding}: {problem.strerror}"
            raise StoreError(text, "read_only") from problem

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
            lambda scratch: replay_sessions(
                scratch, position.sessions, self._folder, self._damaged
            ),
        )
        left = len(store.lost)
        if left:
            self._log_lost(left, f"of {count}, these could not be rebuilt from the recordings")
        else:
            text = f"{count} damaged bricks of the map were rebuilt from recordings"
            self._events.add(Severity.WARNING, "bricks_rebuilt", text, bricks=count)

    def _log_lost(self, count: int, why: str) -> None:
        text = f"{count} bricks of the map file are damaged, their space is unknown: {why}"
        self._events.add(Severity.ERROR, "bricks_lost", text, bricks=count)

    def _log_verification(self, problem: StoreError | None) -> None:
        """Log the end of the verification; the next start rebuilds a file with a bad structure."""
        if problem is None:
            self._events.add(Severity.INFO, "map_verified", "the map file was verified")
            return
        text = f"{problem}; the map may have holes"
        if problem.reason == "damaged":
            with contextlib.suppress(StoreError):
                self._mark()
            text += " until the next start rebuilds it from the recordings"
        self._events.add(Severity.ERROR, "store_damaged", text, path=str(self.path))

    def _recover(self, store: TileStore, sonar_map: SonarMap, position: Position) -> None:
        recovered = recover(store, sonar_map, position, self._folder, self._damaged)
        if recovered is None:
            return
        session, pings = recovered.session, recovered.pings
        if recovered.problem is None:
            text = f"session {session} was interrupted: its last {pings} pings were mapped now"
            if recovered.from_start:
                text += f", read from the recording's start because {recovered.from_start}"
            self._events.add(Severity.NOTICE, "recovered", text, session=session, pings=pings)
        else:
            text = f"the end of session {session} is not in the map: {recovered.problem}"
            self._events.add(Severity.ERROR, "not_recovered", text, session=session)
