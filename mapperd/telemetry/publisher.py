"""Choose the messages that are due, and measure processor, memory and disk."""

import os
import shutil
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from mapperd.api import DaemonApi
from mapperd.config.catalog import parameters, value_of
from mapperd.config.tree import Config
from mapperd.events import Severity
from mapperd.telemetry import payloads
from mapperd.telemetry.broker import Kind, Outbox, QueuedMessage
from mapperd.telemetry.payloads import LocalizationReporter, Throttle
from mapperd.telemetry.topics import Topics

__all__ = ["Reporter", "Vitals"]

STATE_S = 30.0
CHANGE_S = 1.0
SONAR_S = 1.0
SLOW_S = 5.0
"""Of the map and the health."""
ROBOTS_S = 0.2
OFTEN_S = 0.2

VitalsSource = Callable[[], Mapping[str, Any]]


class Reporter:
    """Puts what is due into the outbox; used by one thread.

    Args:
        operations: the daemon.
        topics: names of the topics.
        outbox: takes the messages.
        vitals: what the daemon takes of its computer.
        own: counters of the telemetry.

    Attributes:
        events_missed: events discarded before a broker was connected.
    """

    def __init__(
        self,
        operations: DaemonApi,
        topics: Topics,
        outbox: Outbox,
        vitals: VitalsSource,
        own: VitalsSource,
    ) -> None:
        self._operations = operations
        self._topics = topics
        self._outbox = outbox
        self._vitals = vitals
        self._own = own
        self._localization = LocalizationReporter(operations, topics, outbox)
        self._last_event = 0
        self.events_missed = 0
        self.renew()

    def renew(self) -> None:
        """Publish all retained topics again: the broker may be new or have lost them."""
        self._config: Config | None = None
        self._state: dict[str, Any] | None = None
        self._changes: list[dict[str, Any]] | None = None
        self._pose_s = self._robot_s = 0.0
        self._pings: tuple[float, int] | None = None
        self._pose, self._robots = Throttle(OFTEN_S), Throttle(ROBOTS_S)
        self._again, self._change = Throttle(STATE_S), Throttle(CHANGE_S)
        self._sonar, self._slow = Throttle(SONAR_S), Throttle(SLOW_S)
        self._localization.renew()

    @property
    def period_s(self) -> float:
        """How often to collect."""
        return min(OFTEN_S, 1 / self._operations.settings.current.mqtt.pose_rate)

    def collect(self, now_s: float) -> None:
        """Put what is due into the outbox.

        Args:
            now_s: Unix time that is never set back.
        """
        config = self._operations.settings.current
        status = self._operations.status()
        self.collect_events()
        self._publish_settings(config)
        self._publish_state(now_s, status)
        self._publish_pose(now_s, status, config)
        self._publish_robots(now_s, status["robots"] or [], config)
        if status["localization"] is not None:
            self._localization.collect(now_s)
        if self._sonar.due(now_s):
            report = payloads.sonar_report(status, self._rate_hz(now_s, status["pings"]["total"]))
            self._put_state("sonar", {"t_s": now_s, **report}, qos=0)
        if self._slow.due(now_s):
            self._put_state("map", {"t_s": now_s, **payloads.map_report(status)}, qos=0)
            self._publish_changes(now_s)
            health = payloads.health_report(status, self._vitals(), self._own())
            self._put_telemetry("health", {"t_s": now_s, **health})

    def collect_events(self) -> None:
        """Put events into the outbox while there is room; the others wait where they are kept."""
        events, missed = self._operations.events.since(self._last_event)
        if missed:
            self.events_missed += missed
            self._put_event(
                {
                    "severity": str(Severity.WARNING),
                    "code": "events_missed",
                    "text": f"{missed} events were forgotten before they could be sent",
                    "facts": {"missed": missed},
                }
            )
            self._last_event = events[0].number - 1 if events else self._operations.events.last
        for event in events[: max(self._outbox.room, 0)]:
            self._put_event(event.plain())
            self._last_event = event.number

    def _publish_settings(self, config: Config) -> None:
        before, self._config = self._config, config
        if config is before:
            return
        for name in parameters():
            value = value_of(config, name)
            if before is None or value != value_of(before, name):
                self._put_state(f"config/{name}", value, qos=1)
        turned = before is None or config.mounting != before.mounting
        if turned and config.frames.publish_tf:
            self._put_state("tf", payloads.mounting_report(config), qos=1)

    def _publish_state(self, now_s: float, status: Mapping[str, Any]) -> None:
        state = payloads.state_report(status)
        again = self._again.due(now_s)
        if again or (state != self._state and self._change.due(now_s)):
            self._state = state
            content = {"t_s": now_s, "uptime_s": status["uptime_s"], **state}
            self._put_state("state", content, qos=1)

    def _publish_pose(self, now_s: float, status: Mapping[str, Any], config: Config) -> None:
        pose = status["pose"]
        self._pose.period_s = 1 / config.mqtt.pose_rate
        if pose is None or pose["t_s"] == self._pose_s or not self._pose.due(now_s):
            return
        self._pose_s = pose["t_s"]
        self._put_telemetry("pose", payloads.pose_report(status, config.frames))

    def _publish_robots(
        self, now_s: float, robots: list[Mapping[str, Any]], config: Config
    ) -> None:
        newest_s = max((robot["t_s"] for robot in robots), default=0.0)
        if newest_s == self._robot_s or not self._robots.due(now_s):
            return  # an empty list is published once when the last robot expires
        self._robot_s = newest_s
        content = {"t_s": now_s, **payloads.robots_report(robots, config)}
        self._put_telemetry(config.robot_detection.topic, content)

    def _publish_changes(self, now_s: float) -> None:
        changes = self._operations.changes.plain()
        if changes != self._changes:
            self._changes = changes
            self._put_state("changes", {"t_s": now_s, "changes": changes}, qos=1)

    def _rate_hz(self, now_s: float, total: int) -> float | None:
        before, self._pings = self._pings, (now_s, total)
        if before is None or now_s <= before[0]:
            return None
        return (total - before[1]) / (now_s - before[0])

    def _put_state(self, name: str, content: object, qos: int) -> None:
        topic, payload = self._topics.of_name(name), payloads.encoded(content)
        self._outbox.put(QueuedMessage(topic, payload, Kind.STATE, qos, retain=True))

    def _put_telemetry(self, name: str, content: object) -> None:
        topic, payload = self._topics.of_name(name), payloads.encoded(content)
        self._outbox.put(QueuedMessage(topic, payload, Kind.TELEMETRY))

    def _put_event(self, content: object) -> None:
        topic, payload = self._topics.of_name("event"), payloads.encoded(content)
        self._outbox.put(QueuedMessage(topic, payload, Kind.EVENT, qos=1))


STATM = Path("/proc/self/statm")


class Vitals:
    """Asked every few seconds; each answer is about the time since the one before.

    Args:
        folders: whose disks matter.
    """

    def __init__(self, folders: Iterable[Path]) -> None:
        self._folders = tuple(folders)
        self._last = (time.monotonic(), time.process_time())

    def __call__(self) -> dict[str, Any]:
        """`cpu_percent` (of one core), `memory_bytes` (resident), `disk_free_bytes` by folder."""
        now = (time.monotonic(), time.process_time())
        wall_s, cpu_s = (b - a for a, b in zip(self._last, now, strict=True))
        self._last = now
        return {
            "cpu_percent": round(100 * cpu_s / wall_s, 1) if wall_s > 0 else None,
            "memory_bytes": _resident_bytes(),
            "disk_free_bytes": {str(folder): _free_bytes(folder) for folder in self._folders},
        }


def _resident_bytes() -> int | None:
    try:
        pages = int(STATM.read_text(encoding="ascii").split()[1])
    except (OSError, ValueError, IndexError):  # not Linux
        return None
    return pages * os.sysconf("SC_PAGE_SIZE")


def _free_bytes(folder: Path) -> int | None:
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return None
