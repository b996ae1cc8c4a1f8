"""How a session goes, in plain values with units in the keys."""

from typing import Any

import numpy as np

from mapperd.config.tree import Config
from mapperd.daemon.session import Live
from mapperd.localization.report import localization_summary
from mapperd.mapping.sonar_map import SonarMap
from mapperd.odometry.links import Link
from mapperd.pipeline.worker import Facts
from mapperd.version import version

__all__ = ["status_of"]


def status_of(
    live: Live, sonar_map: SonarMap, config: Config, uptime_s: float, servers: dict[str, Any]
) -> dict[str, Any]:
    """All keys of `Operations.status` but `phase`."""
    facts = live.mapping.facts
    return {
        "reason": live.link.reason,
        "version": version(),
        "session": live.session,
        "uptime_s": uptime_s,
        "progress": facts.progress,
        "sonar": _sonar(live, facts),
        "odometry": {**facts.odometry, "connections": {ln.name: _link(ln) for ln in live.links}},
        "pose": _pose(facts),
        "localization": localization_summary(facts.localization, config),
        "pings": facts.pings,
        "latency_ms": facts.latency_ms,
        "behind": {**facts.behind, **_queue(live)},
        "map": {
            "memory_bytes": sonar_map.memory_bytes,
            "revision": sonar_map.core.revision,
            "resolution_m": sonar_map.resolution_m,
        },
        "store": live.keep.status(),
        "recording": live.recorder.status(),
        "robots": facts.robots,
        "servers": servers,
    }


def _sonar(live: Live, facts: Facts) -> dict[str, Any]:
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
        "placed_by": facts.clocks["placed"],
        "restarts": facts.clocks["restarts"],
        **facts.sonar,
    }


def _link(link: Link) -> dict[str, Any]:
    status = link.status
    return {
        "link": str(link.address),
        "state": str(status.phase),
        "reason": status.reason,
        "bytes": status.bytes_received,
        "opened": status.opened,
        "losses": status.losses,
    }


def _pose(facts: Facts) -> dict[str, Any] | None:
    if facts.pose is None:
        return None
    pose, variances = facts.pose, np.diag(facts.pose.covariance)
    std = np.sqrt(np.maximum(variances, 0.0))
    return {
        "t_s": None if facts.pose_ns is None else facts.pose_ns / 1e9,
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
