"""Make the survey's dives: recordings, their scenes, and the survey files that name them.

    PYTHONPATH=tools python -m studies survey-dives --out out/survey

Leaves `dives/NAME.mcap` and `.yaml`, `survey.yaml` and `mapperd.yaml`; with `--damage` also
`damaged/`, `damaged.yaml` and `damage.json`. After a stop, what was finished is kept.
"""

import argparse
import multiprocessing
import os
import sys
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
from tqdm import tqdm

from studies.survey.damage import Damage, cut, flip
from studies.survey.dives import FULL, PING_RATE_HZ, SMALL, Dive, Plan, dives
from studies.survey.recorder import record
from studies.survey.survey_file import write_survey

if TYPE_CHECKING:
    from multiprocessing.sharedctypes import Synchronized

PLANS = {"full": FULL, "small": SMALL}
LOOK_S = 0.5
"""How often the progress bar looks."""

_done: "list[Synchronized[int]]" = []
"""Pings of all processes, in a worker process."""


def make(folder: Path, plan: Plan, processes: int) -> list[Path]:
    """Record all dives of a plan that are not there yet; returns the recordings, in time."""
    todo = dives(plan)
    if processes == 1:
        recordings = [record(dive, folder / "dives") for dive in todo]
    else:
        recordings = record_all(todo, folder / "dives", processes)
    write_survey(folder, recordings)
    return recordings


def damage(folder: Path, recordings: Sequence[Path], seed: int) -> list[Damage]:
    """Cut a copy of the first recording and flip bytes in one of the second."""
    first, second, *others = recordings
    done = [
        cut(first, folder / "damaged" / f"{first.stem}.mcap", seed),
        flip(second, folder / "damaged" / f"{second.stem}.mcap", seed),
    ]
    write_survey(folder, [*(one.copy for one in done), *others], "damaged.yaml")
    (folder / "damage.json").write_bytes(msgspec.json.encode(done, enc_hook=str))
    return done


def record_all(todo: Sequence[Dive], folder: Path, processes: int) -> list[Path]:
    """Record dives in processes of their own, with a progress bar; what fails ends it soon."""
    # Forking would copy the threads' locks of whatever runs here; spawning does not.
    context = multiprocessing.get_context("spawn")
    done = context.Value("q", 0)
    pool = ProcessPoolExecutor(processes, context, _start, (done,))
    pings = sum(round(dive.duration_s * PING_RATE_HZ) for dive in todo)
    with pool, tqdm(total=pings, unit="ping", file=sys.stderr, disable=None) as bar:
        waiting = futures = [pool.submit(_record, dive, folder) for dive in todo]
        while waiting:
            over, left = wait(waiting, LOOK_S, FIRST_COMPLETED)
            if any(not future.cancelled() and future.exception() for future in over):
                pool.shutdown(wait=False, cancel_futures=True)
            waiting = [future for future in left if not future.cancelled()]
            bar.update(done.value - bar.n)
        return [future.result() for future in futures]


def _start(done: "Synchronized[int]") -> None:
    _done.append(done)


def _record(dive: Dive, folder: Path) -> Path:
    counted = 0

    def progress(pings: int, _of: int) -> None:
        nonlocal counted
        with _done[0].get_lock():
            _done[0].value += pings - counted
        counted = pings

    return record(dive, folder, progress)


def main(argv: Sequence[str] | None = None) -> int:
    """Make them."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    add = parser.add_argument
    add("--out", type=Path, default=Path("out/survey"), metavar="DIR")
    add("--scale", choices=list(PLANS), default="full", help="(default: full, two hours)")
    add("--beams", type=int, choices=(256, 512), help="of the sonar, in place of the scale's")
    add("--processes", type=int, default=os.cpu_count() or 1, help="change nothing in the files")
    add("--damage", action="store_true", help="also damage copies of the first two recordings")
    said = parser.parse_args(argv)
    plan: Plan = PLANS[said.scale]
    if said.beams is not None:
        plan = replace(plan, beams=said.beams)
    recordings = make(said.out, plan, said.processes)
    size_mb = sum(path.stat().st_size for path in recordings) / 1e6
    print(f"{said.out / 'survey.yaml'}: {len(recordings)} dives, {size_mb:.0f} MB")
    if said.damage:
        for one in damage(said.out, recordings, plan.seed):
            print(f"{one.copy}: {one.kind} at {', '.join(map(str, one.places))}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
