"""summary.json: what went in, what became of it, and what came out, in one object."""

from typing import Any

import msgspec

from mapperd.config import Config
from mapperd.counters import ReplayCounters
from mapperd.mapping import SonarMap
from mapperd.pairing import FixedPose, OdometryPoses
from mapperd.version import version
from oculus_driver.recording import Recording

__all__ = ["summary_of"]


def summary_of(
    recording: Recording,
    sonar_map: SonarMap,
    poses: FixedPose | OdometryPoses,
    counters: ReplayCounters,
    wall_s: float,
) -> dict[str, Any]:
    """Everything that there is to say about a replay; units are in the names.

    Args:
        recording: read to its end, or to the end of the chosen part.
        sonar_map: the map.
        poses: where the poses came from.
        counters: what happened.
        wall_s: seconds from start to end, files not included.
    """
    voxels = sonar_map.counts()
    return {
        "version": version(),
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
        "poses": _poses(poses),
        "recording": _recording(recording),
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
        "odometry_resets": odometry.resets,
    }


def _recording(recording: Recording) -> dict[str, Any]:
    return {
        "format": recording.format,
        "size_bytes": recording.size_bytes,
        "bytes_read": recording.bytes_read,
        "truncated": recording.truncated,
        "damage": recording.damage,
    }


def _plain(config: Config) -> dict[str, Any]:
    plain: dict[str, Any] = msgspec.to_builtins(config)
    return plain
