"""Maps a recording into a map file; an interrupted run resumes next time."""

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from mapperd.config.tree import Config
from mapperd.errors import ReplayError, StoreError
from mapperd.geometry.frames import Pose
from mapperd.localization.session import (
    LocalizationSession,
    begun,
    poses_depend_on,
    restored_session,
)
from mapperd.mapping.sonar_map import SonarMap
from mapperd.odometry.odometry_files import OdometryFiles, content_files
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.pose_lookup import FixedPose, OdometryPoses
from mapperd.session.recordings import DamagedData, RecordedSession, Tail
from mapperd.session.recovery import StoredSession, config_at, map_rest
from mapperd.session.replay import Run, Window, poses_of
from mapperd.session.ros_recording import open_source
from mapperd.session_log import SESSION
from mapperd.store.maintenance import rebuild_lost
from mapperd.store.position import Position, RecordingOffset, position_in
from mapperd.store.stored_map import StoredMap
from mapperd.store.tile_store import TileStore

__all__ = ["map_into_store"]

ID_BYTES = 1 << 20


def map_into_store(
    paths: Sequence[Path],
    config: Config,
    pose: Pose | None,
    path: Path,
    on_chunk: Callable[[PipelineCounters], None] = lambda _: None,
    *,
    damaged: DamagedData | None = None,
    odometry: OdometryFiles | None = None,
    on_mapped: Callable[[int | None, Pose], None] = lambda *_: None,
) -> tuple[StoredMap, FixedPose | OdometryPoses, PipelineCounters, dict[str, Any]]:
    """Map a recording into a file, from its resume point; the file keeps its other content.

    Args:
        paths: files of one recording, in order.
        config: the settings.
        pose: of a vehicle at rest; None uses the odometry.
        path: of the map's file.
        on_chunk: called after every chunk.
        damaged: data that fail their checksum; by default they are not mapped.
        odometry: of other files; None uses the recorded odometry.
        on_mapped: as of `PingExecutor`.

    Returns:
        the whole map, which the caller closes, the poses, the counters of this run, and what the
        rule learnt in it, `SonarMap.rule_facts`.

    Raises:
        ReplayError: the file holds a part of another recording, or of this one with other settings.
        StoreError: the file cannot be used, or bricks of it are damaged and cannot be rebuilt from
            this recording (`bricks_lost`).
        CheckpointError: the resume point cannot be restored.
        MapError: nothing can be saved, so nothing more can be mapped.
    """
    session = _identity(paths, odometry)
    sonar_map, counters = SonarMap(config), PipelineCounters()
    poses = poses_of(odometry, config, pose)
    with _open(path, sonar_map) as store:
        store.check()
        position = position_in(store.position)
        if position is not None and not position.whole and position.session != session:
            raise ReplayError(f"{path} holds a part of another recording: map that one first")
        resumed = None if position is None or position.session != session else position
        if resumed is not None and damaged is not None and session in resumed.incomplete:
            damaged.add_loss(paths[0], resumed.incomplete[session])
        if resumed is None or not resumed.whole:
            _require_same_settings(resumed, config, fixed=pose is not None)
            stored = StoredSession(
                store,
                sonar_map,
                session,
                resumed,
                position,
                config.visualization.tile_save_interval,
                _localization(config, resumed),
            )
            start = RecordingOffset() if resumed is None else resumed.place
            tail = Tail(dict(enumerate(paths, 1)), start, damaged, odometry)
            confirm = _is_foreign(paths[0])
            for _ in map_rest(
                stored,
                poses,
                tail,
                None,
                confirm=confirm,
                counters=counters,
                on_mapped=on_mapped,
            ):
                on_chunk(counters)

    def recorded(session: str) -> RecordedSession:
        whose = None if _is_foreign(paths[0]) else session
        return RecordedSession(paths, whose, damaged, odometry)

    _rebuild(path, config, pose, recorded)
    whole = StoredMap(path, config)
    if lost := whole.bricks_lost:
        whole.close()
        text = f"{path}: {lost} bricks are damaged, and this recording does not restore them"
        raise StoreError(text, "bricks_lost")
    return whole, poses, counters, sonar_map.rule_facts()


def _open(path: Path, sonar_map: SonarMap) -> TileStore:
    settings = sonar_map.config.outofcore
    return TileStore(
        path, sonar_map, tile_size_m=settings.tile_size, cache_tiles=settings.cache_size
    )


def _rebuild(
    path: Path,
    config: Config,
    pose: Pose | None,
    recorded: Callable[[str], RecordedSession],
) -> None:
    """Rebuild lost bricks of a file that holds this recording alone."""
    sonar_map = SonarMap(config)
    with _open(path, sonar_map) as store:
        position = position_in(store.position)
        if not store.lost or position is None or len(position.sessions) > 1:
            return

        def map_again(scratch: SonarMap) -> bool:
            session = recorded(position.session)
            run = Run(session, config, pose, None, _localization(config, None))
            for _ in run.replay(scratch, Window()).run(session):
                pass
            return session.is_complete(len(session.paths), position.ends.get(position.session))

        rebuild_lost(store, sonar_map, map_again)


def _is_foreign(path: Path) -> bool:
    """Return whether another program recorded a file."""
    with open_source(path) as recording:
        return SESSION not in recording.metadata


def _localization(config: Config, resumed: Position | None) -> LocalizationSession | None:
    """Return the localization that affects the map, from the resume point."""
    if resumed is not None and resumed.localization:
        return restored_session(config, resumed.localization)
    return poses_depend_on(begun(config))


def _require_same_settings(resumed: Position | None, config: Config, *, fixed: bool) -> None:
    if resumed is not None and (config_at(resumed) != config or resumed.fixed != fixed):
        raise ReplayError("the first part was mapped with other settings: restore them")


def _identity(paths: Sequence[Path], odometry: OdometryFiles | None) -> str:
    """Return an id that is equal for equal recordings in any folder."""
    digest = hashlib.sha256(b"" if odometry is None else odometry.identity())
    for path in content_files(paths):
        digest.update(path.stat().st_size.to_bytes(8, "little"))
        with path.open("rb") as file:
            digest.update(file.read(ID_BYTES))
    return digest.hexdigest()[:16]
