"""`make stream-study`: what the map stream does on a bad link and with many clients.

Plays the demo's dive, live, into a daemon; writes out/stream/stream.json and the pictures, and with
`--write` the figures and the picture of docs/reference/map-stream.md. A quarter of an hour; wants
out/demo/capture.bin (`make demo`).
"""

import argparse
import json
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from studies.report import IMAGES, PAGES, ROOT, write_section
from studies.stream.pictures import draw_ages
from studies.stream.report import tables
from studies.stream.scenes import fleet, tether, watchers
from studies.stream.shaped_link import LinkShape

WATCHED_S = 35.0
MOST_AGE_S = 3.0
MOST_CORES = 0.15
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
    parser.add_argument("--write", action="store_true", help="into docs/reference/map-stream.md")
    said = parser.parse_args()
    said.out.mkdir(parents=True, exist_ok=True)
    file = said.out / "stream.json"
    results: dict[str, Any] = json.loads(file.read_text()) if file.exists() else {}
    for name in said.only or ["tether", "fleet", "watchers"]:
        with tempfile.TemporaryDirectory(prefix="stream-study-") as folder:
            results[name] = SCENES[name](Path(folder), said)
        file.write_text(json.dumps(results, indent=1))
        print(f"\r{name}: {json.dumps(results[name])}")
    if said.write:
        write_section(PAGES["map-stream"], "study", tables(results), "make stream-study")
        if (said.out / "ages.png").exists():
            shutil.copy(said.out / "ages.png", IMAGES / "stream-age.png")
    return 0 if _kept(results) else 1


def _tether(_: Path, said: argparse.Namespace) -> dict[str, Any]:
    """Told of the worst run, and of each how old what is near was."""
    runs = []
    for dice in range(1, said.tethers + 1):
        with tempfile.TemporaryDirectory(prefix="stream-study-") as folder:
            runs.append(tether(Path(folder), said.capture, LinkShape(), dice, _say))
    outcome = max(runs, key=lambda run: run.near_s()[0])
    draw_ages(said.out / "ages.png", outcome)
    worst_s, most_s = outcome.near_s()
    return {
        "equal": all(run.equal for run in runs),
        "near_worst_s": worst_s,
        "near_p95_s": most_s,
        "near_each_s": [run.near_s()[0] for run in runs],
        "near_first_s": outcome.first_near_s(),
        "far_caught_up_s": outcome.caught_up_s,
        "bytes": outcome.bytes,
        "lost_packets": outcome.lost_packets,
    }


def _fleet(folder: Path, said: argparse.Namespace) -> dict[str, Any]:
    outcome = fleet(folder, said.capture, said.clients, said.seconds, _say)
    return {name: getattr(outcome, name) for name in outcome.__slots__}


def _watchers(_: Path, said: argparse.Namespace) -> dict[str, Any]:
    costs = {}
    for clients in CLIENTS:
        with tempfile.TemporaryDirectory(prefix="stream-study-") as folder:
            outcome = watchers(Path(folder), said.capture, clients, WATCHED_S, _say)
        costs[str(clients)] = outcome.plain()
    return costs


SCENES = {"tether": _tether, "fleet": _fleet, "watchers": _watchers}


def _kept(results: dict[str, Any]) -> bool:
    """Whether the promises hold, of what was run."""
    kept = []
    if "tether" in results:
        kept += [results["tether"]["equal"], results["tether"]["near_worst_s"] <= MOST_AGE_S]
    if "fleet" in results:
        kept += [results["fleet"]["equal"] == results["fleet"]["clients"]]
    if "watchers" in results:
        cores = {number: cost["cores"] for number, cost in results["watchers"].items()}
        kept += [cores["20"] - cores["0"] < MOST_CORES]
    return all(kept)


def _say(text: str) -> None:
    sys.stderr.write(f"\r\x1b[K{text}")
    sys.stderr.flush()


if __name__ == "__main__":
    sys.exit(main())
