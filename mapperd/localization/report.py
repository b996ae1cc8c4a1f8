"""The state of localization as plain values with units in the keys."""

import math
from pathlib import Path
from typing import Any

from mapperd.config.tree import Config
from mapperd.geometry.gaussian import Belief, PlanarGaussian
from mapperd.localization.odom_correction import MapFromOdom
from mapperd.localization.status import Diagnosis, LocalizationSnapshot

__all__ = ["localization_report", "localization_summary", "map_name_of", "state_of"]

LOST_SHARE = 0.5
"""Share of the weight outside the best cluster above which localization counts as lost."""


def state_of(snapshot: LocalizationSnapshot) -> str:
    """Return the state in one or two words.

    Before the first belief this is `LocalizationSnapshot.state`; then `localized`, `ambiguous`, or
    `lost`, if more than half of the weight lies outside the best cluster.
    """
    belief = snapshot.belief
    if belief is None:
        return snapshot.state
    if belief.elsewhere > LOST_SHARE:
        return "lost"
    return "ambiguous" if belief.ambiguous else "localized"


def map_name_of(snapshot: LocalizationSnapshot) -> str:
    """Return the name of the map's file without its folder; empty without a map."""
    return "" if snapshot.known is None else Path(snapshot.known.path).name


def localization_summary(
    snapshot: LocalizationSnapshot | None, config: Config
) -> dict[str, Any] | None:
    """Return the summary for the status; None if localization is off."""
    if snapshot is None:
        return None
    return {
        "mode": config.localization.mode,
        "state": state_of(snapshot),
        "map": map_name_of(snapshot),
        **_of_belief(snapshot),
        "sure": snapshot.sure,
        "diagnostics": snapshot.diagnosis.level,
        "counts": dict(sorted(snapshot.counts.items())),
    }


def localization_report(
    snapshot: LocalizationSnapshot | None, config: Config, particles: int
) -> dict[str, Any]:
    """Build the full report.

    Args:
        snapshot: None if localization is off.
        config: current settings, for frames and mode.
        particles: maximum number in `sample`, evenly spaced among those of the snapshot.

    Returns:
        `mode`, `state`; unless it is off also `map`, the `frame`s, `pose` and `overall` with
        `covariance` of (x, y, yaw), `clusters`, `map_odom`, `diagnostics`, `counts`, and `sample`:
        rows of x, y, yaw and weight. Unknown values are None.
    """
    mode = config.localization.mode
    if snapshot is None:
        return {"mode": mode, "state": "off"}
    amcl, belief = config.amcl, snapshot.belief
    t_s = _seconds(snapshot.stamp_ns)
    frame = {"frame": amcl.global_frame_id}
    child = {"child_frame": amcl.base_frame_id}
    return {
        "mode": mode,
        "state": state_of(snapshot),
        "map": map_name_of(snapshot),
        "t_s": t_s,
        **_of_belief(snapshot),
        "updates": snapshot.updates,
        "sure": snapshot.sure,
        "warning": snapshot.warning,
        "pose": None if belief is None else {"t_s": t_s, **frame, **child, **_pose(belief.best)},
        "overall": None if belief is None else _pose(belief.overall),
        "clusters": [{"mass": one.mass, **_pose(one.pose)} for one in snapshot.clusters],
        "map_odom": _transform(snapshot.transform, config),
        "diagnostics": _diagnostics(snapshot.diagnosis),
        "counts": dict(sorted(snapshot.counts.items())),
        "sample": _sample(snapshot, particles),
    }


def _of_belief(snapshot: LocalizationSnapshot) -> dict[str, Any]:
    belief: Belief | None = snapshot.belief
    report: dict[str, Any] = {"particles": snapshot.particle_count}
    if belief is None:
        return report
    best = belief.best
    std_x_m, std_y_m, std_yaw_rad = _deviations(best)
    return report | {
        "x_m": best.x_m,
        "y_m": best.y_m,
        "yaw_deg": math.degrees(best.yaw_rad),
        "std_x_m": std_x_m,
        "std_y_m": std_y_m,
        "std_yaw_deg": math.degrees(std_yaw_rad),
        "cluster_count": len(belief.masses),
        "ambiguous": belief.ambiguous,
        "confirmed": belief.confirmed,
        "elsewhere": belief.elsewhere,
        "effective_size": belief.effective_size,
    }


def _pose(pose: PlanarGaussian) -> dict[str, Any]:
    return {
        "x_m": pose.x_m,
        "y_m": pose.y_m,
        "yaw_rad": pose.yaw_rad,
        "covariance": pose.covariance.tolist(),
    }


def _transform(transform: MapFromOdom | None, config: Config) -> dict[str, Any] | None:
    if transform is None:
        return None
    return {
        "t_s": _seconds(transform.stamp_ns),
        "frame": config.amcl.global_frame_id,
        "child_frame": config.amcl.odom_frame_id,
        "position_m": transform.map_T_odom[:3, 3].tolist(),
        "orientation_wxyz": transform.map_q_odom.tolist(),
    }


def _diagnostics(diagnosis: Diagnosis) -> dict[str, Any]:
    values: dict[str, Any] = {
        one.name: {
            "value": one.value,
            "warn_level": one.warn_level,
            "level": "WARN" if one.is_too_large else "OK",
        }
        for one in diagnosis.deviations
    }
    return {"level": diagnosis.level, "text": diagnosis.text, **values}


def _sample(snapshot: LocalizationSnapshot, max_particles: int) -> list[list[float]]:
    count = len(snapshot.particles)
    if max_particles <= 0 or not count:
        return []
    step = -(-count // max_particles)
    sample: list[list[float]] = snapshot.particles[::step].tolist()
    return sample


def _deviations(pose: PlanarGaussian) -> tuple[float, float, float]:
    x, y, yaw = (math.sqrt(max(float(pose.covariance[k, k]), 0.0)) for k in range(3))
    return x, y, yaw


def _seconds(stamp_ns: int | None) -> float | None:
    return None if stamp_ns is None else stamp_ns / 1e9
