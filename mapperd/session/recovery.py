"""After a crash: maps the part of the recordings that is missing in the map's file.

Lost parts of the file are restored from the recordings of all its sessions.
"""

import time
from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import msgspec
import numpy as np

from mapperd.config.loader import config_of
from mapperd.config.tree import Config
from mapperd.errors import CheckpointError, ConfigError, ReplayError, StoreError
from mapperd.geometry.frames import Pose
from mapperd.localization.session import (
    LocalizationSession,
    poses_depend_on,
    restored_session,
    saved_state,
)
from mapperd.mapping.arc import SurfaceLevelState
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.build import build_pipeline
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.decoder import SessionDecoder, SessionDecoderState, Work
from mapperd.pipeline.pose_lookup import FixedPose, OdometryPoses
from mapperd.session.recordings import (
    DamagedData,
    RecordedSession,
    Tail,
    files_of,
    number_of,
    recorded_in,
)
from mapperd.session.replay import Window, as_recorded
from mapperd.session.store_session import SqlitePersistence
from mapperd.session_log import Remarks, remarks_in, without_skipped
from mapperd.store.checkpoint import decode_state, encode_state
from mapperd.store.metadata import differences, kind_of
from mapperd.store.position import Position, RecordingOffset, position_in, with_incomplete
from mapperd.store.tile_store import TileStore

__all__ = [
    "Recovered",
    "StoredSession",
    "config_at",
    "map_recorded_sessions",
    "map_rest",
    "recover",
    "replay_sessions",
    "unmapped_sessions",
]

NOWHERE = Pose(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))


@dataclass(frozen=True, slots=True)
class Recovered:
    """Result of the recovery of an interrupted session.

    Attributes:
        session: its id.
        pings: pings mapped by the recovery.
        seconds: duration of the recovery.
        problem: why the rest of the session is not in the map; None if it is.
        from_start: why the estimators were computed again from the start of the recording; empty
            if they were restored from the checkpoint.
    """

    session: str
    pings: int
    seconds: float
    problem: str | None = None
    from_start: str = ""


def config_at(position: Position) -> Config:
    """Return the settings in force at a position's checkpoint.

    Raises:
        CheckpointError: this version does not accept them.
    """
    try:
        return config_of(position.config or {}, "the checkpoint")
    except ConfigError as error:
        raise CheckpointError(str(error)) from error


def restore_decoder(decoder: SessionDecoder, position: Position) -> None:
    """Restore the decoder's state of a position's checkpoint.

    Raises:
        CheckpointError: the checkpoint is damaged or of an unknown format.
    """
    state = decode_state(position.checkpoint, SessionDecoderState)
    try:
        decoder.restore(state)
    except (ValueError, TypeError, KeyError) as error:
        raise CheckpointError(f"the checkpoint cannot be read: {error}") from error
    decoder.counters.pings_total += decoder.waiting  # what becomes of them is counted from here


def restore_surface(sonar_map: SonarMap, position: Position) -> None:
    """Restore the estimated level of surfaces of a position's checkpoint.

    Raises:
        CheckpointError: the checkpoint is damaged or of an unknown format.
    """
    if sonar_map.surface is None:
        return
    try:
        sonar_map.surface.restore(decode_state(position.surface, SurfaceLevelState))
    except ValueError as error:
        raise CheckpointError(f"the checkpoint cannot be read: {error}") from error


def _fresh_poses(position: Position, config: Config) -> FixedPose | OdometryPoses:
    return FixedPose(NOWHERE) if position.fixed else OdometryPoses(config)


def _restored(position: Position) -> tuple[Config, LocalizationSession | None]:
    """Check that a position's checkpoint can be restored; return its settings and localization.

    Raises:
        CheckpointError: it cannot be restored.
    """
    config = config_at(position)
    poses = _fresh_poses(position, config)
    trial = SessionDecoder(config, poses, PipelineCounters(), confirm=False, obey=True)
    restore_decoder(trial, position)
    restore_surface(SonarMap(config), position)
    if not position.localization:
        return config, None
    return config, restored_session(config, position.localization)


def _is_headless(files: dict[int, Path], session: str) -> bool:
    """Return whether a session's files hold data, but not its beginning."""
    recorded = RecordedSession(list(files.values()), session)
    return recorded.beginning() is None and any(True for _ in recorded)


def _at_start(position: Position, files: dict[int, Path], damaged: DamagedData) -> Position:
    """Return a position with a checkpoint at the start of the recording instead of its own.

    The decoder repeats all pieces of work from there; those that are in the map are skipped.

    Raises:
        CheckpointError: the start of the recording is missing.
        ConfigError: its settings or its known map cannot be used.
    """
    paths = list(files.values())
    recorded = RecordedSession(paths, position.session, damaged) if files else None
    if recorded is None or recorded.beginning() is None:
        raise CheckpointError("the start of its recordings is missing")
    run = as_recorded(recorded)
    localization = poses_depend_on(run.localization)
    surface = SonarMap(run.config).surface
    decoder = SessionDecoder(run.config, run.poses, PipelineCounters(), confirm=False, obey=True)
    at_start = msgspec.structs.replace(
        position,
        place=RecordingOffset(),
        config=msgspec.to_builtins(run.config),
        fixed=isinstance(run.poses, FixedPose),
        checkpoint=encode_state(decoder.state()),
        localization=b"" if localization is None else saved_state(localization),
        surface=b"" if surface is None else encode_state(surface.state()),
    )
    tail, done = Tail(files, RecordingOffset(), damaged), position.done
    for chunk in without_skipped(tail):
        if tail.place > position.place:
            break
        done += len(decoder.feed(chunk))
    return msgspec.structs.replace(at_start, done=done)


def recover(
    store: TileStore,
    sonar_map: SonarMap,
    position: Position,
    folder: Path,
    damaged: DamagedData | None = None,
) -> Recovered | None:
    """Map the rest of the last session; its settings are then in force.

    Args:
        store: just opened.
        sonar_map: its map.
        position: of the store.
        folder: of the recordings.
        damaged: data that fail their checksum; by default they are not mapped.

    Returns:
        None if nothing was missing.

    Raises:
        StoreError: the file cannot be written.
        MapError: nothing can be saved, so nothing more can be mapped.
    """
    if position.whole:
        return None
    began_s = time.monotonic()
    damaged = damaged or DamagedData()
    files = files_of(folder, position.session)
    counters = PipelineCounters()
    problem, from_start = None, ""
    try:
        try:
            config, localization = _restored(position)
        except CheckpointError as error:
            from_start, position = str(error), _at_start(position, files, damaged)
            config, localization = _restored(position)
        sonar_map.reconfigure(config)
        if not any(number >= position.place.file for number in files):
            return Recovered(position.session, 0, 0.0, f"its recordings are not in {folder}")
        if position.place.file == 0 and _is_headless(files, position.session):
            damaged.add_loss(min(files.items())[1], HEADLESS)
        rest = StoredSession(
            store, sonar_map, position.session, position, localization=localization
        )
        poses, tail = _fresh_poses(position, config), Tail(files, position.place, damaged)
        remarks = remarks_in(Tail(files, position.place, damaged))
        for _ in map_rest(rest, poses, tail, remarks, counters=counters):
            pass
    except (CheckpointError, ConfigError) as error:  # such as a known map that is gone
        problem = str(error)
    seconds = time.monotonic() - began_s
    return Recovered(position.session, counters.pings_mapped, seconds, problem, from_start)


@dataclass(frozen=True, slots=True)
class StoredSession:
    """A recorded session and the map's file that it goes into.

    Attributes:
        store: the file, open.
        sonar_map: its map.
        session: id.
        position: of the file within this session; None before its beginning.
        before: position of the file at the end of the sessions before; None in a new file.
        interval_s: between saves.
        localization: its state at the position; None where it does not affect the map.
    """

    store: TileStore
    sonar_map: SonarMap
    session: str
    position: Position | None = None
    before: Position | None = None
    interval_s: float = 5.0
    localization: LocalizationSession | None = None

    @property
    def done(self) -> int:
        """Number of pieces of work since the checkpoint that are in the map."""
        return 0 if self.position is None else self.position.done

    def persistence(self) -> SqlitePersistence:
        """Return the persistence of the session's map."""
        return SqlitePersistence(
            self.store,
            self.sonar_map,
            self.session,
            self.before if self.position is None else self.position,
            interval_s=lambda: self.interval_s,
            resumed=self.position,
        )


def map_rest(
    stored: StoredSession,
    poses: FixedPose | OdometryPoses,
    tail: Tail,
    remarks: Remarks | None,
    *,
    confirm: bool = False,
    counters: PipelineCounters | None = None,
    on_mapped: Callable[[int | None, Pose], None] = lambda *_: None,
) -> Generator[None, None, None]:
    """Map the rest of a session to its end; yield after every chunk.

    Args:
        stored: the session; its map has the settings of the position.
        poses: fixed, or from odometry; fresh.
        tail: recordings after the position.
        remarks: recorded decisions to repeat; None ignores them.
        confirm: hold each ping back until the next bytes confirm it.
        counters: to continue; new ones by default.
        on_mapped: as of `PingExecutor`.

    Raises:
        StoreError: the file cannot be written; it holds its last save, and the next call maps the
            rest.
        MapError: nothing can be saved, so nothing more can be mapped.
        CheckpointError: the checkpoint cannot be restored, or a known map of a recorded request
            does not exist any more.
    """
    persistence, localization = stored.persistence(), stored.localization
    pipeline = build_pipeline(
        stored.sonar_map,
        poses,
        localization=None if localization is None else localization.stage,
        persistence=persistence,
        remarks=remarks,
        confirm=confirm,
        counters=counters,
    )
    pipeline.executor.on_mapped = on_mapped
    if stored.position is not None:
        restore_decoder(pipeline.decoder, stored.position)
        restore_surface(stored.sonar_map, stored.position)
    persistence.begin(pipeline.decoder, tail, lambda: None, localization)
    persistence.skip(stored.done)
    left, loss = stored.done, ""
    try:
        for works in _works(pipeline.decoder, tail):
            if tail.loss != loss:
                loss = tail.loss
                persistence.lacks(loss)
            for work in works:
                if left:
                    left -= 1
                    pipeline.executor.skip(work)
                else:
                    pipeline.executor.do(work)
            if not left:
                persistence.between(tail.number, 0)
            yield
        if left:
            persistence.lacks("its recording ends before the map does")
        persistence.end()
        if persistence.unsaved is not None:
            text = f"{stored.store.path}: session {stored.session} cannot be saved"
            raise StoreError(f"{text}: {persistence.unsaved}", "io_error")
    finally:
        persistence.stop()


def _works(decoder: SessionDecoder, tail: Tail) -> Iterator[list[Work]]:
    for chunk in without_skipped(tail):
        yield decoder.feed(chunk)
    yield decoder.end()


def unmapped_sessions(
    config: Config, folder: Path, position: Position | None, *, empty: bool
) -> tuple[tuple[str, ...], dict[str, str], frozenset[str]]:
    """Return the recorded sessions that the map file does not hold, in order.

    Args:
        config: names the file and the kind of map in it.
        folder: of the recordings.
        position: of the file.
        empty: the file holds no brick.

    Returns:
        those that can be mapped now; those that cannot, with the reason, and files of unknown
        sessions by their names; those of the second that may belong to this map.
    """
    found, unknown = recorded_in(folder)
    known = set() if position is None else {*position.sessions, *position.emptied}
    first = min((min(files) for session, files in found.items() if session in known), default=0)
    left: list[str] = []
    reasons: dict[str, str] = {}
    ours: set[str] = set()
    for session, files in found.items():
        recorded = RecordedSession(list(files.values()), session)
        if session in known or not any(True for _ in recorded):
            continue
        is_ours, problem = _problem_of(recorded, config)
        if is_ours and not problem and position is None and not empty:
            is_ours, problem = False, "the map file does not list its sessions"
        elif is_ours and not problem and min(files) < first:
            problem = "it was recorded before the first session of the map file"
        if not problem:
            left.append(session)
            continue
        reasons[session] = problem
        if is_ours and min(files) >= first:
            ours.add(session)
    between = [range(min(files), max(files)) for files in found.values()]
    for path, problem in unknown.items():
        number = number_of(path) or 0
        if not any(number in numbers for numbers in between):  # otherwise the session lacks it
            reasons[path.name] = problem
            if number >= first:
                ours.add(path.name)
    return tuple(left), reasons, frozenset(ours)


HEADLESS = "its first file is missing"
"""Such as when the disk budget has deleted it; the settings of a session are in its first file."""


def _problem_of(recorded: RecordedSession, config: Config) -> tuple[bool, str]:
    """Return whether a session may belong to a map, and why it cannot be mapped into it."""
    beginning = recorded.beginning()
    if beginning is None:
        return True, HEADLESS
    try:
        theirs = config_of(beginning.settings, "the recording")
    except ConfigError as error:
        return True, f"this version does not accept its settings: {error}"
    if not theirs.outofcore.use:
        return False, "its map was kept in memory only"
    if theirs.outofcore.map_path != config.outofcore.map_path:
        return False, f"it belongs to another map file: {theirs.outofcore.map_path or 'default'}"
    for name, value, _ in differences(kind_of(theirs), kind_of(config)):
        return False, f"it belongs to a map of other settings: {name} was {value}"
    return True, ""


def map_recorded_sessions(
    store: TileStore,
    sonar_map: SonarMap,
    sessions: tuple[str, ...],
    folder: Path,
    damaged: DamagedData | None = None,
    *,
    before: Position | None = None,
) -> tuple[int, dict[str, str]]:
    """Map whole recorded sessions into a file, as recorded.

    Args:
        store: the file.
        sonar_map: its map.
        sessions: their ids.
        folder: of the recordings.
        damaged: data that fail their checksum; by default they are not mapped.
        before: position of the file; None in a new file.

    Returns:
        the mapped pings, and the sessions that could not be mapped to their end, with the reason.

    Raises:
        StoreError: the file cannot be written.
        MapError: nothing can be saved, so nothing more can be mapped.
    """
    counters = PipelineCounters()
    reasons: dict[str, str] = {}
    found, _ = recorded_in(folder)
    for session in sessions:
        files = found[session]
        recorded = RecordedSession(list(files.values()), session, damaged)
        try:
            run = as_recorded(recorded)
            sonar_map.reconfigure(run.config)
            localization = poses_depend_on(run.localization)
            stored = StoredSession(
                store, sonar_map, session, None, before, localization=localization
            )
            tail = Tail(files, RecordingOffset(), damaged)
            for _ in map_rest(stored, run.poses, tail, run.remarks, counters=counters):
                pass
        except (CheckpointError, ConfigError, ReplayError) as error:  # a known map that is gone
            reasons[session] = str(error)
        after = position_in(store.saved_position)
        if after is not None and session in after.sessions:
            before = after
        if session in reasons:
            before = with_incomplete(before, session, reasons[session])
    return counters.pings_mapped, reasons


def replay_sessions(
    sonar_map: SonarMap,
    sessions: tuple[str, ...],
    folder: Path,
    damaged: DamagedData | None = None,
    *,
    ends: Mapping[str, RecordingOffset] = MappingProxyType({}),
) -> bool:
    """Map whole sessions as recorded; return False if any part of them is missing.

    Args:
        sonar_map: the map, whose settings are restored afterwards.
        sessions: their ids.
        folder: of the recordings.
        damaged: data that fail their checksum; by default they are not mapped.
        ends: of the recordings when they were mapped. A truncated recording without one may lack
            a part.
    """
    complete = True
    own = sonar_map.config
    found, _ = recorded_in(folder)
    for session in sessions:
        files, end = found.get(session, {}), ends.get(session)
        complete = _replay_session(sonar_map, files, session, damaged, end) and complete
    sonar_map.reconfigure(own)
    return complete


def _replay_session(
    sonar_map: SonarMap,
    files: dict[int, Path],
    session: str,
    damaged: DamagedData | None,
    end: RecordingOffset | None,
) -> bool:
    if not files:
        return end == RecordingOffset()  # a crash before the first file
    recorded = RecordedSession(list(files.values()), session, damaged)
    if recorded.beginning() is None:  # a crash before the first piece, or lost data
        return next(iter(recorded), None) is None and end in (None, RecordingOffset())
    try:
        run = as_recorded(recorded)
        run.localization = poses_depend_on(run.localization)
        for _ in run.replay(sonar_map, Window()).run(recorded):
            pass
    except (CheckpointError, ConfigError):
        return False
    return recorded.is_complete(max(files), end)
