"""`mapperd --replay`: recordings become a map, with the user's settings or as they were mapped."""

import os
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mapperd.cli.arguments import Arguments
from mapperd.cli.progress import ProgressBar
from mapperd.config.tree import Config
from mapperd.daemon.map_folder import localization_summary, recording_facts, summary_of
from mapperd.errors import ExportExtraError, ReplayError, missing_extra, os_reason
from mapperd.export.trajectory import TrajectoryWriter
from mapperd.geometry.frames import Pose
from mapperd.mapping.queries import MapContent
from mapperd.mapping.sonar_map import SonarMap
from mapperd.odometry.odometry_files import OdometryFiles, OdometryOptions, read_odometry
from mapperd.odometry.trajectory_files import FixFile
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.persistence import MapPersistence, TilePersistence
from mapperd.session.recordings import (
    DamagedData,
    RecordedSession,
    files_in,
    sessions_of,
)
from mapperd.session.replay import (
    Run,
    Window,
    as_asked,
    as_recorded,
    contents,
    first_range_m,
    not_empty,
    odometry_of,
    require_overlap,
)
from mapperd.session.replay_to_store import map_into_store
from mapperd.store.stored_map import StoredMap
from mapperd.store.tile_store import TileStore
from oculus_driver.errors import RecordingError

if TYPE_CHECKING:
    from mapperd.cli.mapperctl.view import ReplayView

__all__ = ["map_recordings", "unreadable", "unreadable_odometry"]

ALIGNMENT_FOLDER = "alignment"
"""In the folder of the results."""


def unreadable(paths: Sequence[Path]) -> str | None:
    """Why a path cannot be a recording at all, before its content is looked at."""
    for path in paths:
        if (problem := _unreadable(path)) is not None:
            return problem
        if path.is_dir() and not files_in([path]):
            return f"{path}: there is no recording in this folder{_bag_in(path)}"
    return None


def unreadable_odometry(paths: Sequence[Path]) -> str | None:
    """Return why a path cannot hold odometry at all, before its content is looked at."""
    return next(filter(None, map(_unreadable, paths)), None)


def _unreadable(path: Path) -> str | None:
    try:
        if not path.exists():
            return f"{path}: there is no such file"
        if not path.is_dir() and not path.is_file():
            return f"{path}: is not a file"
    except OSError as error:  # such as a name that is too long
        return f"{path}: {os_reason(error)}"
    return None if os.access(path, os.R_OK) else f"{path}: may not be read"


def _bag_in(folder: Path) -> str:
    if any(one.suffix in (".db3", ".bag") for one in folder.iterdir()):
        return ", only a ROS bag: pass its file, or of ROS 2 the folder with its metadata.yaml"
    return ""


def map_recordings(
    arguments: Arguments,
    settings: Callable[[], Config],
    ready: Callable[[], None],
    trajectory: TrajectoryWriter,
    show: "Callable[[SonarMap], ReplayView | None]" = lambda _: None,
) -> tuple[MapContent, dict[str, Any]]:
    """Check everything that can be checked, then map; return the map, open, and the summary.

    Args:
        arguments: with the recordings.
        settings: the user's.
        ready: called when nothing speaks against mapping.
        trajectory: receives the poses of the mapped pings.
        show: returns the page that shows the replay, or None.

    Raises:
        ConfigError: the settings are wrong, or those of the sessions make no common map.
        ReplayError: the recordings cannot become a map with the options given.
        RecordingError: one is not a recording, or is empty.
    """
    damaged = DamagedData(allowed=arguments.allow_damaged)
    paths = files_in(arguments.replay, begun=True)
    if not paths:
        raise RecordingError(f"{arguments.replay[0]}: no recording with anything in it")
    sessions = sessions_of(paths, damaged)
    if arguments.as_recorded:
        runs = [as_recorded(session) for session in not_empty(sessions)]
        sonar_map = SonarMap(runs[0].config)
    else:
        sonar_map = SonarMap(settings())
        sessions, runs = _runs_as_asked(sessions, arguments, sonar_map, damaged)
    fixes = () if arguments.fixes is None else FixFile(arguments.fixes).fixes(sonar_map.config)
    ready()
    if arguments.store is not None:
        return _stored(sessions, sonar_map.config, arguments.pose, arguments.store, trajectory)
    facts: dict[str, Any] = {}
    if arguments.align:
        odometry, facts["alignment"] = _aligned(sessions[0], sonar_map.config, arguments.out, fixes)
        aligned = sessions_of(paths, damaged, odometry)
        runs = [as_asked(session, None, sonar_map.config) for session in aligned]
    window = Window(arguments.start_s, arguments.duration_s)
    _keep_pings(arguments, sonar_map)
    in_memory = arguments.view_port is not None or arguments.refine
    if sonar_map.config.outofcore.use and not in_memory:
        whole, summary = _mapped_on_disk(runs, sonar_map, window, arguments.out, trajectory)
        return whole, summary | facts
    page = show(sonar_map)
    summary = _mapped(runs, sonar_map, window, trajectory, folder=arguments.out, page=page)
    return sonar_map, summary | facts


def _runs_as_asked(
    sessions: list[RecordedSession], arguments: Arguments, sonar_map: SonarMap, damaged: DamagedData
) -> tuple[list[RecordedSession], list[Run]]:
    """Return the sessions with their odometry, and their runs.

    Raises:
        ReplayError: they cannot become a map with the options given.
        RecordingError: a file is not a recording or odometry, or is empty.
    """
    if arguments.pose is None:
        odometry = odometry_of(sessions, arguments.odometry, sonar_map.config)
        if odometry is not None:
            require_overlap(sessions, odometry)
            paths = [path for session in sessions for path in session.paths]
            sessions = sessions_of(paths, damaged, odometry)
    runs = [as_asked(session, arguments.pose, sonar_map.config) for session in sessions]
    if len(runs) > 1 and (arguments.start_s or arguments.duration_s is not None):
        raise ReplayError("--start and --duration choose a part of one session, not of several")
    _require_data(sessions, arguments)
    if arguments.pose is not None:
        _require_reach(sessions, arguments.pose, sonar_map)
    if arguments.align:
        _require_alignable(runs)
    return sessions, runs


def _require_alignable(runs: Sequence[Run]) -> None:
    """Refuse early what cannot be aligned."""
    if len(runs) > 1:
        raise ReplayError(f"--align takes one session, and these are {len(runs)}")
    missing = next((name for name in ("scipy", "matplotlib") if find_spec(name) is None), None)
    if missing is not None:
        raise ExportExtraError(missing_extra(missing, "align"))


def _aligned(
    session: RecordedSession,
    config: Config,
    out: Path,
    fixes: tuple[tuple[int, float, float, float], ...],
) -> tuple[OdometryFiles | None, dict[str, Any]]:
    """Align a session and write the results; return the odometry to map with, and the verdict."""
    from mapperd.alignment.align import DiveInput, align  # noqa: PLC0415 needs an extra
    from mapperd.alignment.report import maps_of, write_alignment  # noqa: PLC0415
    from mapperd.alignment.submaps import DiveReader  # noqa: PLC0415

    bar = ProgressBar(sys.stderr, time.perf_counter, "mapperd: aligning", unit="submaps")
    reader = DiveReader(session, config)

    def progress(share: float, _: str) -> None:
        bar.show(share, len(reader.submaps))

    dive = DiveInput(session.paths[0].stem, reader, fixes=fixes)
    alignment = align([dive], progress=progress)
    bar.close(len(reader.submaps))
    folder = out / ALIGNMENT_FOLDER
    record = write_alignment(alignment, folder, maps_of(alignment, [reader]))
    sys.stderr.write(f"mapperd: alignment: {record.verdict}; {folder / 'report.md'}\n")
    odometry = session.odometry
    if record.corrected:
        path = folder / record.dives[0].trajectory[-1]
        odometry = read_odometry(OdometryOptions((path,)), config)
    return odometry, record.summary()


def _keep_pings(arguments: Arguments, sonar_map: SonarMap) -> None:
    """Keep the pings if they are to be refined."""
    if not arguments.refine:
        return
    if sonar_map.config.mapping.rule != "arc":
        raise ReplayError("--refine needs mapping.rule: arc, and the rule is iwlo")
    sonar_map.keep_pings(arguments.out)


def _mapped_on_disk(
    runs: Sequence[Run],
    sonar_map: SonarMap,
    window: Window,
    folder: Path,
    trajectory: TrajectoryWriter,
) -> tuple[MapContent, dict[str, Any]]:
    """Map into a temporary file, of which at most `outofcore.cache_size` tiles are in memory."""
    settings = sonar_map.config.outofcore
    with tempfile.TemporaryDirectory(dir=folder, prefix=".map-") as name:
        path = Path(name) / "mapperd.map"
        with TileStore(
            path, sonar_map, tile_size_m=settings.tile_size, cache_tiles=settings.cache_size
        ) as store:
            persistence = TilePersistence(store, sonar_map)
            summary = _replayed(runs, sonar_map, window, trajectory, persistence=persistence)
        whole = StoredMap(path, sonar_map.config)  # stays readable without its name
    return whole, summary(whole)


def _mapped(
    runs: Sequence[Run],
    sonar_map: SonarMap,
    window: Window,
    trajectory: TrajectoryWriter,
    *,
    folder: Path,
    page: "ReplayView | None",
) -> dict[str, Any]:
    """Map in memory, and save the map if it is refined; return the summary."""
    summary = _replayed(runs, sonar_map, window, trajectory, page=page)(sonar_map)
    if "pings_refined" in summary:
        sonar_map.save(folder / "map.map")
    return summary


def _replayed(
    runs: Sequence[Run],
    sonar_map: SonarMap,
    window: Window,
    trajectory: TrajectoryWriter,
    *,
    persistence: MapPersistence | None = None,
    page: "ReplayView | None" = None,
) -> Callable[[MapContent], dict[str, Any]]:
    """Run the replays, one after the other into one map; return what makes the summary of it."""
    counters = PipelineCounters()
    size_bytes = sum(run.session.size_bytes for run in runs)
    bar = ProgressBar(sys.stderr, time.perf_counter)
    began_s = time.perf_counter()
    done_bytes = 0
    for run in runs:
        replay = run.replay(sonar_map, window, counters, persistence)
        replay.pipeline.executor.on_mapped = trajectory.add
        if page is not None:
            replay.pipeline.executor.on_ping = page.put
        for _ in replay.run(run.session):
            trajectory.flush()
            if page is not None:
                stage = None if run.localization is None else run.localization.stage
                page.update(counters, None if stage is None else stage.snapshot())
            bar.show((done_bytes + run.session.bytes_read) / size_bytes, counters.pings_mapped)
        done_bytes += run.session.bytes_read
    bar.close(counters.pings_mapped)
    refined = _refine(sonar_map)
    if page is not None and refined:
        page.update(counters, None)
    wall_s = time.perf_counter() - began_s
    facts = recording_facts([run.session for run in runs]) | sonar_map.rule_facts()
    if refined:
        facts["pings_refined"] = refined
    if runs[-1].localization is not None:
        facts |= localization_summary(runs[-1].localization.stage.snapshot())
    return lambda whole: summary_of(facts, whole, runs[-1].poses, counters, wall_s)


def _refine(sonar_map: SonarMap) -> int:
    """Integrate all kept pings again; return their number."""
    bar = ProgressBar(sys.stderr, time.perf_counter, "mapperd: refining")
    kept = done = sonar_map.kept_pings
    for done in sonar_map.refine():
        bar.show(done / kept, done)
    if kept:
        bar.close(kept)
    return done


def _stored(
    sessions: Sequence[RecordedSession],
    config: Config,
    pose: Pose | None,
    path: Path,
    trajectory: TrajectoryWriter,
) -> tuple[MapContent, dict[str, Any]]:
    """Map a recording into a file; the counts are of this time, the map is the whole one."""
    if len(sessions) > 1:
        raise ReplayError("--store takes one recording at a time, and these are several sessions")
    began_s = time.perf_counter()
    [session] = sessions
    whole, poses, counters, rule = map_into_store(
        session.paths,
        config,
        pose,
        path,
        lambda _: trajectory.flush(),
        damaged=session.damaged,
        odometry=session.odometry,
        on_mapped=trajectory.add,
    )
    wall_s = time.perf_counter() - began_s
    facts = recording_facts(sessions) | rule
    return whole, summary_of(facts, whole, poses, counters, wall_s)


def _require_data(sessions: Sequence[RecordedSession], arguments: Arguments) -> None:
    """Refuse early what could only end in a map without a ping."""
    found = [contents(session) for session in sessions]
    has_sonar, has_odometry = (any(kinds) for kinds in zip(*found, strict=True))
    broken = next((session.damage for session in sessions if session.damage), None)
    damage = f" ({broken})" if broken else ""
    if not has_sonar and not has_odometry:
        raise RecordingError(f"{sessions[0].paths[0]}: nothing can be read from it{damage}")
    if not has_sonar:
        raise RecordingError(f"{sessions[0].paths[0]}: no sonar data in it{damage}")
    if arguments.pose is None and not has_odometry:
        raise ReplayError(
            f"no odometry in it{damage}, so the poses of the vehicle are unknown; give them with "
            "--odometry FILE, or if it stood still, with --pose x,y,z,roll,pitch,yaw"
        )


def _require_reach(sessions: Sequence[RecordedSession], pose: Pose, sonar_map: SonarMap) -> None:
    """Refuse early a pose whose map would not fit into map.bt."""
    sonar_m = (pose.map_T_base @ sonar_map.base_T_sonar)[:3, 3]
    range_m = max(first_range_m(session) for session in sessions)
    if np.abs(sonar_m).max() + range_m > sonar_map.octomap_reach_m:
        raise ReplayError(
            f"--pose and the range of {range_m:g} m leave the reach of map.bt, "
            f"+-{sonar_map.octomap_reach_m:g} m with voxels of {sonar_map.resolution_m:g} m; "
            "set a larger octree.voxel_resolution, or move the pose nearer to the origin"
        )
