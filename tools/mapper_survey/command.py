"""The command `mapper-survey`: makes one map from many recordings."""

import argparse
import math
import os
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec

from mapper_survey.aligning import align_survey, dives_of
from mapper_survey.arguments import add_survey_arguments, progress_lines, resolve_arguments
from mapper_survey.cluster_simulation import ComputeCluster
from mapper_survey.engine import Engine, InProcess
from mapper_survey.errors import SurveyError, SurveyMissingError, SurveySettingsError
from mapper_survey.export import PRODUCTS, ExportOptions, export_survey
from mapper_survey.folder import Folder
from mapper_survey.memory import bytes_of
from mapper_survey.report import REPORT, PairRecord, Report, report_survey
from mapper_survey.request import Request, read_survey
from mapper_survey.running import DIVES, MAP, RunOptions, dive_map, plan_survey, run_survey
from mapper_survey.scaling import (
    WORKERS,
    ScalingRun,
    draw_scaling,
    read_run,
    record_of,
    scaling,
    tables,
)
from mapper_survey.surface import CELL_VOXELS, RULES
from mapperd import __version__
from mapperd.errors import ConfigError, ExportError, ExportExtraError, MapperdError
from mapperd.export.cells import Heights
from oculus_driver.command_line import CommandParser, ExitCode

__all__ = ["main"]


EPILOG = """\
examples:
  mapper-survey run survey.yaml --out survey --workers 8 --dives
  mapper-survey report survey --tolerance 0.2

exit codes: 0 success; 2 usage error; 3 a dive contributed no ping, or dives were not aligned; 65
not a recording or map; 66 no such file; 73 cannot write; 78 invalid survey or settings, or a
missing extra; 130 interrupted"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; errors that the user can correct are one line and an exit code."""
    args = _parser().parse_args(argv)
    try:
        return int(args.does(args))
    except (SurveyError, MapperdError, OSError) as error:
        sys.stderr.write(f"mapper-survey: {error}\n")
        return _exit_code_of(error)
    except KeyboardInterrupt:
        sys.stderr.write("mapper-survey: interrupted; run the same command to continue\n")
        return ExitCode.INTERRUPTED


def _exit_code_of(error: Exception) -> ExitCode:
    codes = {
        SurveyMissingError: ExitCode.NO_INPUT,
        SurveySettingsError: ExitCode.BAD_CONFIG,
        SurveyError: ExitCode.USAGE,
        ConfigError: ExitCode.BAD_CONFIG,
        ExportExtraError: ExitCode.BAD_CONFIG,
        ExportError: ExitCode.CANNOT_WRITE,
        MapperdError: ExitCode.BAD_DATA,
        FileNotFoundError: ExitCode.NO_INPUT,
    }
    found = (code for kind, code in codes.items() if isinstance(error, kind))
    return next(found, ExitCode.CANNOT_WRITE)


def _parser() -> argparse.ArgumentParser:
    parser = CommandParser(
        prog="mapper-survey",
        description="Make one tiled map of many recordings.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_completion()
    does = parser.add_subparsers(required=True, metavar="COMMAND")
    plan = does.add_parser("plan", help="read the recordings and list where each ping was")
    _add_survey(plan)
    plan.set_defaults(does=_plan)
    run = does.add_parser("run", help="plan, map the tiles and merge them; resumes after a stop")
    _add_survey(run)
    run.add_argument(
        "--dives",
        action="store_true",
        help="also make a map of each dive, for the report",
    )
    run.set_defaults(does=_run)
    for name, what, add_arguments, run_command in FURTHER:
        further = does.add_parser(name, help=what, description=what)
        add_arguments(further)
        further.set_defaults(does=run_command)
    parser.add_version(f"mapper-survey {__version__}")
    return parser


def _add_survey(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("survey", type=Path, metavar="SURVEY", help="survey.yaml")
    parser.add_argument(
        "--out",
        required=True,
        metavar="FOLDER",
        help="folder of the survey: a path or an fsspec URL",
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
        help="memory limit of a worker; determines the tiles (default: 2GiB)",
    )


def _plan(args: argparse.Namespace) -> int:
    request = read_survey(args.survey)
    engine = _engine(args)
    try:
        record = plan_survey(request, Folder(args.out), engine, sys.stderr)
    finally:
        engine.close()
    return _report_losses(record, request)


def _run(args: argparse.Namespace) -> int:
    request = read_survey(args.survey)
    folder = Folder(args.out)
    options = RunOptions(bytes_of(args.memory_per_worker), by_dive=args.dives)
    engine = _engine(args)
    try:
        record = run_survey(request, folder, engine, options, sys.stderr)
    finally:
        engine.close()
    print(f"{record['pings']} pings of {record['recorded_s']:.0f} s: {folder.url}/map.db")
    return _report_losses(record, request)


def _engine(args: argparse.Namespace) -> Engine:
    if args.workers < 0:
        raise SurveyError(f"--workers {args.workers}: allowed: 0 or more")
    if args.scheduler is None and args.workers == 0:
        return InProcess()
    # Dask takes a second to import and is not needed in one process.
    from mapper_survey.engine_dask import local_pool, on_scheduler  # noqa: PLC0415

    if args.scheduler is not None:
        return on_scheduler(args.scheduler)
    return local_pool(args.workers, bytes_of(args.memory_per_worker))


def _report_losses(record: dict[str, Any], request: Request) -> int:
    """Report lost and dropped data; return the exit code."""
    code = 0
    for dive, record_of_dive in zip(request.survey.dives, record["dives"], strict=True):
        for lost in record_of_dive["lost"]:
            sys.stderr.write(f"mapper-survey: dive {dive.name}: {lost['recording']}: ")
            sys.stderr.write(f"{lost['reason']}\n")
        for reason, count in record_of_dive["pings_dropped"].items():
            detail = record_of_dive["dropped_details"].get(reason, "")
            sys.stderr.write(f"mapper-survey: dive {dive.name}: {count} pings dropped, ")
            sys.stderr.write(f"{reason}: {detail}\n")
        if record_of_dive["pings"] == 0:
            code = ExitCode.NOT_ALL
            sys.stderr.write(f"mapper-survey: dive {dive.name}: not a ping of it is in the map\n")
    return code


def _add_align_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the sub-command."""
    add = parser.add_argument
    add(
        "dives",
        nargs="+",
        type=Path,
        metavar="RECORDING",
        help="recordings, a dive each: files or folders; or one survey.yaml with its dives",
    )
    add(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder for trajectories, report.md, alignment.json, graph.g2o and survey.yaml",
    )
    add("--config", type=Path, metavar="FILE", help="settings of the recordings")
    add(
        "--odometry",
        nargs="+",
        type=Path,
        default=[],
        metavar="FILE",
        help="odometry of another file for each recording, in the same order",
    )
    add(
        "--threads",
        type=_count,
        default=len(os.sched_getaffinity(0)),
        metavar="N",
        help="threads; the result does not depend on them (default: all cores)",
    )


def _align(args: argparse.Namespace) -> int:
    """Align and write; return the exit code.

    Raises:
        SurveyError, MapperdError: what a person can mend.
        OSError: the folder cannot be reached.
    """
    request = dives_of(args.dives, args.config, args.odometry)

    def progress(share: float, what: str) -> None:
        sys.stderr.write(f"align: {share:.0%}, {what}\n")

    record = align_survey(request, args.out, args.threads, progress)
    for dive in record.dives:
        print(
            f"{dive.name}: correction {dive.correction_rms_m:.2f} m RMS, at most "
            f"{dive.correction_max_m:.2f} m; standard deviation {dive.deviation_mean_m:.2f} m"
        )
    print(f"{record.verdict}: {args.out / 'report.md'}")
    return ExitCode.OK if record.corrected else ExitCode.NOT_ALL


EXPORT_FOLDER = "exports"


def _add_export_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the sub-command."""
    add_survey_arguments(parser, EXPORT_FOLDER)
    add = parser.add_argument
    add(
        "--products",
        nargs="+",
        choices=PRODUCTS,
        help="products to write; default: `outputs` of the survey, or all possible ones",
    )
    add("--rule", choices=RULES, default="shoalest", help="depth of a cell of the grid")
    add(
        "--cell-voxels",
        type=int,
        choices=CELL_VOXELS,
        default=1,
        help="edge of a cell in voxels; default: 1",
    )
    add(
        "--vertical-uncertainty",
        type=float,
        default=0.0,
        metavar="M",
        help="standard deviation of heights by navigation and tide; default: 0",
    )
    add(
        "--altitude",
        type=float,
        metavar="M",
        help="height of the map's zero above the datum of depths; default: the survey's, or 0",
    )
    add("--min-z", type=float, default=-math.inf, metavar="M", help="leave out everything below")
    add("--max-z", type=float, default=math.inf, metavar="M", help="leave out everything above")


def _export(args: argparse.Namespace) -> int:
    """Write the products; return the exit code.

    Raises:
        SurveyError, MapperdError: what a person can mend.
        OSError: the folder cannot be reached.
    """
    asked = resolve_arguments(args, EXPORT_FOLDER)
    able = [name for name in PRODUCTS if name != "positions" or asked.origin is not None]
    options = ExportOptions(
        config=asked.config,
        cell_voxels=args.cell_voxels,
        rule=args.rule,
        vertical_uncertainty_m=args.vertical_uncertainty,
        altitude_m=asked.altitude_m if args.altitude is None else args.altitude,
        heights=Heights(args.min_z, args.max_z),
        accuracy=asked.accuracy,
    )
    with asked.folder.fetched(MAP) as path:
        done = export_survey(
            path,
            asked.out,
            args.products or asked.outputs or able,
            asked.origin,
            progress_lines("export"),
            options=options,
        )
    for product, path in done.files.items():
        print(f"{path}: {path.stat().st_size} bytes; coordinates: {done.crs[product]}")
    for line in asked.accuracy:
        print(f"horizontal standard deviation of poses: {line}")
    return 0


REPORT_FOLDER = "report"

TOLERANCE_M = 0.2
"""Default tolerance, as in the analyser of sonar_3d_reconstruction."""


def _add_report_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the sub-command."""
    add_survey_arguments(parser, REPORT_FOLDER)
    parser.add_argument(
        "--tolerance",
        type=float,
        default=TOLERANCE_M,
        metavar="M",
        help=f"distance up to which voxels of two dives agree; default: {TOLERANCE_M:g}",
    )


def _report(args: argparse.Namespace) -> int:
    """Write the report; return the exit code.

    Raises:
        SurveyError, MapperdError: what a person can mend.
        OSError: the folder cannot be reached.
    """
    asked = resolve_arguments(args, REPORT_FOLDER)
    names = sorted(asked.folder.names(DIVES))
    dives = [name.removeprefix(f"{DIVES}/")[:-3] for name in names if name.endswith(".db")]
    if not dives:
        raise SurveyError(
            f"{asked.folder.url}/{DIVES}: no map of a dive: run the survey with --dives first"
        )
    with ExitStack() as opened:
        report = report_survey(
            {d: opened.enter_context(asked.folder.fetched(dive_map(d))) for d in dives},
            opened.enter_context(asked.folder.fetched(MAP)),
            asked.out,
            args.tolerance,
            progress_lines("report"),
            origin=asked.origin,
            config=asked.config,
        )
    for line in _report_lines(report):
        print(line)
    print(asked.out / REPORT)
    return 0


def _report_lines(report: Report) -> list[str]:
    """Lines for people: coverage, and each pair of overlapping dives."""
    ground = report.coverage
    lines = [f"{ground.merged_m2:.0f} m2 mapped, {ground.overlap_m2:.0f} m2 by two dives or more"]
    return lines + [
        f"{pair.a}, {pair.b}: {pair.mean_missing_share:.1%} without a partner within "
        f"{report.tolerance_m:g} m ({pair.grade or _overlap_text(pair)}); "
        f"{pair.a_to_b.conflicts + pair.b_to_a.conflicts} conflicts"
        for pair in report.pairs
        if pair.mean_missing_share is not None
    ]


def _overlap_text(pair: PairRecord) -> str:
    ways = pair.a_to_b, pair.b_to_a
    compared, voxels = (sum(getattr(way, name) for way in ways) for name in ("compared", "voxels"))
    return f"no grade: {compared} of {voxels} voxels overlap"


SCHEDULER_MS = 3.0
"""CPU time of the scheduler for a task. Measured: 2.4 ms for an empty task, 3.6 ms with 100 kB
(Dask 2026.8, scheduler and client in one process). Dask's documentation states 0.2 to 1 ms (Best
Practices, "Avoid very large graphs")."""

STORAGE_MB_PER_S = 1250.0
"""Bandwidth of a file server with ten-gigabit Ethernet."""

LINK_MB_PER_S = 125.0
"""Bandwidth of a worker with gigabit Ethernet."""

MEGA, MILLI = 1e6, 1e-3


def _add_scaling_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the sub-command."""
    add = parser.add_argument
    add(
        "runs",
        nargs="+",
        type=_run_argument,
        metavar="WORKERS=SURVEY.JSON",
        help="records of complete runs; the one with the fewest workers is simulated",
    )
    add(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder for scaling.json, .png and .md",
    )
    add(
        "--workers",
        nargs="+",
        type=_count,
        default=list(WORKERS),
        metavar="N",
        help="simulated numbers",
    )
    add("--scheduler-ms", type=float, default=SCHEDULER_MS, metavar="MS", help="CPU time per task")
    storage = "rate of the shared storage for all workers; 0: no limit"
    add("--storage-mb-per-s", type=float, default=STORAGE_MB_PER_S, metavar="MB", help=storage)
    link = "rate between the storage and one worker; 0: no limit"
    add("--link-mb-per-s", type=float, default=LINK_MB_PER_S, metavar="MB", help=link)


def _scaling(args: argparse.Namespace) -> int:
    """Simulate, write and print the tables."""
    try:
        runs = sorted((read_run(*run) for run in args.runs), key=lambda run: run.workers)
        cluster = ComputeCluster(
            1,
            args.scheduler_ms * MILLI,
            _bytes_per_s(args.storage_mb_per_s),
            _bytes_per_s(args.link_mb_per_s),
        )
        return _write_scaling(runs, cluster, sorted(set(args.workers)), args.out)
    except (OSError, ValueError) as error:
        sys.stderr.write(f"mapper-survey scaling: {error}\n")
        return ExitCode.USAGE


def _write_scaling(
    runs: list[ScalingRun], cluster: ComputeCluster, workers: list[int], out: Path
) -> int:
    record = record_of(runs, cluster, scaling(runs[0].tasks, cluster, workers))
    out.mkdir(parents=True, exist_ok=True)
    text = tables(record)
    encoded = msgspec.json.format(msgspec.json.encode(record), indent=2)
    (out / "scaling.json").write_bytes(encoded + b"\n")
    (out / "scaling.md").write_text(text + "\n", encoding="utf-8")
    print(text)
    try:
        draw_scaling(record, out / "scaling.png")
    except ImportError as error:
        sys.stderr.write(f"mapper-survey scaling: no picture: {error.name} is missing\n")
    return 0


def _bytes_per_s(mb_per_s: float) -> float:
    return mb_per_s * MEGA if mb_per_s else math.inf


def _run_argument(text: str) -> tuple[int, Path]:
    workers, equals, path = text.partition("=")
    if not equals:
        raise argparse.ArgumentTypeError(f"{text!r}: allowed: WORKERS=FILE, such as 2=survey.json")
    return _count(workers), Path(path)


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r}: allowed: whole numbers from 1")
    return int(text)


FURTHER = (
    (
        "align",
        "estimate drifting trajectories again, in one frame, from what the sonar saw",
        _add_align_arguments,
        _align,
    ),
    (
        "export",
        "write grids of depths, a cloud and soundings of the map",
        _add_export_arguments,
        _export,
    ),
    (
        "report",
        "compare what the dives cover, and how far they disagree",
        _add_report_arguments,
        _report,
    ),
    (
        "scaling",
        "simulate the survey on 1 to 1000 workers, and name the bottlenecks",
        _add_scaling_arguments,
        _scaling,
    ),
)
"""Sub-commands that need no engine."""
