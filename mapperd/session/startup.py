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
    map_recorded_sessions,
    recover,
    replay_sessions,
    unmapped_sessions,
)
from mapperd.session.store_session import SqlitePersistence
from mapperd.store.maintenance import (
    Verification,
    position_of_damaged,
    put_aside,
    rebuild_lost,
)
from mapperd.store.position import Position, position_in, with_incomplete
from mapperd.store.tile_store import TileStore

__all__ = ["OpenMap", "open_map"]

VERIFIED_FIRST_BYTES = 64 << 20
"""A map file up to this size is verified before the session, a larger one during it."""


MAX_NAMED = 5
"""Sessions in the text of an event; its facts hold all."""


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
    verification = startup.verification_of(store)

    def close() -> None:
        if verification is not None:
            verification.stop()
            startup.log_unverified(verification)
        store.close()

    persistence = SqlitePersistence(
        store,
        sonar_map,
        session,
        position,
        not_mapped=startup.not_mapped,
        data_lost=startup.data_lost,
        interval_s=interval_s,
        on_trouble=startup.log_trouble,
        on_damage=startup.log_damage,
        on_begin=(lambda: None) if verification is None else verification.start,
        on_loss=startup.log_loss,
        on_broken=startup.log_broken,
        must_begin=config.recording.require_space,
    )
    if sessions:
        text = (
            f"the map of {len(sessions)} earlier sessions continues: the odometry's world must be "
            "theirs (docs/reference/store.md); `mapperctl reset` starts another map"
        )
        events.add(Severity.NOTICE, "map_continued", text, sessions=len(sessions))
    origin_deg = None if position is None else position.origin_deg
    return OpenMap(sonar_map, persistence, close, origin_deg)


class _Startup:
    def __init__(self, config: Config, path: Path, folder: Path, events: EventLog) -> None:
        self.path = path
        self.not_mapped: dict[str, str] = {}
        self.data_lost = False
        self._not_recovered = ""
        self._config = config
        self._folder = folder
        self._events = events
        self._trouble: str | None = None
        self._damaged = DamagedData(allowed=config.recording.allow_damaged)
        self._is_verified = False

    def opened(self) -> tuple[SonarMap, TileStore, Position | None]:
        """Return the map, up to date and complete as far as the recordings reach."""
        sonar_map, store = self._open()
        position = position_in(store.position)
        try:
            if position is not None and not position.whole:
                problem = self._recover(store, sonar_map, position)
                sonar_map, store = self._again(store)
                position = position_in(store.position)
                if problem is not None:
                    position = with_incomplete(position, *problem)
            if store.lost and position is not None and position.whole:
                self._rebuild(store, sonar_map, position)
                sonar_map, store = self._again(store)
            elif store.lost:
                self._log_lost(len(store.lost), "no recording restores them")
            sonar_map, store, position = self._reconcile(store, sonar_map, position)
        except BaseException:
            store.close()
            raise
        if damage := str(self._damaged):
            text = f"damaged recordings: {damage}"
            self._events.add(Severity.ERROR, "recording_damaged", text)
        return sonar_map, store, position

    def verification_of(self, store: TileStore) -> Verification | None:
        """Return the verification of a file that is still to be done during the session."""
        if self._is_verified:
            return None
        with contextlib.suppress(OSError):
            self._unverified.touch()
        return Verification(store, self._log_verification)

    def log_loss(self, problem: str) -> None:
        """Log that the session is not in the file as a whole at its end."""
        text = f"the map is not saved as a whole: {problem}"
        self._events.add(Severity.ERROR, "map_not_saved", text)

    def log_damage(self, count: int) -> None:
        """Log bricks that were found damaged during the session."""
        self._log_lost(count, "the next start rebuilds them from the recordings")

    def log_broken(self, problem: StoreError) -> None:
        """Log that the file is damaged as a whole; the next start rebuilds it."""
        text = f"{problem}; the map may have holes"
        if problem.reason == "damaged":
            with contextlib.suppress(StoreError):
                self._mark()
            text += " until the next start rebuilds it from the recordings"
        self._events.add(Severity.ERROR, "store_damaged", text, path=str(self.path))

    def log_unverified(self, verification: Verification) -> None:
        """Log that the session ended before the file was verified."""
        if verification.state in ("waiting", "running"):
            text = "the session ended before the map file was verified; the next start verifies it"
            self._events.add(Severity.NOTICE, "map_not_verified", text)

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

    @property
    def _unverified(self) -> Path:
        """Marker beside a large file until a verification has reached its end."""
        return self.path.with_name(f"{self.path.name}.unverified")

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
        """Open the file and verify it; a large one only after a session that left it unverified."""
        sonar_map, store = self._at_path()
        try:
            position = position_in(store.position)
            is_interrupted = position is not None and not position.whole
            is_doubtful = is_interrupted or self._unverified.exists()
            self._is_verified = is_doubtful or self.path.stat().st_size <= VERIFIED_FIRST_BYTES
            if self._is_verified:
                store.check()
                self._forget_doubt()
        except BaseException:
            store.close()
            raise
        if not store.had_checksum:
            text = f"{self.path}: a file of an earlier version, whose settings cannot be verified"
            self._events.add(Severity.NOTICE, "map_without_checksum", text)
        return sonar_map, store

    def _rebuild_file(self, error: StoreError) -> tuple[SonarMap, TileStore]:
        """Put the damaged file aside and map the recordings into a new one."""
        mark = self._rebuilding
        self._mark()
        self._is_verified = True
        aside = put_aside(self.path)
        text = f"{error}; it was renamed to {aside.name}, and a new file was created"
        self._events.add(Severity.ERROR, "store_damaged", text, path=str(aside))
        sessions, _, _ = unmapped_sessions(self._config, self._folder, None, empty=True)
        self.not_mapped = _lost_with(aside, sessions)
        sonar_map, store = self._at_path()
        if not sessions:
            mark.unlink()
            return sonar_map, store
        try:
            pings, failed = map_recorded_sessions(
                store, sonar_map, sessions, self._folder, self._damaged
            )
            self.not_mapped |= failed
        except BaseException:
            store.close()
            raise
        mark.unlink()
        text = f"{pings} pings of {len(sessions)} recorded sessions were mapped again"
        self._events.add(Severity.WARNING, "map_rebuilt", text, pings=pings)
        return self._again(store)

    def _reconcile(
        self, store: TileStore, sonar_map: SonarMap, position: Position | None
    ) -> tuple[SonarMap, TileStore, Position | None]:
        """Map the recorded sessions that the file lacks, and name those that cannot be mapped."""
        sessions, reasons, ours = unmapped_sessions(
            self._config, self._folder, position, empty=sonar_map.core.revision == 0
        )
        self.data_lost = bool(ours or self.not_mapped)
        sessions = tuple(session for session in sessions if session not in self.not_mapped)
        if sessions:
            pings, failed = map_recorded_sessions(
                store, sonar_map, sessions, self._folder, self._damaged, before=position
            )
            reasons |= failed
            self.data_lost |= bool(failed)
            held = "lacked" if position is not None else "holds no session; it lacked"
            text = (
                f"the map file {held} {len(sessions)} recorded sessions; {pings} pings of them "
                "were mapped now"
            )
            facts = {"sessions": list(sessions), "pings": pings}
            self._events.add(Severity.WARNING, "sessions_mapped", text, **facts)
            sonar_map, store = self._again(store)
            position = position_in(store.position)
        self.not_mapped |= reasons
        for session, why in self.not_mapped.items():
            position = with_incomplete(position, session, why)
        self._name_sessions(position)
        return sonar_map, store, position

    def _name_sessions(self, position: Position | None) -> None:
        """Name the recorded sessions that are not in the map, or only in part."""
        named = self.not_mapped | ({} if position is None else position.incomplete)
        named.pop(self._not_recovered, None)  # which has an event of its own
        if not named:
            return
        listed = "; ".join(f"{session}: {why}" for session, why in list(named.items())[:MAX_NAMED])
        more = f"; and {len(named) - MAX_NAMED} more" if len(named) > MAX_NAMED else ""
        text = f"recorded sessions that are not in the map as a whole: {listed}{more}"
        is_lost = self.data_lost or (position is not None and bool(position.incomplete))
        severity = Severity.ERROR if is_lost else Severity.WARNING
        self._events.add(severity, "sessions_not_mapped", text, sessions=named)

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
            lambda scratch: (
                replay_sessions(
                    scratch, position.sessions, self._folder, self._damaged, ends=position.ends
                )
                and not position.incomplete
                and not position.unrecorded
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
        if problem is not None:
            self.log_broken(problem)
            return
        self._forget_doubt()
        self._events.add(Severity.INFO, "map_verified", "the map file was verified")

    def _forget_doubt(self) -> None:
        with contextlib.suppress(OSError):
            self._unverified.unlink(missing_ok=True)

    def _recover(
        self, store: TileStore, sonar_map: SonarMap, position: Position
    ) -> tuple[str, str] | None:
        """Map the rest of the last session; return it with the problem, if there is one."""
        recovered = recover(store, sonar_map, position, self._folder, self._damaged)
        if recovered is None:
            return None
        session, pings = recovered.session, recovered.pings
        if recovered.problem is None:
            text = f"session {session} was interrupted: its last {pings} pings were mapped now"
            if recovered.from_start:
                text += f", read from the recording's start because {recovered.from_start}"
            self._events.add(Severity.NOTICE, "recovered", text, session=session, pings=pings)
        else:
            text = f"the end of session {session} is not in the map: {recovered.problem}"
            self._events.add(Severity.ERROR, "not_recovered", text, session=session)
            self._not_recovered = session
            return session, recovered.problem
        return None


def _lost_with(aside: Path, recorded: tuple[str, ...]) -> dict[str, str]:
    """Return what of a damaged file no recording restores, with the reason.

    Args:
        aside: the file.
        recorded: sessions that are mapped again.
    """
    position = position_of_damaged(aside)
    if position is None:
        return {} if recorded else {aside.name: "no recording restores what was in it"}
    lost = {
        session: f"its recordings are gone, and {aside.name} is damaged"
        for session in position.sessions
        if session not in recorded
    }
    for session in position.unrecorded:
        lost.setdefault(session, f"a part of it was in {aside.name} only")
    return lost
