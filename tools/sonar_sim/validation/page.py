"""All cases as one picture page."""

import math
from collections.abc import Sequence
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from sonar_sim.validation.case import CaseResult

COLUMNS = 4
GOOD, BAD = "#1b7f3b", "#b3261e"


def draw_page(path: Path, results: Sequence[CaseResult]) -> None:
    """Draw each case with its verdict.

    Args:
        path: PNG file.
        results: in order.
    """
    rows = max(1, math.ceil(len(results) / COLUMNS))
    figure = Figure(figsize=(4.2 * COLUMNS, 3.5 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
    for axes, result in zip(grid, results, strict=False):
        held = sum(check.holds for check in result.checks)
        colour = GOOD if held == len(result.checks) else BAD
        axes.tick_params(labelsize=7)
        result.draw(axes)
        axes.set_title(f"{result.name}: {held} of {len(result.checks)}", color=colour, fontsize=10)
        axes.xaxis.label.set_fontsize(8)
        axes.yaxis.label.set_fontsize(8)
    for axes in grid[len(results) :]:
        axes.set_axis_off()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=80)
