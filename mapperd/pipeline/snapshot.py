"""What the mapping thread says about itself, in plain values with units in the keys."""

import math
from collections.abc import Callable
from typing import Any

from mapperd.odometry.fusion import FusedPose
from mapperd.pipeline.pose_lookup import FixedPose, OdometryPoses
from mapperd.pipeline.worker import MappingThread, StatusSnapshot

__all__ = ["snapshot_reader"]


def snapshot_reader(
    poses: FixedPose | OdometryPoses, clock: Callable[[], int]
) -> Callable[[MappingThread], StatusSnapshot]:
    """What reads a thread's facts, between two pings.

    Args:
        poses: where the thread's poses come from.
        clock: of the arrivals, nanoseconds.
    """

    def read(thread: MappingThread) -> StatusSnapshot:
        newest, onboard = thread.newest, thread.integration.onboard
        pose = None if newest is None else newest.pose
        return StatusSnapshot(
            pings=_pings(thread),
            latency_ms=thread.latency.percentiles_ms(clock()),
            behind=_backlog(thread),
            odometry=_odometry(poses),
            robots=_robots(thread, clock()),
            pose=pose if isinstance(pose, FusedPose) else None,
            pose_ns=None if newest is None else newest.complete_ns,
            sonar=_sonar(thread),
            clocks=_clocks(thread),
            progress=thread.progress,
            localization=None if onboard is None else onboard.facts(),
        )

    return read


def _pings(thread: MappingThread) -> dict[str, Any]:
    counters = thread.integration.stepping.counters
    return {
        "total": counters.pings_total,
        "mapped": counters.pings_mapped,
        "dropped": dict(sorted(counters.pings_dropped.items())),
        "waiting": thread.engine.waiting + thread.backlog.pings,
    }


def _backlog(thread: MappingThread) -> dict[str, Any]:
    backlog = thread.backlog
    return {
        "late": backlog.late,
        "dropped": backlog.dropped,
        "ready": backlog.pings,
    }


def _odometry(poses: FixedPose | OdometryPoses) -> dict[str, Any]:
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
    expire_s = thread.engine.config.robot_detection.expire_sec
    seen = thread.integration.stepping.sightings.since(now_ns, expire_s)
    return [{"t_s": one.t_ns / 1e9, "position_m": list(one.position_m)} for one in seen]


def _sonar(thread: MappingThread) -> dict[str, Any]:
    if thread.newest is None:
        return {}
    ping = thread.newest.ping
    clock = thread.engine.clocks.get(ping.source_id)
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
    clocks = thread.engine.clocks.values()
    placed = {
        method: sum(clock.placed[method] for clock in clocks) for method in ("device", "arrival")
    }
    return {"placed": placed, "restarts": sum(clock.restarts for clock in clocks)}
