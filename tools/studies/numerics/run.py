"""Measure how errors grow over a million updates, and what single precision costs.

Usage: PYTHONPATH=tools python -m studies numerical-growth [--updates N] [--out FOLDER] [--write]
"""

import argparse
from collections.abc import Callable
from pathlib import Path

from tqdm import tqdm

from studies.numerics import (
    of_maps,
    of_motion,
    of_sums,
    single_map,
    single_places,
    single_simulator,
)
from studies.numerics.panel import Panel
from studies.numerics.picture import draw
from studies.numerics.tables import growth_table, places_table, unmeasured_table
from studies.report import IMAGES, PAGES, write_section

__all__ = ["GROWTHS", "PLACES", "main"]

GROWTHS: tuple[Callable[[int], Panel], ...] = (
    of_maps.log_odds,
    of_motion.turns,
    of_motion.way,
    of_motion.clock,
    of_sums.weights,
    of_sums.echoes,
)
PLACES = (*single_map.PLACES, *single_places.PLACES, *single_simulator.PLACES)

DEFAULT_UPDATES = 1_000_000
PAGE = PAGES["numerical-stability"]
PICTURE = IMAGES / "stability" / "growth.png"


def main() -> None:
    """Measure, draw, print; with --write, into the page too."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--updates", type=int, default=DEFAULT_UPDATES, help="of each experiment")
    parser.add_argument(
        "--out", type=Path, default=Path("out") / "stability", help="of the picture"
    )
    parser.add_argument("--write", action="store_true", help=f"write {PAGE.name} and its picture")
    arguments = parser.parse_args()
    panels = [grow(arguments.updates) for grow in tqdm(GROWTHS, "long runs")]
    measured = [(place, place.measure()) for place in tqdm(PLACES, "single precision")]
    growth = growth_table(panels)
    places = f"{places_table(measured)}\n\n{unmeasured_table()}"
    print(growth, places, sep="\n\n")
    draw(panels, PICTURE if arguments.write else arguments.out / PICTURE.name)
    if arguments.write:
        write_section(PAGE, "growth", growth, "make numerical-growth")
        write_section(PAGE, "single precision", places, "make numerical-growth")


if __name__ == "__main__":
    main()
