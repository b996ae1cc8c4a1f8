"""Measure how errors grow over a million updates, and what single precision costs.

Usage: PYTHONPATH=tools python -m studies numerical-growth [--updates N] [--out FOLDER] [--write]
"""

import argparse
from collections.abc import Callable, Sequence
from io import BytesIO
from pathlib import Path

import matplotlib as mpl
import numpy as np
from PIL import Image
from tqdm import tqdm

from studies.numerics import (
    growth,
    single_map,
    single_places,
    single_simulator,
)
from studies.numerics.growth import GrowthPanel
from studies.numerics.single_places import SingleError, SinglePlace
from studies.numerics.sources import NOT_MEASURED
from studies.report import IMAGES, PAGES, write_section

__all__ = ["GROWTHS", "PLACES", "draw", "growth_table", "main", "places_table", "unmeasured_table"]


OURS, OTHERS = "#1f5f8b", ("#c8553d", "#d9a441")
COLOURS = 64
"""Of the picture: enough for lines and text, and a third of the bytes."""


def draw(panels: Sequence[GrowthPanel], file: Path) -> None:
    """A picture of all panels, two side by side."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt  # noqa: PLC0415 after the backend is chosen

    rows = -(-len(panels) // 2)
    figure, axes = plt.subplots(rows, 2, figsize=(11, 3.5 * rows), constrained_layout=True)
    for axis, panel in zip(np.ravel(axes), panels, strict=False):
        others = iter(OTHERS)
        bottom = _bottom(panel)
        for curve in panel.curves:
            colour = OURS if curve.ours else next(others)
            shown = np.where(curve.error == 0.0, bottom, curve.error)
            axis.plot(panel.updates, shown, color=colour, label=curve.label, lw=1.4)
        axis.set(xscale="log", yscale="log", xlabel="updates", ylabel=f"error, {panel.unit}")
        axis.set_title(panel.title, fontsize=10)
        axis.set_ylim(bottom=bottom)
        axis.grid(visible=True, alpha=0.25)
        axis.legend(fontsize=7.5, loc="best")
    file.parent.mkdir(parents=True, exist_ok=True)
    drawn = BytesIO()
    figure.savefig(drawn, dpi=75)
    plt.close(figure)
    Image.open(drawn).convert("RGB").quantize(COLOURS).save(file, optimize=True)


def _bottom(panel: GrowthPanel) -> float:
    """Under the least error that is any; an error of nothing is drawn there."""
    errors = np.concatenate([curve.error for curve in panel.curves])
    return float(errors[errors > 0].min()) / 10


def growth_table(panels: Sequence[GrowthPanel]) -> str:
    """Errors after a tenth, and after all, of the updates."""
    rows = [
        "| what is updated | how | unit | after a thousandth | after all | judged by |",
        "|---|---|---|---:|---:|---|",
    ]
    for panel in panels:
        early = int(np.searchsorted(panel.updates, panel.updates[-1] // 1000))
        for curve in panel.curves:
            ends = " | ".join(_number(curve.error[place]) for place in (early, -1))
            rows.append(
                f"| {panel.title} | {curve.label} | {panel.unit} | {ends} | {panel.oracle} |"
            )
    return "\n".join(rows)


def _number(error: float) -> str:
    return "no number" if not np.isfinite(error) else f"{error:.1e}" if error else "0"


def places_table(measured: Sequence[tuple[SinglePlace, SingleError]]) -> str:
    """Where single precision is, and what it costs."""
    rows = [
        "| where | what | worst error | so | why it is enough | measured |",
        "|---|---|---|---|---|---|",
    ]
    rows += [
        f"| {place.where} | {place.what} | {found.worst} | {found.so} | {place.enough} | "
        f"{f'in numpy: {place.numpy}' if place.numpy else 'of the product'} |"
        for place, found in measured
    ]
    return "\n".join(rows)


def unmeasured_table() -> str:
    """Sources with single precision that no row measures, and why not."""
    rows = ["| not measured | why |", "|---|---|"]
    return "\n".join(
        [*rows, *(f"| {_names(files)} | {reason} |" for reason, files in NOT_MEASURED.items())]
    )


def _names(files: Sequence[str]) -> str:
    """Those of one folder by that."""
    folder = files[0].rpartition("/")[0]
    many = len(files) > 1 and all(name.rpartition("/")[0] == folder for name in files)
    return f"{len(files)} of `{folder}`" if many else ", ".join(f"`{name}`" for name in files)


GROWTHS: tuple[Callable[[int], GrowthPanel], ...] = (
    growth.log_odds,
    growth.turns,
    growth.way,
    growth.clock,
    growth.weights,
    growth.echoes,
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
