"""The study of `mapper-survey`: two hours of dives, mapped, with workers killed, and compared.

    PYTHONPATH=tools python -m studies survey --out out/survey

Makes the dives, runs the survey with one and two workers, with two that are killed at random, and
on damaged recordings; maps all in one process; compares the maps to the bit; measures what a task
costs the scheduler; and simulates how the survey scales. Leaves study.json and the scaling report.
Steps that are done are not done again.
"""

import argparse
import os
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from mapper_survey import command
from mapper_survey.memory import bytes_of
from mapper_survey.request import read_survey
from mapper_survey.run_record import TaskTime, read_task_times

from studies.survey.make_dives import PLANS, damage, make
from studies.survey.runs import (
    Fingerprint,
    RunUsage,
    SchedulerTime,
    fingerprint,
    map_in_one_process,
    scheduler_time,
    watch,
)

Step = TypeVar("Step", bound=msgspec.Struct)

MEMORY = "1GiB"
KILL_EVERY_S = {"full": 60.0, "small": 6.0}
"""Mean time between two kills, at least."""

MIN_TASK_LENGTHS = 2.0
"""The longest task would be done as often between two kills, of which every other hits its worker.
So about one time in five it is lost, and practically never as often in a row as ends a run."""

PROMISED_SPEED = 20.0
"""Times real time, on two cores."""


class Judged(msgspec.Struct, frozen=True):
    """A run of the survey, and its map.

    Attributes:
        run: what it took.
        recorded_s: of all recordings.
        map: of the merged file.
        lost: what was lost, by dive, from `survey.json`.
    """

    run: RunUsage
    recorded_s: float
    map: Fingerprint
    lost: dict[str, list[Any]]


class Single(msgspec.Struct, frozen=True):
    """The map of one process: its CPU time and fingerprint."""

    cpu_s: float
    pings: int
    map: Fingerprint


class _Record(msgspec.Struct):
    """The parts of `survey.json` that are read here."""

    recorded_s: float
    dives: list[dict[str, Any]]


def main(argv: Sequence[str] | None = None) -> int:
    """Run all; 0 if the maps are equal and what is promised holds."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    add = parser.add_argument
    add("--out", type=Path, default=Path("out/survey"), metavar="DIR")
    add("--scale", choices=list(PLANS), default="full", help="(default: full, two hours)")
    add("--memory", default=MEMORY, metavar="SIZE", help=f"of a worker (default: {MEMORY})")
    args = parser.parse_args(argv)
    out: Path = args.out
    recordings = make(out, PLANS[args.scale], os.cpu_count() or 1)
    damage(out, recordings, PLANS[args.scale].seed)
    whole, damaged = out / "survey.yaml", out / "damaged.yaml"
    one, two = (_judged(out / k, whole, n, args.memory) for n, k in ((1, "one"), (2, "two")))
    tasks = read_task_times(out / "two/survey.json")
    every_s = kill_every_s(tasks, KILL_EVERY_S[args.scale])
    results = {
        "one": one,
        "two": two,
        "killed": _judged(out / "killed", whole, 2, args.memory, every_s),
        "damaged": _judged(out / "with-damage", damaged, 2, args.memory),
    }
    single = _once(out / "single.json", Single, lambda: _single(out, whole, recordings))
    verdicts = verdicts_of(results, single, bytes_of(args.memory), long=args.scale == "full")
    record = {**results, "single": single, "verdicts": verdicts}
    (out / "study.json").write_bytes(msgspec.json.format(msgspec.json.encode(record), indent=2))
    for verdict, holds in verdicts.items():
        print(f"{'holds' if holds else 'FAILS'}: {verdict}")
    handed_out = _once(out / "scheduler.json", SchedulerTime, scheduler_time)
    return max(_scaling(out, handed_out.ms), int(not all(verdicts.values())))


def kill_every_s(tasks: Sequence[TaskTime], min_s: float) -> float:
    """Mean time between two kills of a worker with which the run comes to its end."""
    return max(min_s, MIN_TASK_LENGTHS * max(task.cpu_s for task in tasks))


def _judged(
    out: Path, survey: Path, workers: int, memory: str, every_s: float | None = None
) -> Judged:
    def run() -> Judged:
        shutil.rmtree(out, ignore_errors=True)  # its times are those of a run from nothing
        watched = watch(survey, out, workers, memory, kill_every_s=every_s)
        record = msgspec.json.decode((out / "survey.json").read_bytes(), type=_Record)
        lost = {dive["name"]: dive["lost"] for dive in record.dives if dive["lost"]}
        return Judged(watched, record.recorded_s, fingerprint(out / "map.db"), lost)

    return _once(out.with_suffix(".json"), Judged, run)


def _single(out: Path, survey: Path, recordings: Sequence[Path]) -> Single:
    path = out / "single.db"
    path.unlink(missing_ok=True)
    began_s = time.process_time()
    pings = map_in_one_process(recordings, read_survey(survey).config, path)
    return Single(time.process_time() - began_s, pings, fingerprint(path))


def _once(path: Path, kind: type[Step], do: Callable[[], Step]) -> Step:
    """Result of a step, of now or of an earlier run."""
    if path.exists():
        return msgspec.json.decode(path.read_bytes(), type=kind)
    result = do()
    unfinished = path.with_suffix(".part")
    unfinished.write_bytes(msgspec.json.encode(result))
    unfinished.replace(path)
    return result


def verdicts_of(
    results: dict[str, Judged], single: Single, memory_bytes: int, *, long: bool
) -> dict[str, bool]:
    """What must hold; size, speed and killed workers only where a survey is long enough for them.

    Args:
        results: by run.
        single: the map of one process.
        memory_bytes: that a worker may take.
        long: whether it is.
    """
    one, two, killed, damaged = (results[k] for k in ("one", "two", "killed", "damaged"))
    verdicts = {
        "one worker's map is that of a single process": one.map == single.map,
        "two workers' map is that of a single process": two.map == single.map,
        "killed workers change nothing in the map": killed.map == single.map,
        "damage is reported of both damaged dives": len(damaged.lost) == 2,  # noqa: PLR2004
        "what stands before the damage is used": damaged.map.bricks > 0,
        "no worker takes more memory than it may": all(
            result.run.worker_peak_bytes <= memory_bytes for result in results.values()
        ),
    }
    if long:
        speed = two.recorded_s / two.run.wall_s
        verdicts[f"{PROMISED_SPEED:g} times real time on two workers"] = speed >= PROMISED_SPEED
        verdicts["workers were killed"] = killed.run.killed > 0
        verdicts["the map is larger than a worker's memory"] = single.map.voxel_bytes > memory_bytes
    return verdicts


def _scaling(out: Path, scheduler_ms: float) -> int:
    runs = [f"{workers}={out / name / 'survey.json'}" for workers, name in ((1, "one"), (2, "two"))]
    words = ["--scheduler-ms", f"{scheduler_ms:.2f}", "--out", str(out / "scaling")]
    return command.main(["scaling", *runs, *words])


if __name__ == "__main__":
    sys.exit(main())
