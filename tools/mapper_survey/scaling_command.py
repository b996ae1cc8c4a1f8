"""`mapper-survey scaling`: how the survey would go on clusters of other sizes."""

import argparse
import sys
from math import inf
from pathlib import Path

import msgspec

from mapper_survey.cluster_simulation import Cluster
from mapper_survey.scaling import WORKERS, scaling
from mapper_survey.scaling_record import Run, read_run, record_of, tables

SCHEDULER_MS = 3.0
"""Of CPU time. Measured were 2.4 ms for a task that does nothing, 3.6 ms for one that brings 100 kB
(Dask 2026.8, scheduler and client in one process). Dask's documentation says 0.2 to 1 ms (Best
Practices, "Avoid very large graphs")."""

STORAGE_MB_PER_S = 1250.0
"""Of a file server behind ten-gigabit Ethernet."""

LINK_MB_PER_S = 125.0
"""Of a worker behind gigabit Ethernet."""

MEGA, MILLI = 1e6, 1e-3
FAULT = 2


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what may be said."""
    add = parser.add_argument
    add(
        "runs",
        nargs="+",
        type=_run,
        metavar="WORKERS=SURVEY.JSON",
        help="records of runs that began with nothing; the one of the fewest workers is simulated",
    )
    add("--out", type=Path, required=True, metavar="DIR", help="of scaling.json, .png and .md")
    add("--workers", nargs="+", type=_count, default=list(WORKERS), metavar="N", help="to simulate")
    add("--scheduler-ms", type=float, default=SCHEDULER_MS, metavar="MS", help="of each task")
    storage = "of the shared storage, all workers together; 0 is without a bound"
    add("--storage-mb-per-s", type=float, default=STORAGE_MB_PER_S, metavar="MB", help=storage)
    link = "between the storage and one worker; 0 is without a bound"
    add("--link-mb-per-s", type=float, default=LINK_MB_PER_S, metavar="MB", help=link)


def run(arguments: argparse.Namespace) -> int:
    """Simulate, write, and say what limits most."""
    try:
        runs = sorted((read_run(*run) for run in arguments.runs), key=lambda run: run.workers)
        cluster = Cluster(
            1,
            arguments.scheduler_ms * MILLI,
            _bytes_per_s(arguments.storage_mb_per_s),
            _bytes_per_s(arguments.link_mb_per_s),
        )
        return _report(runs, cluster, sorted(set(arguments.workers)), arguments.out)
    except (OSError, ValueError) as error:
        sys.stderr.write(f"mapper-survey scaling: {error}\n")
        return FAULT


def _report(runs: list[Run], cluster: Cluster, workers: list[int], out: Path) -> int:
    record = record_of(runs, cluster, scaling(runs[0].tasks, cluster, workers))
    out.mkdir(parents=True, exist_ok=True)
    text = tables(record)
    encoded = msgspec.json.format(msgspec.json.encode(record), indent=2)
    (out / "scaling.json").write_bytes(encoded + b"\n")
    (out / "scaling.md").write_text(text + "\n", encoding="utf-8")
    print(text)
    try:
        from mapper_survey.scaling_picture import draw  # noqa: PLC0415 matplotlib is an extra
    except ImportError as error:
        sys.stderr.write(f"mapper-survey scaling: no picture: {error.name} is missing\n")
    else:
        draw(record, out / "scaling.png")
    return 0


def _bytes_per_s(mb_per_s: float) -> float:
    return mb_per_s * MEGA if mb_per_s else inf


def _run(said: str) -> tuple[int, Path]:
    workers, equals, path = said.partition("=")
    if not equals:
        raise argparse.ArgumentTypeError(f"{said!r}: allowed: WORKERS=FILE, such as 2=survey.json")
    return _count(workers), Path(path)


def _count(said: str) -> int:
    if not said.isdecimal() or int(said) < 1:
        raise argparse.ArgumentTypeError(f"{said!r}: allowed: whole numbers from 1")
    return int(said)
