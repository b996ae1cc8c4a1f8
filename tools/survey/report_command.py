"""`mapper-survey report`: coverage, overlap and disagreement of a survey's dives."""

import argparse

from survey.errors import SurveyError
from survey.place_arguments import MERGED, add_place, config_of, shown, told
from survey.report import REPORT, report_survey
from survey.report_record import Report

__all__ = ["DIVES", "FOLDER", "add_arguments", "run"]

DIVES, FOLDER = "dives", "report"

TOLERANCE_M = 0.2
"""That of the published mapper's analyser."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the sub-command."""
    add_place(parser, FOLDER)
    parser.add_argument(
        "--tolerance",
        type=float,
        default=TOLERANCE_M,
        metavar="M",
        help=f"within which voxels of two dives are the same; default: {TOLERANCE_M:g}",
    )


def run(said: argparse.Namespace) -> int:
    """Write the report; returns the exit code."""
    return told(lambda: _report(said))


def _report(said: argparse.Namespace) -> None:
    folder = said.survey / DIVES
    dives = {path.stem: path for path in sorted(folder.glob("*.db"))}
    if not dives:
        raise SurveyError(f"{folder}: no map of a dive (NAME.db): run the survey first")
    out = said.out or said.survey / FOLDER
    report = report_survey(
        dives,
        said.survey / MERGED,
        out,
        said.tolerance,
        shown("report"),
        origin=said.origin,
        config=config_of(said.config),
    )
    for line in _lines(report):
        print(line)
    print(out / REPORT)


def _lines(report: Report) -> list[str]:
    """For a person: the ground, and each pair that looked at the same place."""
    ground = report.coverage
    lines = [f"{ground.merged_m2:.0f} m2 mapped, {ground.overlap_m2:.0f} m2 by two dives or more"]
    return lines + [
        f"{pair.a}, {pair.b}: {pair.mean_missing_share:.1%} without a partner within "
        f"{report.tolerance_m:g} m ({pair.grade}); "
        f"{pair.a_to_b.conflicts + pair.b_to_a.conflicts} conflicts"
        for pair in report.pairs
        if pair.mean_missing_share is not None
    ]
