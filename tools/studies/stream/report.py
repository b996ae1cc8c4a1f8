"""The figures of the study as Markdown."""

import platform
from typing import Any

__all__ = ["tables"]


def tables(results: dict[str, Any]) -> str:
    """Format the figures."""
    rows = [
        "",
        (
            f"Measured by `make stream-study` on {platform.machine()}, Python "
            f"{platform.python_version()}: the demo's dive, live."
        ),
        "",
        "| what | measured |",
        "|---|---|",
    ]
    if "tether" in results:
        rows += _tether(results["tether"])
    if "fleet" in results:
        one = results["fleet"]
        what = (
            f"{one['clients']} clients for {one['seconds']:.0f} s, {one['connects']} connections, "
            f"{one['restarts']} restarts of the daemon: maps equal in the end"
        )
        rows.append(f"| {what} | {one['equal']} of {one['clients']} |")
    if "watchers" in results:
        rows += _watchers(results["watchers"])
    return "\n".join([*rows, "", ""])


def _tether(one: dict[str, Any]) -> list[str]:
    far = one["far_caught_up_s"]
    link = "256 kbit/s, 300 ms each way, 5 % loss"
    measured = {
        f"{link}: the map equals the daemon's in the end": "yes" if one["equal"] else "NO",
        "the same: age of what is within 10 m, worst and 95 %": (
            f"{one['near_worst_s']:.1f} s, {one['near_p95_s']:.1f} s"
        ),
        f"the same: worst of each of {len(one['near_each_s'])} runs": ", ".join(
            f"{worst_s:.1f} s" for worst_s in one["near_each_s"]
        ),
        "the same: joined in the middle of the dive, near there after": (
            f"{one['near_first_s']:.1f} s"
        ),
        "the same: far caught up after": "not before the dive ended"
        if far is None
        else f"{far:.0f} s",
        "the same: received": f"{one['bytes'] / 1e3:.0f} kB",
    }
    return [f"| {what} | {value} |" for what, value in measured.items()]


def _watchers(costs: dict[str, Any]) -> list[str]:
    none = costs["0"]["cores"]
    return [
        f"| {number} clients that want all but images, {one['pings_per_s']:.1f} pings/s: CPU of "
        f"the daemon, and of that for the clients | {one['cores']:.1%}, "
        f"{one['cores'] - none:.1%} of a core |"
        for number, one in costs.items()
    ]
