"""After a kill: what the recordings have and the map's file has not is mapped.

And what the file has lost comes back from the recordings of all its sessions.
"""

import contextlib
import time
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from mapperd.config.loader import config_of
from mapperd.config.tree import Config
from mapperd.errors import CheckpointError, ConfigError
from mapperd.geometry.frames import Pose
from mapperd.localization.session import (
    LocalizationSession,
    begun_again,
    poses_depend_on,
    restored_session,
    saved_state,
)
from mapperd.localization.stage import LocalizationStage
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.decoder import SessionDecoder, SessionDecoderState, Work
from mapperd.pipeline.executor import PingExecutor
from mapperd.pipeline.persistence import MemoryPersistence
from mapperd.pipeline.pose_lookup import FixedPose, OdometryPoses
from mapperd.pipeline.step import StepRunner
from mapperd.session.recordings import RecordedSession, Tail, files_in, files_of
from mapperd.session.store_session import SqlitePersistence
from mapperd.session_log import SESSION, Remarks, Session, remarks_in, without_skipped
from mapperd.store.checkpoint import decode_state, encode_state
from mapperd.store.metadata import kind_of
from mapperd.store.position import Position, RecordingOffset
from mapperd.store.tile_store import TileStore
from oculus_driver.errors import RecordingError
from oculus_driver.recording import open_recording

__all__ = [
    "Going",
    "Recovered",
    "go_on",
    "go_on_from_nothing",
    "headless_in",
    "map_sessions_again",
    "recover",
    "restored",
    "sessions_for",
]

NOWHERE = Pose(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))


@dataclass(frozen=True, slots=True)
class Recovered:
    """What became of a session that was cut short.

    Attributes:
        session: its id.
        pings: that were mapped now.
        seconds: that it took.
        problem: why the rest of it is not in the map; None when it is.
        from_start: why the estimators were computed again from the recording's start; empty where
            they came from the checkpoint.
    """

    session: str
    pings: int
    seconds: float
    problem: str | None = None
    from_start: str = ""


def restored(position: Position, counters: PipelineCounters) -> SessionDecoder:
    """The estimators as they were at a position's checkpoint.

    Raises:
        CheckpointError: they cannot be had.
    """
    try:
        config = config_of(position.config or {}, "the checkpoint")
    except ConfigError as error:
        raise CheckpointError(str(error)) from error
    poses = FixedPose(NOWHERE) if position.fixed else OdometryPoses(config)
    engine = SessionDecoder(config, poses, counters, confirm=False, obey=True)
    state = decode_state(position.checkpoint, SessionDecoderState)
    try:
        engine.restore(state)
    except (ValueError, TypeError, KeyError) as error:
        raise CheckpointError(f"the checkpoint cannot be read: {error}") from error
    return engine


def _fresh(
    config: Config, beginning: Session, counters: PipelineCounters
) -> tuple[SessionDecoder, LocalizationSession | None]:
    """The estimators as a session begins.

    Raises:
        ConfigError: the known map cannot be used, or is another one by now.
    """
    pose = beginning.pose
    poses = OdometryPoses(config) if pose is None else FixedPose(_pose(pose))
    engine = SessionDecoder(config, poses, counters, confirm=False, obey=True)
    return engine, poses_depend_on(begun_again(config, beginning))


def _at_start(position: Position, files: dict[int, Path]) -> Position:
    """The same position, with a checkpoint at the recording's start instead of the one it has.

    The estimators make all pieces of work again from there; those that are in the map are left out.

    Raises:
        CheckpointError: the recording's start is missing.
        ConfigError: its settings or its known map cannot be used.
    """
    recorded = RecordedSession(list(files.values()), position.session) if files else None
    beginning = None if recorded is None else recorded.beginning()
    if beginning is None:
        raise CheckpointError("the start of its recordings is missing")
    config = config_of(beginning.settings, "the recording")
    engine, localizing = _fresh(config, beginning, PipelineCounters())
    at_start = msgspec.structs.replace(
        position,
        place=RecordingOffset(),
        config=beginning.settings,
        fixed=beginning.pose is not None,
        checkpoint=encode_state(engine.state()),
        localization=b"" if localizing is None else saved_state(localizing),
    )
    tail, done = Tail(files, RecordingOffset()), position.done
    for chunk in without_skipped(tail):
        if tail.place > position.place:
            break
        done += len(engine.feed(chunk))
    return msgspec.structs.replace(at_start, done=done)


def _restored_localizing(position: Position, config: Config) -> LocalizationSession | None:
    return restored_session(config, position.localization) if position.localization else None


def recover(
    store: TileStore, sonar_map: SonarMap, position: Position, folder: Path
) -> Recovered | None:
    """Map the rest of the session that made the map last; its settings are then in force.

    Args:
        store: just opened.
        sonar_map: its map.
        position: of the store.
        folder: of the recordings.

    Returns:
        None where nothing was missing.

    Raises:
        StoreError: the file cannot be written.
        MapError: nothing can be saved, and so nothing more be mapped.
    """
    if position.whole:
        return None
    began_s = time.monotonic()
    files = files_of(folder, position.session)
    counters = PipelineCounters()
    from_start = ""
    try:
        try:
            engine = restored(position, counters)
            localizing = _restored_localizing(position, engine.config)
        except CheckpointError as error:
            from_start, position = str(error), _at_start(position, files)
            engine = restored(position, counters)
            localizing = _restored_localizing(position, engine.config)
        sonar_map.reconfigure(engine.config)
    except (CheckpointError, ConfigError) as error:
        return Recovered(position.session, 0, 0.0, str(error))
    if not any(number >= position.place.file for number in files):
        return Recovered(position.session, 0, 0.0, f"its recordings are not in {folder}")
    cut = Going(store, sonar_map, position.session, position, localizing=localizing)
    remarks = remarks_in(Tail(files, position.place))
    problem = None
    try:
        for _ in go_on(cut, engine, Tail(files, position.place), remarks):
            pass
    except CheckpointError as error:  # the vehicle was then localized on a map that is gone
        problem = str(error)
    seconds = time.monotonic() - began_s
    return Recovered(position.session, counters.pings_mapped, seconds, problem, from_start)


@dataclass(frozen=True, slots=True)
class Going:
    """A session on its way into a map's file.

    Attributes:
        store: the file, open.
        sonar_map: its map.
        session: id.
        position: of the file, in this session; None where it begins.
        before: ids of the sessions that are in the map.
        interval_s: between saves.
        localizing: as it was at the position; None where the map does not depend on it.
    """

    store: TileStore
    sonar_map: SonarMap
    session: str
    position: Position | None = None
    before: tuple[str, ...] = ()
    interval_s: float = 5.0
    localizing: LocalizationSession | None = None

    @property
    def done(self) -> int:
        """Pieces of work since the checkpoint that are in the map."""
        return 0 if self.position is None else self.position.done

    def keeping(self) -> SqlitePersistence:
        """What keeps the map of the session."""
        before = self.before if self.position is None else self.position.sessions
        return SqlitePersistence(
            self.store,
            self.sonar_map,
            self.session,
            before,
            interval_s=lambda: self.interval_s,
            resumed=self.position,
        )


def go_on(
    going: Going, engine: SessionDecoder, tail: Tail, remarks: Remarks | None = None
) -> Generator[None, None, None]:
    """Map what is left of a session, to its end; yields after every chunk.

    Args:
        going: the session.
        engine: as it was at the place where the tail begins.
        tail: what is left.
        remarks: of the session, where it was mapped before.

    Raises:
        StoreError: the file cannot be written.
        MapError: nothing can be saved, and so nothing more be mapped.
        CheckpointError: a known map that somebody chose in it is not there any more.
    """
    stepping = StepRunner(going.sonar_map, time.perf_counter, engine.counters)
    keep = going.keeping()
    onboard = None if going.localizing is None else going.localizing.onboard
    integration = PingExecutor(stepping, keep, remarks, onboard)
    keep.begin(engine, tail, lambda: None, going.localizing)
    keep.skip(going.done)
    left = going.done
    try:
        for works in _works(engine, tail):
            for work in works:
                if left:
                    left -= 1
                    integration.pass_by(work)
                else:
                    integration.do(work)
            if not left:
                keep.between(tail.number, 0)
            yield
        keep.end()
    finally:
        keep.stop()


def _works(engine: SessionDecoder, tail: Tail) -> Iterator[list[Work]]:
    for chunk in without_skipped(tail):
        yield engine.feed(chunk)
    yield engine.end()


def sessions_for(config: Config, folder: Path) -> tuple[str, ...]:
    """Ids of the recorded sessions that were mapped into the settings' file, in order.

    Args:
        config: for the file, and what its voxels come about by.
        folder: of the recordings.
    """
    return tuple(
        recorded.session
        for recorded in _sessions_in(folder)
        if recorded.session is not None and _is_for(recorded, config)
    )


def headless_in(folder: Path) -> int:
    """Recorded sessions whose first file is gone: nobody knows how, and where, they were mapped."""
    return sum(
        any(True for _ in recorded) and recorded.beginning() is None
        for recorded in _sessions_in(folder)
    )


def _sessions_in(folder: Path) -> list[RecordedSession]:
    """Recorded sessions; files that are none are left out."""
    by_session: dict[str, list[Path]] = {}
    for path in files_in([folder]) if folder.is_dir() else []:
        try:
            with open_recording(path) as recording:
                session = recording.metadata.get(SESSION)
        except RecordingError:
            continue
        if session is not None:
            by_session.setdefault(session, []).append(path)
    return [RecordedSession(paths, session) for session, paths in by_session.items()]


def _is_for(recorded: RecordedSession, config: Config) -> bool:
    beginning = recorded.beginning()
    if beginning is None:
        return False
    try:
        theirs = config_of(beginning.settings, "the recording")
    except ConfigError:
        return False
    return (
        theirs.outofcore.use
        and theirs.outofcore.map_path == config.outofcore.map_path
        and kind_of(theirs) == kind_of(config)
    )


def go_on_from_nothing(
    store: TileStore, sonar_map: SonarMap, sessions: tuple[str, ...], folder: Path
) -> int:
    """Map whole recorded sessions into an empty file, as they were mapped; returns the pings.

    Raises:
        StoreError: the file cannot be written.
        MapError: nothing can be saved, and so nothing more be mapped.
    """
    pings = 0
    for place, session in enumerate(sessions):
        recorded = RecordedSession(list(files_of(folder, session).values()), session)
        beginning = recorded.beginning()
        if beginning is None:
            continue
        config = config_of(beginning.settings, "the recording")
        sonar_map.reconfigure(config)
        pose = beginning.pose
        poses = OdometryPoses(config) if pose is None else FixedPose(_pose(pose))
        engine = SessionDecoder(config, poses, PipelineCounters(), confirm=False, obey=True)
        files = files_of(folder, session)
        remarks = remarks_in(Tail(files, RecordingOffset()))
        with contextlib.suppress(CheckpointError, ConfigError):  # a known map that is gone
            localizing = poses_depend_on(begun_again(config, beginning))
            going = Going(store, sonar_map, session, None, sessions[:place], localizing=localizing)
            for _ in go_on(going, engine, Tail(files, RecordingOffset()), remarks):
                pass
        pings += engine.counters.pings_mapped
    return pings


def map_sessions_again(sonar_map: SonarMap, sessions: tuple[str, ...], folder: Path) -> bool:
    """Map whole sessions as they were mapped; False if anything of them is missing.

    Args:
        sonar_map: the map, whose settings are kept.
        sessions: their ids.
        folder: of the recordings.
    """
    complete = True
    own = sonar_map.config
    for session in sessions:
        files = files_of(folder, session)
        complete &= bool(files) and list(files) == list(range(min(files), max(files) + 1))
        complete = _map_again(sonar_map, list(files.values()), session) and complete
    sonar_map.reconfigure(own)
    return complete


def _map_again(sonar_map: SonarMap, paths: list[Path], session: str) -> bool:
    if not paths:
        return False
    recorded = RecordedSession(paths, session)
    beginning = recorded.beginning()
    if beginning is None:
        return next(iter(recorded), None) is None  # killed before the first piece
    try:
        config = config_of(beginning.settings, "the recording")
        sonar_map.reconfigure(config)
        localizing = poses_depend_on(begun_again(config, beginning))
    except ConfigError:
        return False
    poses = OdometryPoses(config) if beginning.pose is None else FixedPose(_pose(beginning.pose))
    onboard = None if localizing is None else localizing.onboard
    engine = SessionDecoder(config, poses, PipelineCounters(), confirm=False, obey=True)
    try:
        _replay(sonar_map, engine, recorded, onboard)
    except CheckpointError:
        return False
    return recorded.damage is None or recorded.truncated


def _replay(
    sonar_map: SonarMap,
    engine: SessionDecoder,
    recorded: RecordedSession,
    onboard: LocalizationStage | None,
) -> None:
    remarks = remarks_in(recorded)
    stepping = StepRunner(sonar_map, time.perf_counter, engine.counters)
    integration = PingExecutor(stepping, MemoryPersistence(sonar_map), remarks, onboard)
    for chunk in without_skipped(recorded):
        for work in engine.feed(chunk):
            integration.do(work)
    for work in engine.end():
        integration.do(work)


def _pose(numbers: tuple[float, ...]) -> Pose:
    return Pose(np.array(numbers[:3]), np.array(numbers[3:]))
