"""Measure how errors grow over a million updates, and what single precision costs.

Usage: PYTHONPATH=tools python -m numerical_growth.run [--updates N] [--out FOLDER] [--write]
"""

import argparse
from collections.abc import Callable
from pathlib import Path

from tqdm import tqdm
from write_stability_docs import PAGE, ROOT, page_with

from numerical_growth import (
    of_maps,
    of_motion,
    of_sums,
    single_map,
    single_places,
    single_simulator,
)
from numerical_growth.panel import Panel
from numerical_growth.picture import draw
from numerical_growth.tables import growth_table, places_table, unmeasured_table

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
PICTURE = Path("docs") / "images" / "stability" / "growth.png"


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
    draw(panels, ROOT / PICTURE if arguments.write else arguments.out / PICTURE.name)
    if arguments.write:
        page = PAGE.read_text(encoding="utf-8")
        page = page_with(page_with(page, "growth", growth), "single precision", places)
        PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
