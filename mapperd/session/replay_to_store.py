"""A recording becomes a map in a file: whoever is interrupted goes on there next time."""

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path

from mapperd.config.tree import Config
from mapperd.errors import ReplayError
from mapperd.geometry.frames import Pose
from mapperd.localization.session import (
    LocalizationSession,
    begun,
    poses_depend_on,
    restored_session,
)
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.decoder import SessionDecoder
from mapperd.pipeline.pose_lookup import FixedPose, OdometryPoses
from mapperd.session.recordings import Tail
from mapperd.session.recovery import Going, go_on, restored
from mapperd.session_log import SESSION
from mapperd.store.position import Position, RecordingOffset, position_in
from mapperd.store.reader import StoreReader
from mapperd.store.tile_store import TileStore
from oculus_driver.recording import open_recording

__all__ = ["map_into_store"]

LOOK_BYTES = 1 << 20


def map_into_store(
    paths: Sequence[Path],
    config: Config,
    pose: Pose | None,
    path: Path,
    on_chunk: Callable[[PipelineCounters], None] = lambda _: None,
) -> tuple[SonarMap, FixedPose | OdometryPoses, PipelineCounters]:
    """Map a recording into a file, from where that is; what else is in the file stays there.

    Args:
        paths: files of one recording, in order.
        config: the settings.
        pose: of a vehicle that stands still; None takes the odometry.
        path: of the map's file.
        on_chunk: called after every chunk.

    Returns:
        the whole map in memory, where the poses came from, and what happened this time.

    Raises:
        StoreError: the file cannot be used, or is of other settings.
        ReplayError: the file holds a part of another recording, or of this one by other settings.
        CheckpointError: the file's estimators are of another program.
        MapError: nothing can be saved any more, and so nothing more be mapped.
    """
    session = _identity(paths)
    sonar_map, counters = SonarMap(config), PipelineCounters()
    settings = config.outofcore
    with TileStore(
        path, sonar_map, tile_size_m=settings.tile_size, cache_tiles=settings.cache_size
    ) as store:
        position = position_in(store.position)
        if position is not None and not position.whole and position.session != session:
            raise ReplayError(f"{path} holds a part of another recording: map that one first")
        cut = None if position is None or position.session != session else position
        engine = _engine(paths, config, pose, cut, counters)
        if cut is None or not cut.whole:
            tail = Tail(dict(enumerate(paths, 1)), RecordingOffset() if cut is None else cut.place)
            before = () if position is None else position.sessions
            interval_s = config.visualization.tile_save_interval
            localizing = _localizing(config, cut)
            going = Going(store, sonar_map, session, cut, before, interval_s, localizing)
            for _ in go_on(going, engine, tail):
                on_chunk(counters)
    whole = SonarMap(config)
    with StoreReader(path) as reader:
        reader.load(whole)
    assert isinstance(engine.poses, FixedPose | OdometryPoses)  # noqa: S101 as it was made
    return whole, engine.poses, counters


def _localizing(config: Config, cut: Position | None) -> LocalizationSession | None:
    """What the map depends on, from where it was interrupted."""
    if cut is not None and cut.localization:
        return restored_session(config, cut.localization)
    return poses_depend_on(begun(config))


def _engine(
    paths: Sequence[Path],
    config: Config,
    pose: Pose | None,
    cut: Position | None,
    counters: PipelineCounters,
) -> SessionDecoder:
    poses = OdometryPoses(config) if pose is None else FixedPose(pose)
    if cut is None or cut.whole:
        with open_recording(paths[0]) as recording:
            foreign = SESSION not in recording.metadata
        return SessionDecoder(config, poses, counters, confirm=foreign, obey=False)
    engine = restored(cut, counters)
    if engine.config != config or isinstance(engine.poses, FixedPose) != (pose is not None):
        raise ReplayError("the first part was mapped with other settings: set them back")
    return engine


def _identity(paths: Sequence[Path]) -> str:
    """Equal for equal recordings, wherever they lie."""
    digest = hashlib.sha256()
    for path in paths:
        digest.update(path.stat().st_size.to_bytes(8, "little"))
        with path.open("rb") as file:
            digest.update(file.read(LOOK_BYTES))
    return digest.hexdigest()[:16]
