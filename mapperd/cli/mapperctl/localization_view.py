"""Localization for people: a few lines out of what the daemon says of it."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

from mapperd.cli.mapperctl.errors import plain

__all__ = ["localization_lines"]

Said = Mapping[str, Any]


def localization_lines(said: Said) -> Iterator[str]:
    """A headline, and a line each for the pose, how sure it is, the clusters and the transform."""
    if said.get("mode") == "off":
        yield "localization is off: localization.mode"
        return
    on = said.get("map") or "no map"
    yield plain(f"{said.get('state')}, mode {said.get('mode')}, {on}")
    if said.get("pose"):
        yield plain(f"pose      {_pose(said['pose'])}, of {said['particles']} particles")
        share = 100 * said["elsewhere"]
        yield plain(f"elsewhere {share:.1f} % of the weight{_ambiguous(said)}")
    diagnostics = said.get("diagnostics") or {}
    yield plain(f"levels    {diagnostics.get('level')}: {diagnostics.get('text')}")
    for cluster in said.get("clusters") or ():
        yield plain(f"cluster   {100 * cluster['mass']:.1f} % at {_pose(cluster)}")
    if said.get("map_odom"):
        yield plain(f"map_odom  {_transform(said['map_odom'])}")
    counts = ", ".join(f"{name} {count}" for name, count in (said.get("counts") or {}).items())
    yield plain(f"scans     {counts or 'none'}")


def _pose(pose: Said) -> str:
    x_m, y_m, yaw_rad = (math.sqrt(max(pose["covariance"][k][k], 0.0)) for k in range(3))
    return (
        f"x {pose['x_m']:.2f} ± {x_m:.2f} m, y {pose['y_m']:.2f} ± {y_m:.2f} m, "
        f"yaw {math.degrees(pose['yaw_rad']):.1f} ± {math.degrees(yaw_rad):.1f}°"
    )


def _ambiguous(said: Said) -> str:
    return ": ambiguous" if said.get("ambiguous") else ""


def _transform(transform: Said) -> str:
    x_m, y_m, _ = transform["position_m"]
    w, _, _, z = transform["orientation_wxyz"]
    yaw_deg = math.degrees(2 * math.atan2(z, w))
    return f"x {x_m:.2f} m, y {y_m:.2f} m, yaw {yaw_deg:.1f}°"
