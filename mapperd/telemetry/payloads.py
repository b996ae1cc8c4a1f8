"""What is said on each topic: from the daemon's status to payloads; nothing here has a clock."""

from collections.abc import Mapping
from typing import Any

import msgspec

from mapperd.config.tree import Config, Frames
from mapperd.geometry.frames import pose_from_rpy

__all__ = [
    "LAYOUT",
    "encoded",
    "health_report",
    "map_report",
    "mounting_report",
    "pose_report",
    "robots_report",
    "sonar_report",
    "state_report",
]

LAYOUT = 1
"""Version of the topics and payloads; the prefix says it too."""

Facts = Mapping[str, Any]


def encoded(payload: object) -> bytes:
    """As JSON; numbers that are none become null, what has no form of its own its text."""
    return msgspec.json.encode(payload, enc_hook=str)


def state_report(status: Facts) -> dict[str, Any]:
    """What the mapper does and why, without what changes all the time."""
    return {
        "phase": status["phase"],
        "reasons": {
            "mapper": status["reason"],
            "sonar": (status["sonar"] or {}).get("reason"),
        },
        "versions": {"mapperd": status["version"], "telemetry": LAYOUT},
    }


def pose_report(status: Facts, frames: Frames) -> dict[str, Any]:
    """Where the vehicle is, and who says so."""
    odometry = status["odometry"] or {}
    owner = odometry.get("quantities", {}).get("position", {}).get("owner")
    source = owner or odometry.get("source")
    said = {"source": source, "frame": frames.map, "child_frame": frames.base}
    return {**status["pose"], **said}


def sonar_report(status: Facts, ping_rate_hz: float | None) -> dict[str, Any]:
    """The sonar, its link, and what became of its pings."""
    pings = status["pings"]
    return {
        **(status["sonar"] or {}),
        "ping_rate_hz": ping_rate_hz,
        "pings_total": pings["total"],
        "pings_mapped": pings["mapped"],
        "pings_dropped": pings["dropped"],
    }


def map_report(status: Facts) -> dict[str, Any]:
    """How large the map is, and what of it is on disk."""
    return {**status["map"], "store": status["store"]}


def health_report(status: Facts, vitals: Facts, telemetry: Facts) -> dict[str, Any]:
    """Queues, latency, and what the mapper takes of its computer."""
    return {
        "latency_ms": status["latency_ms"],
        "pings_waiting": status["pings"]["waiting"],
        "behind": status["behind"],
        "recording": status["recording"],
        "telemetry": telemetry,
        **vitals,
    }


def robots_report(robots: list[Facts], config: Config) -> dict[str, Any]:
    """Robots that were seen lately, oldest first."""
    return {
        "frame": config.frames.map,
        "expire_s": config.robot_detection.expire_sec,
        "robots": robots,
    }


def mounting_report(config: Config) -> dict[str, Any]:
    """Where the sonar sits on the vehicle."""
    place, angles = config.mounting.position, config.mounting.orientation
    pose = pose_from_rpy((place.x, place.y, place.z), (angles.roll, angles.pitch, angles.yaw))
    return {
        "frame": config.frames.base,
        "child_frame": config.frames.sonar,
        "position_m": [float(one) for one in pose.position_m],
        "orientation_wxyz": [float(one) for one in pose.map_q_base],
    }
