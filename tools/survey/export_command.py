"""`mapper-survey export`: grids, clouds and soundings of a merged map."""

import argparse
import math

from mapperd.export.cells import Heights
from survey.export import export_survey
from survey.place_arguments import MERGED, add_place, config_of, shown, told
from survey.products import PRODUCTS, Options
from survey.surface import CELL_VOXELS, RULES

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
        help="what to write; default: all, positions only with an origin",
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
        default=0.0,
        metavar="M",
        help="height of the map's zero above what depths are below; default: 0",
    )
    add("--min-z", type=float, default=-math.inf, metavar="M", help="leave out what lies lower")
    add("--max-z", type=float, default=math.inf, metavar="M", help="leave out what lies higher")


def run(said: argparse.Namespace) -> int:
    """Write the products; returns the exit code."""
    return told(lambda: _export(said))


def _export(said: argparse.Namespace) -> None:
    known = [name for name in PRODUCTS if name != "positions" or said.origin is not None]
    options = Options(
        config=config_of(said.config),
        cell_voxels=said.cell_voxels,
        rule=said.rule,
        vertical_uncertainty_m=said.vertical_uncertainty,
        altitude_m=said.altitude,
        heights=Heights(said.min_z, said.max_z),
    )
    out = said.out or said.survey / FOLDER
    done = export_survey(
        said.survey / MERGED,
        out,
        said.products or known,
        said.origin,
        shown("export"),
        options=options,
    )
    for product, path in done.files.items():
        print(f"{path}: {path.stat().st_size} bytes; coordinates: {done.crs[product]}")
