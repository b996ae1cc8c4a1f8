"""All validation cases, in the order of their numbers, and the page of their pictures."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from types import MappingProxyType

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from sonar_sim.validation.case import ValidationResult
from sonar_sim.validation.propagation import (
    v01_absorption,
    v02_range_slopes,
    v10_mirror_ghosts,
    v11_shadow,
    v17_no_wrap,
)
from sonar_sim.validation.receiver import v06_beam_pattern, v13_bearings, v14_quantiser
from sonar_sim.validation.repeatability import v18_classic, v19_determinism
from sonar_sim.validation.scattering import v03_lambert_floor, v04_spheres, v05_plate, v12_elevation
from sonar_sim.validation.speckle import v07_speckle, v08_ping_correlation, v09_range_lines
from sonar_sim.validation.tank import v20_tank
from sonar_sim.validation.thin import v21_thin_objects
from sonar_sim.validation.timing import v15_timing, v16_motion

CASES: MappingProxyType[str, Callable[[], ValidationResult]] = MappingProxyType(
    {
        "V1": v01_absorption,
        "V2": v02_range_slopes,
        "V3": v03_lambert_floor,
        "V4": v04_spheres,
        "V5": v05_plate,
        "V6": v06_beam_pattern,
        "V7": v07_speckle,
        "V8": v08_ping_correlation,
        "V9": v09_range_lines,
        "V10": v10_mirror_ghosts,
        "V11": v11_shadow,
        "V12": v12_elevation,
        "V13": v13_bearings,
        "V14": v14_quantiser,
        "V15": v15_timing,
        "V16": v16_motion,
        "V17": v17_no_wrap,
        "V18": v18_classic,
        "V19": v19_determinism,
        "V20": v20_tank,
        "V21": v21_thin_objects,
    }
)


COLUMNS = 4
GOOD, BAD = "#1b7f3b", "#b3261e"


def draw_page(path: Path, results: Sequence[ValidationResult]) -> None:
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
