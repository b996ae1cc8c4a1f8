"""`make stream-study`: what the map stream does on a bad link and with many clients.

Plays the demo's dive, live, into a daemon; writes out/stream/stream.json and the pictures, and with
`--write` the figures and the picture of docs/reports/map-stream.md. A quarter of an hour; wants
out/demo/capture.bin (`make demo`).
"""

import argparse
import json
import platform
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np

from studies.report import IMAGES, PAGES, ROOT, write_section
from studies.stream.link import LinkShape
from studies.stream.scenes import NEAR_M, TetherOutcome, fleet, tether, watchers

__all__ = ["draw_ages", "tables"]


mpl.use("Agg")


PROMISE_S = 3.0
SMOOTH_S = 2.0


def draw_ages(path: Path, outcome: TetherOutcome) -> None:
    """Above the ages of what is near and far, below what came through the link."""
    figure, (above, below) = plt.subplots(
        2, 1, figsize=(9, 6), sharex=True, height_ratios=(2, 1), layout="constrained"
    )
    ages = outcome.ages
    seconds = (ages.times_ns - outcome.joined_ns) / 1e9
    above.plot(seconds, ages.far_s, color="0.6", label=f"beyond {NEAR_M:.0f} m")
    above.plot(seconds, ages.near_s, color="C0", label=f"within {NEAR_M:.0f} m of the vehicle")
    above.axhline(PROMISE_S, color="C3", linewidth=1, linestyle="--", label="promise: 3 s")
    above.set_yscale("symlog", linthresh=PROMISE_S)
    above.set_ylim(0)
    above.set_ylabel("age of the oldest content, s")
    above.legend(loc="upper right")
    shape = outcome.shape
    above.set_title(
        f"The map of a client that joins mid-dive: {shape.bits_per_s / 1e3:.0f} kbit/s, "
        f"{shape.delay_s * 1e3:.0f} ms each way, {shape.loss:.0%} of packets lost"
    )
    received_s = (outcome.traffic[:, 0] - outcome.joined_ns) / 1e9
    edges = np.arange(0, max(received_s.max(initial=1.0), 1.0) + SMOOTH_S, SMOOTH_S)
    until = np.interp(edges, received_s, outcome.traffic[:, 1], left=0)
    below.step(edges[1:], np.diff(until) * 8 / 1e3 / SMOOTH_S, where="pre", color="C2")
    below.axhline(shape.bits_per_s / 1e3, color="0.6", linewidth=1, linestyle="--")
    below.set_ylabel("received, kbit/s")
    below.set_xlabel("seconds since it joined")
    below.set_xlim(0, seconds.max(initial=1.0))
    figure.savefig(path, dpi=110)
    plt.close(figure)


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
        rows += _tether_rows(results["tether"])
    if "fleet" in results:
        one = results["fleet"]
        what = (
            f"{one['clients']} clients for {one['seconds']:.0f} s, {one['connects']} connections, "
            f"{one['restarts']} restarts of the daemon: maps equal in the end"
        )
        rows.append(f"| {what} | {one['equal']} of {one['clients']} |")
    if "watchers" in results:
        rows += _watcher_rows(results["watchers"])
    return "\n".join([*rows, "", ""])


def _tether_rows(one: dict[str, Any]) -> list[str]:
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


def _watcher_rows(costs: dict[str, Any]) -> list[str]:
    none = costs["0"]["cores"]
    return [
        f"| {number} clients that want all but images, {one['pings_per_s']:.1f} pings/s: CPU of "
        f"the daemon, and of that for the clients | {one['cores']:.1%}, "
        f"{one['cores'] - none:.1%} of a core |"
        for number, one in costs.items()
    ]


WATCHED_S = 35.0
USUAL_AGE_S, WORST_AGE_S = 3.0, 5.0
"""Limits of the age of near blocks: 95 % of the time, and always."""
MAX_CORES = 0.15
CLIENTS = (0, 1, 20)


def main() -> int:
    """Run what is asked for; 0 if the stream keeps its promises."""
    parser = argparse.ArgumentParser(prog="stream-study", description=__doc__.partition("\n")[0])
    parser.add_argument("--capture", type=Path, default=ROOT / "out/demo/capture.bin")
    parser.add_argument("--out", type=Path, default=ROOT / "out/stream")
    parser.add_argument("--only", choices=["tether", "fleet", "watchers"], action="append")
    parser.add_argument("--tethers", type=int, default=3, help="runs, each with other losses")
    parser.add_argument("--clients", type=int, default=100, help="of the fleet")
    parser.add_argument("--seconds", type=float, default=60.0, help="of the fleet")
    parser.add_argument("--write", action="store_true", help="into docs/reports/map-stream.md")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    file = args.out / "stream.json"
    results: dict[str, Any] = json.loads(file.read_text()) if file.exists() else {}
    for name in args.only or ["tether", "fleet", "watchers"]:
        with tempfile.TemporaryDirectory(prefix="stream-study-") as folder:
            results[name] = SCENES[name](Path(folder), args)
        file.write_text(json.dumps(results, indent=1))
        print(f"\r{name}: {json.dumps(results[name])}")
    if args.write:
        write_section(PAGES["map-stream"], "study", tables(results), "make stream-study")
        if (args.out / "ages.png").exists():
            shutil.copy(args.out / "ages.png", IMAGES / "stream-age.png")
    return 0 if _kept(results) else 1


def _tether(_: Path, args: argparse.Namespace) -> dict[str, Any]:
    """Rows on the worst run, and of each how old what is near was."""
    runs = []
    for dice in range(1, args.tethers + 1):
        with tempfile.TemporaryDirectory(prefix="stream-study-") as folder:
            runs.append(tether(Path(folder), args.capture, LinkShape(), dice, _print))
    outcome = max(runs, key=lambda run: run.near_s()[0])
    draw_ages(args.out / "ages.png", outcome)
    worst_s = outcome.near_s()[0]
    return {
        "equal": all(run.equal for run in runs),
        "near_worst_s": worst_s,
        "near_p95_s": max(run.near_s()[1] for run in runs),
        "near_each_s": [run.near_s()[0] for run in runs],
        "near_first_s": outcome.first_near_s(),
        "far_caught_up_s": outcome.caught_up_s,
        "bytes": outcome.bytes,
        "lost_packets": outcome.lost_packets,
    }


def _fleet(folder: Path, args: argparse.Namespace) -> dict[str, Any]:
    outcome = fleet(folder, args.capture, args.clients, args.seconds, _print)
    return {name: getattr(outcome, name) for name in outcome.__slots__}


def _watchers(_: Path, args: argparse.Namespace) -> dict[str, Any]:
    costs = {}
    for clients in CLIENTS:
        with tempfile.TemporaryDirectory(prefix="stream-study-") as folder:
            outcome = watchers(Path(folder), args.capture, clients, WATCHED_S, _print)
        costs[str(clients)] = outcome.plain()
    return costs


SCENES = {"tether": _tether, "fleet": _fleet, "watchers": _watchers}


def _kept(results: dict[str, Any]) -> bool:
    """Whether the promises hold, of what was run."""
    kept = []
    if "tether" in results:
        tether = results["tether"]
        kept += [tether["equal"], tether["near_worst_s"] <= WORST_AGE_S]
        kept += [tether["near_p95_s"] <= USUAL_AGE_S]
    if "fleet" in results:
        kept += [results["fleet"]["equal"] == results["fleet"]["clients"]]
    if "watchers" in results:
        cores = {number: cost["cores"] for number, cost in results["watchers"].items()}
        kept += [cores["20"] - cores["0"] < MAX_CORES]
    return all(kept)


def _print(text: str) -> None:
    sys.stderr.write(f"\r\x1b[K{text}")
    sys.stderr.flush()


if __name__ == "__main__":
    sys.exit(main())
