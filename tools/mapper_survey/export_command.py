"""`mapper-survey export`: grids, clouds and soundings of a merged map."""

import argparse
import math

from mapper_survey.export import export_survey
from mapper_survey.place_arguments import add_place, place_of, shown
from mapper_survey.products import PRODUCTS, Options
from mapper_survey.running import MAP
from mapper_survey.surface import CELL_VOXELS, RULES
from mapperd.export.cells import Heights

__all__ = ["FOLDER", "add_arguments", "run"]

FOLDER = "exports"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the sub-command."""
    add_place(parser, FOLDER)
    add = parser.add_argument
    add(
        "--products",
        nargs="+",
        choices=PRODUCTS,
        help="what to write; default: `outputs` of the survey, or all that can be",
    )
    add("--rule", choices=RULES, default="shoalest", help="what stands for a cell of the grid")
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
        help="height of the map's zero above what depths are below; default: the survey's, or 0",
    )
    add("--min-z", type=float, default=-math.inf, metavar="M", help="leave out what lies lower")
    add("--max-z", type=float, default=math.inf, metavar="M", help="leave out what lies higher")


def run(said: argparse.Namespace) -> int:
    """Write the products; returns the exit code.

    Raises:
        SurveyError, MapperdError: what a person can mend.
        OSError: the folder cannot be reached.
    """
    place = place_of(said, FOLDER)
    able = [name for name in PRODUCTS if name != "positions" or place.origin is not None]
    options = Options(
        config=place.config,
        cell_voxels=said.cell_voxels,
        rule=said.rule,
        vertical_uncertainty_m=said.vertical_uncertainty,
        altitude_m=place.altitude_m if said.altitude is None else said.altitude,
        heights=Heights(said.min_z, said.max_z),
    )
    with place.folder.fetched(MAP) as path:
        done = export_survey(
            path,
            place.out,
            said.products or place.outputs or able,
            place.origin,
            shown("export"),
            options=options,
        )
    for product, path in done.files.items():
        print(f"{path}: {path.stat().st_size} bytes; coordinates: {done.crs[product]}")
    return 0
