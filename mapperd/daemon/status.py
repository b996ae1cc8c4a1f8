"""The status of a session in plain values, and events about its changes."""

import asyncio
import re
import time
from typing import Any, NoReturn

import numpy as np

from mapperd import __version__
from mapperd.config.tree import Config
from mapperd.daemon.problems import Problem, problems_of, recording_problem
from mapperd.daemon.session import Live
from mapperd.events import EventLog, Severity
from mapperd.localization.report import localization_summary, map_name_of, state_of
from mapperd.localization.status import LocalizationSnapshot
from mapperd.mapping.sonar_map import SonarMap
from mapperd.odometry.links import LinkPhase, OdometryLink
from mapperd.pipeline.worker import StatusSnapshot
from oculus_driver.link.state import LinkState

__all__ = ["LocalizationWatch", "Watch", "status_of"]


def status_of(
    live: Live, sonar_map: SonarMap, config: Config, uptime_s: float, servers: dict[str, Any]
) -> dict[str, Any]:
    """All keys of `DaemonApi.status` but `phase`."""
    snapshot = live.mapping.snapshot
    parts = _parts(live, snapshot, uptime_s)
    return {
        "reason": live.link.reason,
        "t_s": live.now_ns() / 1e9,
        "problems": [{"code": one.code, "text": one.text} for one in problems_of(parts, config)],
        "version": __version__,
        "session": live.session,
        "progress": snapshot.progress,
        **parts,
        "pose": _pose(snapshot),
        "pings": snapshot.pings,
        "latency_ms": snapshot.latency_ms,
        "behind": {**snapshot.behind, **_queue(live)},
        "map": {
            "memory_bytes": sonar_map.memory_bytes,
            "revision": sonar_map.core.revision,
            "resolution_m": sonar_map.resolution_m,
            **snapshot.rule,
        },
        "robots": snapshot.robots,
        "servers": servers,
    }


def _parts(live: Live, snapshot: StatusSnapshot, uptime_s: float) -> dict[str, Any]:
    """The parts by which problems are found."""
    return {
        "uptime_s": uptime_s,
        "sonar": _sonar(live, snapshot),
        "odometry": {**snapshot.odometry, "connections": {ln.name: _link(ln) for ln in live.links}},
        "localization": localization_summary(snapshot.localization, live.config),
        "recording": live.recorder.status(),
        "store": live.persistence.status(),
    }


def _sonar(live: Live, snapshot: StatusSnapshot) -> dict[str, Any]:
    link, counted = live.link, live.sonar.counters
    return {
        "state": str(link.state),
        "reason": link.reason,
        "address": link.address,
        "connections": counted.connections,
        "losses": counted.losses,
        "bytes": counted.bytes_received,
        "bytes_rejected": counted.bytes_rejected,
        "pings": counted.pings,
        "pings_lost": counted.lost_pings,
        "placed_by": snapshot.clocks["placed"],
        "restarts": snapshot.clocks["restarts"],
        **snapshot.sonar,
        **live.control.status(),
    }


def _link(link: OdometryLink) -> dict[str, Any]:
    status = link.status
    return {
        "link": str(link.address),
        "state": str(status.phase),
        "reason": status.reason,
        "bytes": status.bytes_received,
        "bytes_dropped": link.limit.bytes_dropped,
        "opened": status.opened,
        "losses": status.losses,
    }


def _pose(snapshot: StatusSnapshot) -> dict[str, Any] | None:
    if snapshot.pose is None:
        return None
    pose, variances = snapshot.pose, np.diag(snapshot.pose.covariance)
    std = np.sqrt(np.maximum(variances, 0.0))
    return {
        "t_s": None if snapshot.pose_ns is None else snapshot.pose_ns / 1e9,
        "position_m": pose.pose.position_m.tolist(),
        "map_q_base_wxyz": pose.pose.map_q_base.tolist(),
        "position_std_m": std[:3].tolist(),
        "rotation_std_rad": std[3:].tolist(),
        "segment": pose.segment,
        "reckoned_s": pose.reckoned_s,
    }


def _queue(live: Live) -> dict[str, Any]:
    queue = live.queue
    return {
        "queued_bytes": queue.waiting_bytes,
        "refused_bytes": queue.bytes_refused,
        "refused_chunks": queue.chunks_refused,
    }


TEXTS = {
    "localized": (Severity.NOTICE, "the vehicle is localized"),
    "ambiguous": (Severity.WARNING, "the vehicle may be at more than one place"),
    "lost": (Severity.WARNING, "localization is lost: most of the weight is elsewhere"),
}


class LocalizationWatch:
    """Compares each status with the one before; one thread at a time.

    Args:
        events: the event log.
    """

    def __init__(self, events: EventLog) -> None:
        self._events = events
        self._map = ""
        self._state = ""
        self._level = "OK"
        self._warning: str | None = None

    def update(self, snapshot: LocalizationSnapshot) -> None:
        """Report changes."""
        name = map_name_of(snapshot)
        if name != self._map:
            self._map = name
            self._events.add(
                Severity.NOTICE, "map_loaded", f"localizing on {self._map}", map=self._map
            )
        if snapshot.warning != self._warning:
            self._warning = snapshot.warning
            if snapshot.warning is not None:
                self._events.add(Severity.WARNING, "localization_model", snapshot.warning)
        self._look_at_state(snapshot)
        self._look_at_level(snapshot)

    def _look_at_state(self, snapshot: LocalizationSnapshot) -> None:
        state = state_of(snapshot)
        before, self._state = self._state, state
        if state == before or state not in TEXTS or snapshot.belief is None:
            return
        severity, text = TEXTS[state]
        best = snapshot.belief.best
        where = f"x {best.x_m:.2f} m, y {best.y_m:.2f} m, {best.yaw_rad:.3f} rad"
        share = snapshot.belief.elsewhere
        self._events.add(severity, state, f"{text}; {where} at best", elsewhere=share)

    def _look_at_level(self, snapshot: LocalizationSnapshot) -> None:
        diagnosis = snapshot.diagnosis
        if diagnosis.level == self._level:
            return
        self._level = diagnosis.level
        bad = self._level == "WARN"
        severity = Severity.WARNING if bad else Severity.NOTICE
        text = f"localization: {diagnosis.text}"
        self._events.add(severity, "localization_std", text, level=self._level)


POLL_INTERVAL_S = 1.0
"""Period of looks at what sends no notification."""


class Watch:
    """Looks at one session.

    Args:
        events: the event log.
        live: the session.
    """

    def __init__(self, events: EventLog, live: Live) -> None:
        self._events = events
        self._live = live
        self._late = False
        self._dropped = self._refused = 0
        self._recording: object = None
        self._limits: dict[str, str] = {}
        self._problems: dict[tuple[str, str], Problem] = {}
        self._suspected: dict[tuple[str, str], str] = {}
        self._localization = LocalizationWatch(events)

    def update(self, snapshot: StatusSnapshot) -> None:
        """Look at a new status; in the mapping thread."""
        if snapshot.localization is not None:
            self._localization.update(snapshot.localization)
        self._look_at_refused(snapshot.pings["dropped"].get("fan_too_large", 0))
        behind = snapshot.behind
        if behind["late"] == self._late:
            return
        self._late = behind["late"]
        if self._late:
            text = "pings come faster than they can be mapped"
            self._events.add(Severity.WARNING, "behind", text)
            return
        dropped, self._dropped = behind["dropped"] - self._dropped, behind["dropped"]
        text = f"mapping has caught up; {dropped} pings were dropped"
        self._events.add(Severity.NOTICE, "caught_up", text, pings_dropped=dropped)

    def _look_at_refused(self, pings: int) -> None:
        """Report pings that are too much work, each time that they have doubled."""
        if pings <= self._refused:
            return
        self._refused = 2 * pings
        reason = self._live.counters.first_drop.get("fan_too_large", "")
        self._events.add(
            Severity.WARNING, "pings_refused", f"pings are refused: {reason}", pings=pings
        )

    async def look(self) -> NoReturn:
        """Poll what sends no notification, until cancelled."""
        began_s = time.monotonic()
        while True:
            await asyncio.sleep(POLL_INTERVAL_S)
            self._look_at_recording()
            self._look_at_limits()
            links = (link.status.phase for link in self._live.links)
            if self._live.link.state == LinkState.CLOSED or LinkPhase.CLOSED in links:
                continue  # the session ends
            parts = _parts(self._live, self._live.mapping.snapshot, time.monotonic() - began_s)
            parts["recording"] = parts["store"] = None  # their own events report them
            self.look_at_problems(problems_of(parts, self._live.config))

    def look_at_problems(self, problems: list[Problem]) -> None:
        """Report problems that two looks in a row find, and their end."""
        found = {one.key: one for one in problems}
        for key, one in found.items():
            before = self._problems.get(key)
            if one.code == self._suspected.get(key) and (before is None or before.code != one.code):
                self._events.add(Severity.WARNING, one.code, one.text)
                self._problems[key] = one
        for key in self._problems.keys() - found.keys():
            solved = self._problems.pop(key)
            text = f"solved: {re.split(r'[:;.] ', solved.text)[0]}"
            self._events.add(Severity.NOTICE, "problem_solved", text, problem=solved.code)
        self._suspected = {key: one.code for key, one in found.items()}

    def _look_at_limits(self) -> None:
        """Report links that start or stop to bring more than they may."""
        for link in self._live.links:
            before = self._limits.get(link.name, "")
            reason = self._limits[link.name] = link.limit.reason
            if reason and not before:
                text = f"{link.name}: bytes are neither decoded nor recorded: {reason}"
                self._events.add(Severity.WARNING, "odometry_limited", text, link=link.name)
            elif before and not reason:
                text = f"{link.name}: all bytes are decoded again"
                dropped = link.limit.bytes_dropped
                facts = {"link": link.name, "bytes_dropped": dropped}
                self._events.add(Severity.NOTICE, "odometry_limited", text, **facts)

    def _look_at_recording(self) -> None:
        status = self._live.recorder.status()
        if status is None or status["state"] == self._recording:
            return
        first, self._recording = self._recording is None, status["state"]
        if first and status["state"] == "logging":
            return
        problem = next(recording_problem(status), None)
        why = f": {status['reason']}" if status["reason"] else ""
        self._events.add(
            Severity.NOTICE if problem is None else Severity.ERROR,
            "recording",
            f"recording: {status['state']}{why}" if problem is None else problem.text,
            state=status["state"],
        )
