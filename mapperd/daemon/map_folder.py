"""Folders of results: saved maps, map.bt, map.ply, map.png, trajectory and summary.json."""

import contextlib
import json
import re
import threading
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from mapperd import __version__
from mapperd.api import OperationError
from mapperd.config.live import ConfigStore
from mapperd.config.tree import Config
from mapperd.daemon.supervisor import deferred_interrupt
from mapperd.errors import ExportError, MapError, StoreError, os_reason
from mapperd.export.cells import Heights
from mapperd.export.clouds import write_ply
from mapperd.export.formats import FORMATS, crs_of, write_map
from mapperd.export.picture import can_draw, write_picture
from mapperd.export.trajectory import TrajectoryWriter
from mapperd.geometry.gaussian import PlanarGaussian
from mapperd.geometry.geodesy import Origin
from mapperd.io import atomic_file, make_folder, remove
from mapperd.localization.status import LocalizationSnapshot
from mapperd.mapping.queries import MapContent, VoxelCloud
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.pose_lookup import FixedPose, OdometryPoses
from mapperd.session.recordings import RecordedSession

__all__ = [
    "MapFolder",
    "checked_name",
    "localization_summary",
    "lost_bricks",
    "recording_facts",
    "summary_of",
    "write_results",
]

MAX_PARTS = 1000
"""Maximum number of damaged parts in a summary."""

MAX_BYTES = 200
"""Of a name: what is being written has a longer one, and file systems take 255."""

NAME = re.compile(r"\w[\w .+-]*\.\w+")


def checked_name(name: str) -> str:
    """A file's name that can only lie in the folder: letters, digits, and ` ._+-` inside.

    Raises:
        OperationError: invalid name (`bad_name`) or suffix (`bad_format`).
    """
    if not NAME.fullmatch(name) or len(name.encode(errors="replace")) > MAX_BYTES:
        raise OperationError(
            f"{name[:60]!a}: no name for a file; allowed: letters, digits, spaces and ._+- after "
            f"the first, no folder, at most {MAX_BYTES} bytes",
            "bad_name",
        )
    suffix = Path(name).suffix
    if suffix not in FORMATS:
        raise OperationError(
            f"{name}: unknown format; allowed suffixes: {' '.join(FORMATS)}", "bad_format"
        )
    return name


class MapFolder:
    """Saves maps into a folder, one at a time.

    Args:
        folder: is made when it is needed.
        settings: those of the exports follow them.
        clock: seconds.
    """

    FOLLOWS = ("export",)

    def __init__(
        self, folder: Path, settings: ConfigStore, clock: Callable[[], float] = time.perf_counter
    ) -> None:
        self.folder = folder
        self._settings = settings
        self._clock = clock
        self._busy = threading.Lock()
        settings.follow(self.FOLLOWS, lambda _: None)  # they are looked up at every save

    def save(
        self, name: str, whole_map: Callable[[], MapContent], origin: Origin | None = None
    ) -> dict[str, Any]:
        """Write the map; takes seconds, in a thread of its own.

        Args:
            name: file name; its suffix selects the format.
            whole_map: gives the map when it is needed; may be slow, may raise what a store does.
            origin: geographic position of the map's origin; None if unknown.

        Returns:
            `path`, `bytes` of all files, `seconds`; `crs` of formats that can name a system of
            coordinates.

        Raises:
            OperationError: `bad_name`, `bad_format`, `cannot_write`, or `busy` with another.
        """
        checked_name(name)
        if not self._busy.acquire(blocking=False):
            raise OperationError("another map is being saved; try again", "busy")
        began_s = self._clock()
        try:
            make_folder(self.folder)
            with contextlib.closing(whole_map()) as whole:
                files = write_map(whole, self.folder / name, self._heights(), origin)
            size = sum(path.stat().st_size for path in files)
        except (ExportError, MapError, StoreError) as error:
            raise OperationError(str(error), "cannot_write") from error
        except OSError as error:
            raise OperationError(f"{self.folder}: {os_reason(error)}", "cannot_write") from error
        finally:
            self._busy.release()
        done = {"path": str(files[0]), "bytes": size, "seconds": self._clock() - began_s}
        crs = crs_of(files[0], origin)
        return done if crs is None else done | {"crs": crs}

    def _heights(self) -> Heights:
        export = self._settings.current.export
        return Heights(export.min_z, export.max_z)


def write_results(
    folder: Path, sonar_map: MapContent, summary: dict[str, Any], trajectory: TrajectoryWriter
) -> None:
    """Write the summary, then the map in every form; each file is whole or as it was.

    Without matplotlib there is no picture. What the map cannot give is removed from the folder,
    so that no result of an earlier run stands beside the new ones. Of a map with lost bricks only
    the summary and the trajectory are written: holes would look like water.

    Raises:
        ExportError: files cannot be written, or the map does not fit into OctoMap's format; the
            other files are there.
    """
    if lost_bricks(summary):
        for name in ("map.bt", "map.ply", "map.png"):
            remove(folder / name)
        _write_summary(folder / "summary.json", summary)
        trajectory.write(sonar_map.config.frames)
        return
    occupied = sonar_map.occupied()
    resolution_m = sonar_map.resolution_m
    problems = [
        *_problem(partial(_write_summary, folder / "summary.json", summary)),
        *_problem(partial(trajectory.write, sonar_map.config.frames)),
        *_problem(partial(_write_octomap, folder / "map.bt", sonar_map)),
        *_problem(partial(_write_cloud, folder / "map.ply", occupied, resolution_m)),
        *_problem(partial(_write_picture, folder / "map.png", occupied, resolution_m, summary)),
    ]
    if problems:
        raise ExportError("; ".join(problems))


def lost_bricks(summary: dict[str, Any]) -> int:
    """Return the number of damaged bricks that are missing in the map of a summary."""
    return int(summary.get("store", {}).get("bricks_lost", 0))


def _problem(write: Callable[[], None]) -> list[str]:
    """Write one file; returns why not, if not: the others are written all the same."""
    try:
        write()
    except ExportError as error:
        return [str(error)]
    return []


def _write_summary(path: Path, summary: dict[str, Any]) -> None:
    with atomic_file(path) as file:
        file.write(json.dumps(summary, indent=2, allow_nan=False).encode() + b"\n")


def _write_cloud(path: Path, occupied: VoxelCloud, resolution_m: float) -> None:
    with atomic_file(path) as file:
        write_ply(file, occupied, resolution_m)


def _write_picture(
    path: Path, occupied: VoxelCloud, resolution_m: float, summary: dict[str, Any]
) -> None:
    title = (
        f"{len(occupied)} occupied voxels of {resolution_m:g} m from "
        f"{summary['pings_mapped']} of {summary['pings_total']} pings"
    )
    with deferred_interrupt():
        if not can_draw():
            remove(path)
            return
        with atomic_file(path) as file:
            write_picture(file, occupied, resolution_m, title)


def _write_octomap(path: Path, sonar_map: MapContent) -> None:
    try:
        sonar_map.save_octomap(path)
    except MapError as error:
        remove(path)
        raise ExportError(f"{path}: not written: {error}") from error


def summary_of(
    source: dict[str, Any],
    sonar_map: MapContent,
    poses: FixedPose | OdometryPoses,
    counters: PipelineCounters,
    wall_s: float,
) -> dict[str, Any]:
    """Build the summary of a run; keys carry units.

    Args:
        source: where pings and odometry came from, by its kind: `recording` or `live`; and what
            the rule learnt, `SonarMap.rule_facts`.
        sonar_map: the map.
        poses: where the poses came from.
        counters: what happened.
        wall_s: seconds from start to end, files not included.
    """
    voxels = sonar_map.counts()
    return {
        "version": __version__,
        "pings_total": counters.pings_total,
        "pings_outside": counters.pings_outside,
        "pings_mapped": counters.pings_mapped,
        "pings_dropped": dict(sorted(counters.pings_dropped.items())),
        "pings_dropped_details": dict(sorted(counters.first_drop.items())),
        "pings_lost": counters.pings_lost,
        "bytes_total": counters.bytes_total,
        "bytes_rejected": counters.bytes_rejected,
        "resyncs": counters.resyncs,
        "messages_rejected": dict(sorted(counters.messages_rejected.items())),
        "messages_doubtful": dict(sorted(counters.messages_doubtful.items())),
        "voxels_occupied": voxels.occupied,
        "voxels_free": voxels.free,
        "voxels_uncertain": voxels.uncertain,
        "voxel_resolution_m": sonar_map.resolution_m,
        "map_memory_bytes": sonar_map.memory_bytes,
        "map_sha256": sonar_map.sha256(),
        "ms_per_ping": counters.ms_per_ping(),
        "wall_s": wall_s,
        "integrator": sonar_map.config.mapping.integrator,
        "rule": sonar_map.config.mapping.rule,
        "poses": _poses(poses),
        **source,
        "config": _plain(sonar_map.config),
    }


def _poses(poses: FixedPose | OdometryPoses) -> dict[str, Any]:
    if isinstance(poses, FixedPose):
        return {"source": "fixed", "odometry_ignored": poses.ignored}
    odometry = poses.odometry
    return {
        "source": "odometry",
        "odometry_received": odometry.received,
        "odometry_accepted": odometry.accepted,
        "odometry_rejected": dict(sorted(odometry.rejects.items())),
        "odometry": odometry.status(),
    }


def recording_facts(sessions: Sequence[RecordedSession]) -> dict[str, Any]:
    """Summarize recordings that were read to the end of the chosen part."""
    parts = [
        {"file": path.name, "offset": part.offset, "bytes": part.bytes}
        for session in sessions
        for path in session.paths
        for part in session.damaged.parts.get(path, ())
    ]
    damages = [session.damage for session in sessions]
    damages += [loss for session in sessions for loss in session.damaged.losses.values()]
    facts = {
        "format": sessions[0].format,
        "files": sum(len(session.paths) for session in sessions),
        "sessions": len(sessions),
        "size_bytes": sum(session.size_bytes for session in sessions),
        "bytes_read": sum(session.bytes_read for session in sessions),
        "truncated": any(session.truncated for session in sessions),
        "damage": next(filter(None, damages), None),
        "data_lost": any(session.damaged.data_lost for session in sessions),
        "damaged_bytes": sum(
            session.damaged.bytes.get(path, 0) for session in sessions for path in session.paths
        ),
        "damaged_parts": parts[:MAX_PARTS],
        "damaged_decisions": sum(
            session.damaged.decisions.get(path, 0) for session in sessions for path in session.paths
        ),
        "damaged_used": sessions[0].damaged.allowed,
    }
    odometry = sessions[0].odometry
    return {"recording": facts if odometry is None else facts | {"odometry": odometry.summary()}}


def localization_summary(snapshot: LocalizationSnapshot) -> dict[str, Any]:
    """How localization stood at the end."""
    belief = snapshot.belief
    reported = {
        "state": snapshot.state,
        "map": None if snapshot.known is None else snapshot.known.path,
        "map_sha256": None if snapshot.known is None else snapshot.known.sha256,
        "updates": snapshot.updates,
        "scans": dict(sorted(snapshot.counts.items())),
        "particles": snapshot.particle_count,
        "sure": snapshot.sure,
        "ambiguous": None if belief is None else belief.ambiguous,
        "pose": None if belief is None else _gaussian(belief.best),
    }
    return {"localization": reported}


def _gaussian(pose: PlanarGaussian) -> dict[str, Any]:
    return {
        "x_m": pose.x_m,
        "y_m": pose.y_m,
        "yaw_rad": pose.yaw_rad,
        "covariance": pose.covariance.tolist(),
    }


def _plain(config: Config) -> dict[str, Any]:
    plain: dict[str, Any] = msgspec.to_builtins(config)
    return plain
