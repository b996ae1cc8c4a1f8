"""The command `mapper-survey`: many recordings become one map."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mapper_survey import export_command, report_command, scaling_command
from mapper_survey.engine import Engine, InProcess
from mapper_survey.errors import SurveyError
from mapper_survey.folder import Folder
from mapper_survey.memory import bytes_of
from mapper_survey.request import Request, read_survey
from mapper_survey.running import Options, plan_survey, run_survey
from mapperd.errors import MapperdError

__all__ = ["main"]

FAULT, NOT_ALL, INTERRUPTED = 2, 3, 130
"""Exit codes: something to mend; a dive of which not a ping is in the map, which is made of the
others; Ctrl-C."""

FURTHER = (
    ("export", "write grids of depths, a cloud and soundings of the map", export_command),
    ("report", "tell what the dives cover, and how far they disagree", report_command),
    (
        "scaling",
        "simulate the survey on 1 to 1000 workers, and name the bottlenecks",
        scaling_command,
    ),
)
"""Sub-commands that take what `run` has left."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; what a person can mend is one line and exit code 2."""
    said = _parser().parse_args(argv)
    try:
        return int(said.does(said))
    except (SurveyError, MapperdError, OSError) as error:
        sys.stderr.write(f"mapper-survey: {error}\n")
        return FAULT
    except KeyboardInterrupt:
        sys.stderr.write("mapper-survey: interrupted; the same command goes on from here\n")
        return INTERRUPTED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="mapper-survey", description="many recordings become one tiled map"
    )
    does = parser.add_subparsers(required=True, metavar="COMMAND")
    plan = does.add_parser("plan", help="read the recordings alone: where was which ping")
    _add_survey(plan)
    plan.set_defaults(does=_plan)
    run = does.add_parser("run", help="plan, map the tiles, merge; goes on where it was stopped")
    _add_survey(run)
    run.add_argument(
        "--dives",
        action="store_true",
        help="make a map of each dive alone, too: the report compares them",
    )
    run.set_defaults(does=_run)
    for name, what, command in FURTHER:
        further = does.add_parser(name, help=what, description=what)
        command.add_arguments(further)
        further.set_defaults(does=command.run)
    return parser


def _add_survey(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("survey", type=Path, metavar="SURVEY", help="survey.yaml")
    parser.add_argument(
        "--out", required=True, metavar="FOLDER", help="of the survey: a path, or an fsspec URL"
    )
    parser.add_argument(
        "--workers",
        type=int,
        default=2,
        metavar="N",
        help="processes on this machine; 0 does everything in this one (default: 2)",
    )
    parser.add_argument(
        "--scheduler", metavar="tcp://HOST:PORT", help="use the workers of this Dask cluster"
    )
    parser.add_argument(
        "--memory-per-worker",
        default="2GiB",
        metavar="SIZE",
        help="a worker's bound, by which tiles are chosen (default: 2GiB)",
    )


def _plan(said: argparse.Namespace) -> int:
    request = read_survey(said.survey)
    engine = _engine(said)
    try:
        record = plan_survey(request, Folder(said.out), engine, sys.stderr)
    finally:
        engine.close()
    return _tell(record, request)


def _run(said: argparse.Namespace) -> int:
    request = read_survey(said.survey)
    folder = Folder(said.out)
    options = Options(bytes_of(said.memory_per_worker), by_dive=said.dives)
    engine = _engine(said)
    try:
        record = run_survey(request, folder, engine, options, sys.stderr)
    finally:
        engine.close()
    print(f"{record['pings']} pings of {record['recorded_s']:.0f} s: {folder.url}/map.db")
    return _tell(record, request)


def _engine(said: argparse.Namespace) -> Engine:
    if said.workers < 0:
        raise SurveyError(f"--workers {said.workers}: allowed: 0 or more")
    if said.scheduler is None and said.workers == 0:
        return InProcess()
    # Dask takes a second to import, and is not wanted by who does all in one process.
    from mapper_survey.engine_dask import local_pool, on_scheduler  # noqa: PLC0415

    if said.scheduler is not None:
        return on_scheduler(said.scheduler)
    return local_pool(said.workers, bytes_of(said.memory_per_worker))


def _tell(record: dict[str, Any], request: Request) -> int:
    """Say what was lost and what was dropped, all else is in the files; returns the exit code."""
    code = 0
    for dive, told in zip(request.survey.dives, record["dives"], strict=True):
        for lost in told["lost"]:
            sys.stderr.write(f"mapper-survey: dive {dive.name}: {lost['recording']}: ")
            sys.stderr.write(f"{lost['reason']}\n")
        for reason, count in told["pings_dropped"].items():
            detail = told["dropped_details"].get(reason, "")
            sys.stderr.write(f"mapper-survey: dive {dive.name}: {count} pings dropped, ")
            sys.stderr.write(f"{reason}: {detail}\n")
        if told["pings"] == 0:
            code = NOT_ALL
            sys.stderr.write(f"mapper-survey: dive {dive.name}: not a ping of it is in the map\n")
    return code
