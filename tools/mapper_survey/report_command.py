"""`mapper-survey report`: coverage, overlap and disagreement of a survey's dives."""

import argparse
from contextlib import ExitStack

from mapper_survey.errors import SurveyError
from mapper_survey.place_arguments import add_place, place_of, shown
from mapper_survey.report import REPORT, report_survey
from mapper_survey.report_record import Report
from mapper_survey.running import DIVES, MAP, dive_map

__all__ = ["FOLDER", "add_arguments", "run"]

FOLDER = "report"

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
    """Write the report; returns the exit code.

    Raises:
        SurveyError, MapperdError: what a person can mend.
        OSError: the folder cannot be reached.
    """
    place = place_of(said, FOLDER)
    names = sorted(place.folder.names(DIVES))
    dives = [name.removeprefix(f"{DIVES}/")[:-3] for name in names if name.endswith(".db")]
    if not dives:
        raise SurveyError(
            f"{place.folder.url}/{DIVES}: no map of a dive: run the survey with --dives first"
        )
    with ExitStack() as opened:
        report = report_survey(
            {d: opened.enter_context(place.folder.fetched(dive_map(d))) for d in dives},
            opened.enter_context(place.folder.fetched(MAP)),
            place.out,
            said.tolerance,
            shown("report"),
            origin=place.origin,
            config=place.config,
        )
    for line in _lines(report):
        print(line)
    print(place.out / REPORT)
    return 0


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
