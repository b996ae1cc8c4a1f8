"""The report's pictures: what is covered, how often, and where and how far dives disagree."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapper_survey.coverage import Pictures
from mapper_survey.difference import Way
from mapper_survey.raster import Raster
from mapper_survey.report_record import Report
from mapperd.errors import ExportError
from mapperd.export.picture import can_draw
from mapperd.io import atomic_file

__all__ = ["COVERAGE", "DISAGREEMENT", "DISTANCES", "MISSING", "OVERLAP", "draw_pictures"]

COVERAGE, OVERLAP = "coverage.png", "overlap.png"
DISAGREEMENT, DISTANCES = "disagreement.png", "distances.png"

MISSING = "no pictures: matplotlib cannot be imported (pip install 'mapperd[survey]')"

DPI = 110
PAPER, INK, LOOKED = "#ffffff", "#1b2733", "#d9e0e6"
MOST_LINES = 6
"""Pairs that are drawn for themselves; of more, the worst."""

Floats = NDArray[np.float64]


def draw_pictures(
    out_dir: Path,
    report: Report,
    pictures: Pictures,
    raster: Raster,
    ways: Mapping[tuple[str, str], Way],
) -> None:
    """Write all four PNGs.

    Raises:
        ExportError: matplotlib is not there, or a file cannot be written.
    """
    if not can_draw():
        raise ExportError(MISSING)
    for name, figure in (
        (COVERAGE, _coverage(report, pictures, raster)),
        (OVERLAP, _overlap(report, pictures, raster)),
        (DISAGREEMENT, _disagreement(report, pictures, raster)),
        (DISTANCES, _distances(report, ways)),
    ):
        with atomic_file(out_dir / name) as file:
            figure.savefig(file, format="png", dpi=DPI)


def _coverage(report: Report, pictures: Pictures, raster: Raster) -> Any:  # noqa: ANN401 untyped
    covered = report.coverage
    figure, (axes,) = _maps(
        f"{covered.merged_m2:,.0f} m² mapped by {len(report.dives)} dives; "
        "grey: looked at, no surface",
        pictures,
        raster,
    )
    _put(axes, np.where(pictures.observed > 0, 0.0, np.nan), pictures, raster, cmap=_plain(LOOKED))
    heights = np.where(np.isfinite(pictures.z_m), pictures.z_m, np.nan)
    known = heights[np.isfinite(heights)]
    low, high = (
        np.percentile(known, [1, 99]) if len(known) else (0.0, 1.0)
    )  # relief, not what sticks up
    image = _put(axes, heights, pictures, raster, cmap="viridis", vmin=low, vmax=high)
    bar = {"ax": axes, "label": "highest surface z [m]", "shrink": 0.8, "extend": "both"}
    figure.colorbar(image, **bar)
    return figure


def _overlap(report: Report, pictures: Pictures, raster: Raster) -> Any:  # noqa: ANN401
    covered = report.coverage
    share = covered.overlap_m2 / covered.mapped_m2
    figure, (axes,) = _maps(
        f"{covered.overlap_m2:,.0f} m² seen by two or more dives, {share:.0%} of what is mapped",
        pictures,
        raster,
    )
    most = max(int(dives) for dives in covered.by_dives_m2)
    from matplotlib import colormaps  # noqa: PLC0415 an extra
    from matplotlib.colors import BoundaryNorm  # noqa: PLC0415

    colours = colormaps["plasma"].resampled(max(most, 2))
    norm = BoundaryNorm(np.arange(0.5, max(most, 2) + 1), colours.N)
    dives = np.where(pictures.dives > 0, pictures.dives, np.nan)
    image = _put(axes, dives, pictures, raster, cmap=colours, norm=norm)
    ticks = np.unique(np.linspace(1, max(most, 2), min(max(most, 2), 10)).astype(int))
    figure.colorbar(image, ax=axes, label="dives with a surface", shrink=0.8, ticks=ticks)
    return figure


def _disagreement(report: Report, pictures: Pictures, raster: Raster) -> Any:  # noqa: ANN401
    figure, (left, right) = _maps(
        f"disagreement where several dives looked; tolerance {report.tolerance_m:g} m",
        pictures,
        raster,
        number=2,
    )
    spread = np.where(np.isfinite(pictures.spread_m), pictures.spread_m, np.nan)
    high = max(5 * report.tolerance_m, report.resolution_m)
    image = _put(left, spread, pictures, raster, cmap="magma_r", vmin=0.0, vmax=high)
    left.set_title("highest less lowest surface, the most in a pixel", fontsize=10, loc="left")
    bar = {"ax": left, "label": "spread [m]", "shrink": 0.8, "extend": "max"}
    figure.colorbar(image, **bar)
    with np.errstate(invalid="ignore"):
        missing = pictures.missing / np.where(pictures.compared > 0, pictures.compared, np.nan)
    image = _put(right, missing, pictures, raster, cmap="magma_r", vmin=0.0, vmax=1.0)
    right.set_title("voxels that the other dive has not", fontsize=10, loc="left")
    figure.colorbar(image, ax=right, label="share", shrink=0.8)
    return figure


def _distances(report: Report, ways: Mapping[tuple[str, str], Way]) -> Any:  # noqa: ANN401
    figure = _figure(10.0, 5.0)
    figure.suptitle("from each dive's voxels to the nearest of the other", color=INK, fontsize=12)
    axes = figure.subplots()
    pairs = [pair for pair in report.pairs if pair.a_to_b.compared or pair.b_to_a.compared]
    pairs.sort(key=lambda pair: pair.mean_missing_share or 0.0, reverse=True)
    for number, pair in enumerate(pairs[:MOST_LINES]):
        for (a, b), style in (((pair.a, pair.b), "-"), ((pair.b, pair.a), "--")):
            way = ways[a, b]
            if way.compared:
                steps = np.array(list(way.squares), dtype=np.float64)
                x_m, y = np.sqrt(steps[:, 0]) * report.resolution_m, np.cumsum(steps[:, 1])
                label = f"{a} to {b}: {way.common / way.compared:.1%}"
                axes.step(x_m, y / y[-1], style, where="post", color=f"C{number}", label=label)
    axes.axvline(report.tolerance_m, color=INK, linewidth=1, linestyle=":")
    axes.set(xlim=(0, report.reach_m), ylim=(0, 1.02), xlabel="distance [m]")
    axes.set_ylabel("share of compared voxels within it")
    axes.grid(alpha=0.25)
    if pairs:
        chosen = f"; the worst {MOST_LINES} of {len(pairs)} pairs"
        title = f"within {report.tolerance_m:g} m" + chosen * (len(pairs) > MOST_LINES)
        axes.legend(title=title, fontsize=8, loc="lower right")
    else:
        axes.text(0.5, 0.5, "no two dives looked at the same place", ha="center", color=INK)
    return figure


def _maps(
    title: str, pictures: Pictures, raster: Raster, *, number: int = 1
) -> tuple[Any, list[Any]]:
    """A figure with some maps beside each other, or above where they are wide."""
    left, right, bottom, top = _shown(pictures, raster)
    ratio = float(np.clip((top - bottom) / (right - left), 0.3, 1.6))
    wide = ratio < 1
    width, height = 9.0, 6.9 * ratio + 1.2  # the rest is the scale's, and the title's
    size = (width, height * number) if wide else (width * number, height)
    figure = _figure(*size)
    figure.suptitle(title, color=INK, fontsize=12)
    grid = figure.subplots(number, 1) if wide else figure.subplots(1, number)
    maps = list(np.atleast_1d(grid))
    for axes in maps:
        axes.set(xlabel="x east [m]", ylabel="y north [m]", facecolor=PAPER, aspect="equal")
    return figure, maps


def _shown(pictures: Pictures, raster: Raster) -> tuple[float, float, float, float]:
    return raster.shown_m((pictures.observed > 0) | (pictures.dives > 0))


def _figure(width_in: float, height_in: float) -> Any:  # noqa: ANN401
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415 an extra
    from matplotlib.figure import Figure  # noqa: PLC0415

    figure = Figure(figsize=(width_in, height_in), facecolor=PAPER, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _put(axes: Any, picture: Floats, pictures: Pictures, raster: Raster, **how: Any) -> Any:  # noqa: ANN401
    shown = _shown(pictures, raster)
    left, right, bottom, top = raster.extent_m
    image = axes.imshow(picture, extent=(left, right, bottom, top), interpolation="nearest", **how)
    axes.set(xlim=shown[:2], ylim=shown[2:])
    return image


def _plain(colour: str) -> Any:  # noqa: ANN401
    from matplotlib.colors import ListedColormap  # noqa: PLC0415 an extra

    return ListedColormap([colour])
