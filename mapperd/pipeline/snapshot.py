"""Reads the status of the mapping thread as plain values with units in the keys."""

import math
from collections.abc import Callable
from typing import Any

from mapperd.odometry.fusion import FusedPose
from mapperd.pipeline.pose_lookup import FixedPose
from mapperd.pipeline.worker import MappingThread, StatusSnapshot

__all__ = ["snapshot_reader"]


def snapshot_reader(clock: Callable[[], int]) -> Callable[[MappingThread], StatusSnapshot]:
    """Return a function that reads a thread's status between two pings.

    Args:
        clock: of the arrivals, nanoseconds.
    """

    def read(thread: MappingThread) -> StatusSnapshot:
        newest, localization = thread.newest, thread.pipeline.executor.stages.localization
        pose = None if newest is None else newest.pose
        return StatusSnapshot(
            pings=_pings(thread),
            latency_ms=thread.latency.percentiles_ms(clock()),
            behind=_backlog(thread),
            odometry=_odometry(thread),
            robots=_robots(thread, clock()),
            pose=pose if isinstance(pose, FusedPose) else None,
            pose_ns=None if newest is None else newest.posed.complete_ns,
            sonar=_sonar(thread),
            clocks=_clocks(thread),
            progress=thread.progress,
            localization=None if localization is None else localization.facts(),
        )

    return read


def _pings(thread: MappingThread) -> dict[str, Any]:
    counters = thread.pipeline.counters
    return {
        "total": counters.pings_total,
        "mapped": counters.pings_mapped,
        "dropped": dict(sorted(counters.pings_dropped.items())),
        "waiting": thread.pipeline.decoder.waiting + thread.backlog.pings,
    }


def _backlog(thread: MappingThread) -> dict[str, Any]:
    backlog = thread.backlog
    return {
        "late": backlog.late,
        "dropped": backlog.dropped,
        "ready": backlog.pings,
    }


def _odometry(thread: MappingThread) -> dict[str, Any]:
    poses = thread.pipeline.poses
    if isinstance(poses, FixedPose):
        return {"source": "fixed", "ignored": poses.ignored}
    bridge = poses.odometry
    return {
        "source": "odometry",
        "received": bridge.received,
        "accepted": bridge.accepted,
        "rejected": dict(sorted(bridge.rejects.items())),
        **bridge.status(),
    }


def _robots(thread: MappingThread, now_ns: int) -> list[dict[str, Any]]:
    expire_s = thread.pipeline.decoder.config.robot_detection.expire_sec
    seen = thread.pipeline.executor.sightings.since(now_ns, expire_s)
    return [{"t_s": one.t_ns / 1e9, "position_m": list(one.position_m)} for one in seen]


def _sonar(thread: MappingThread) -> dict[str, Any]:
    if thread.newest is None:
        return {}
    ping = thread.newest.posed.ping
    clock = thread.pipeline.decoder.clocks.get(ping.source_id)
    period_s = None if clock is None else clock.period_s
    return {
        "ping_id": ping.ping_id,
        "ping_rate_hz": None if period_s is None else 1 / period_s,
        "range_m": ping.max_range_m,
        "gain_percent": ping.gain_percent if math.isfinite(ping.gain_percent) else None,
        "temperature_c": ping.temperature_c,
        "speed_of_sound_mps": ping.credible_speed_of_sound_mps,
    }


def _clocks(thread: MappingThread) -> dict[str, Any]:
    clocks = thread.pipeline.decoder.clocks.values()
    placed = {
        method: sum(clock.placed[method] for clock in clocks) for method in ("device", "arrival")
    }
    return {"placed": placed, "restarts": sum(clock.restarts for clock in clocks)}
