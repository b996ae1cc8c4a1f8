"""summary.json: what went in, what became of it, and what came out, in one object."""

from collections.abc import Sequence
from typing import Any

import msgspec

from mapperd.config.tree import Config
from mapperd.geometry.gaussian import PlanarGaussian
from mapperd.localization.status import LocalizationFacts
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.counters import ReplayCounters
from mapperd.pipeline.pose_lookup import FixedPose, OdometryPoses
from mapperd.session.recordings import RecordedSession
from mapperd.version import version

__all__ = ["localization_summary", "recording_facts", "summary_of"]


def summary_of(
    source: dict[str, Any],
    sonar_map: SonarMap,
    poses: FixedPose | OdometryPoses,
    counters: ReplayCounters,
    wall_s: float,
) -> dict[str, Any]:
    """Everything that there is to say about a run; units are in the names.

    Args:
        source: where pings and odometry came from, by its kind: `recording` or `live`.
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
    """What there is to say about recordings that were read to the end of the chosen part."""
    facts = {
        "format": sessions[0].format,
        "files": sum(len(session.paths) for session in sessions),
        "sessions": len(sessions),
        "size_bytes": sum(session.size_bytes for session in sessions),
        "bytes_read": sum(session.bytes_read for session in sessions),
        "truncated": any(session.truncated for session in sessions),
        "damage": next((session.damage for session in sessions if session.damage), None),
    }
    return {"recording": facts}


def localization_summary(facts: LocalizationFacts) -> dict[str, Any]:
    """How localization stood at the end."""
    belief = facts.belief
    told = {
        "state": facts.state,
        "map": None if facts.known is None else facts.known.path,
        "map_sha256": None if facts.known is None else facts.known.sha256,
        "updates": facts.updates,
        "scans": dict(sorted(facts.counts.items())),
        "particles": facts.particle_count,
        "sure": facts.sure,
        "ambiguous": None if belief is None else belief.ambiguous,
        "pose": None if belief is None else _gaussian(belief.best),
    }
    return {"localization": told}


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
