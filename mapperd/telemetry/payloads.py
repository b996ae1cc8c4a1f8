"""Payloads by topic, and the times at which they are due."""

import math
from collections.abc import Mapping
from typing import Any

import msgspec

from mapperd.api import DaemonApi
from mapperd.config.tree import Config, FramesConfig
from mapperd.geometry.frames import pose_from_rpy
from mapperd.telemetry.broker import Kind, Outbox, QueuedMessage
from mapperd.telemetry.topics import Topics

__all__ = [
    "LAYOUT",
    "SAMPLE",
    "LocalizationReporter",
    "Throttle",
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
"""Version of the topics and payloads; also part of the prefix."""

Facts = Mapping[str, Any]


def encoded(payload: object) -> bytes:
    """Encode as JSON; NaN and infinities become null, other objects their text."""
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


def pose_report(status: Facts, frames: FramesConfig) -> dict[str, Any]:
    """The vehicle's pose and its source."""
    odometry = status["odometry"] or {}
    owner = odometry.get("quantities", {}).get("position", {}).get("owner")
    source = owner or odometry.get("source")
    content = {"source": source, "frame": frames.map, "child_frame": frames.base}
    return {**status["pose"], **content}


def sonar_report(status: Facts, ping_rate_hz: float | None) -> dict[str, Any]:
    """Status of the sonar, its link and its pings."""
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


EARLY = 0.1
"""Share of a period that a value may come early. Without it, a caller at about the same rate would
miss every second value."""


class Throttle:
    """Limits how often something is sent on average; two are at least half a period apart.

    Args:
        period_s: minimum time between two; may change.
    """

    def __init__(self, period_s: float) -> None:
        self.period_s = period_s
        self._next_s = -math.inf

    def due(self, now_s: float) -> bool:
        """Whether it is time; if so, the next one is due a period later."""
        if not -self.period_s <= self._next_s - now_s <= 1.5 * self.period_s:
            self._next_s = now_s  # after a pause nothing is made up for; or the period has shrunk
        if now_s < self._next_s - EARLY * self.period_s:
            return False
        self._next_s = max(self._next_s + self.period_s, now_s + self.period_s / 2)
        return True


CLOUD_S = 1.0
AGAIN_S = 5.0
"""Period of diagnostics that do not change."""
CHANGE_S = 1.0

SAMPLE = 100
"""Maximum number of particles in a published cloud."""

CLOUD = ("t_s", "state", "particles", "effective_size", "ambiguous", "elsewhere", "clusters")


class LocalizationReporter:
    """Puts what is due into the outbox; used by one thread.

    Args:
        operations: the daemon.
        topics: names of the topics.
        outbox: takes the messages.
    """

    def __init__(self, operations: DaemonApi, topics: Topics, outbox: Outbox) -> None:
        self._operations = operations
        self._topics = topics
        self._outbox = outbox
        self.renew()

    def renew(self) -> None:
        """Publish all retained topics again."""
        self._level: object = None
        self._pose_s: object = None
        self._transform_s: object = None
        self._cloud_s: object = None
        self._pose, self._cloud = Throttle(CHANGE_S), Throttle(CLOUD_S)
        self._again, self._change = Throttle(AGAIN_S), Throttle(CHANGE_S)

    def collect(self, now_s: float) -> None:
        """Put what is due into the outbox; poses come at `mqtt.pose_rate` at most.

        Args:
            now_s: Unix time that is never set back.
        """
        self._pose.period_s = 1 / self._operations.settings.current.mqtt.pose_rate
        if not self._pose.due(now_s):
            return
        content = self._operations.localization()
        self._publish_pose(content)
        self._publish_diagnostics(now_s, content)
        if content.get("t_s") != self._cloud_s and self._cloud.due(now_s):
            self._cloud_s = content.get("t_s")
            content = self._operations.localization(SAMPLE)
            cloud = {key: content.get(key) for key in CLOUD}
            self._publish("particle_cloud", cloud | {"sample_x_y_yaw_weight": content["sample"]})

    def _publish_pose(self, content: dict[str, Any]) -> None:
        pose, transform = content["pose"], content["map_odom"]
        if pose is not None and pose["t_s"] != self._pose_s:
            self._pose_s = pose["t_s"]
            self._publish("amcl_pose", pose | {"state": content["state"]})
        if transform is not None and transform["t_s"] != self._transform_s:
            self._transform_s = transform["t_s"]
            self._publish("map_odom", transform)

    def _publish_diagnostics(self, now_s: float, content: dict[str, Any]) -> None:
        diagnostics = content["diagnostics"] | {"state": content["state"]}
        level = (diagnostics["level"], diagnostics["state"])
        again = self._again.due(now_s)
        if again or (level != self._level and self._change.due(now_s)):
            self._level = level
            topic = self._topics.of_name("diagnostics")
            payload = encoded({"t_s": now_s, **diagnostics})
            self._outbox.put(QueuedMessage(topic, payload, Kind.STATE, retain=True))

    def _publish(self, name: str, content: object) -> None:
        topic, payload = self._topics.of_name(name), encoded(content)
        self._outbox.put(QueuedMessage(topic, payload, Kind.TELEMETRY))
