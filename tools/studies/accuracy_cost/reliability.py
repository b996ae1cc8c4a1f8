"""Reliability diagrams: of the voxels that are said to be occupied with p, how many are."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from studies.accuracy_cost.picture import lay_out, new_figure, panel_size, panels, save
from studies.accuracy_cost.results import Results, key_of
from studies.accuracy_cost.studies import DEFAULT
from studies.accuracy_cost.study import Setting, Study

__all__ = ["BIN", "bins_of", "draw_reliability", "has_bins"]

BIN, BINS = "bin", 10
"""How the columns of a bin begin, such as `bin0_voxels`."""
LEAST_VOXELS = 100
"""A bin of fewer says nothing of its share."""
PROMISED = 0.1
COLOURS = ("#d62728", "#7b3294", "#e08214", "#1f77b4", "#2ca02c", "#666666")


def has_bins(results: Results) -> bool:
    """Whether a study tells how many voxels there are of each probability."""
    return f"{BIN}0_voxels" in results.columns


def bins_of(figures: dict[str, float]) -> NDArray[np.float64]:
    """Rows (N, 3) of the filled bins: probability that is said, occupied share, voxels."""
    rows = np.array(
        [[figures[f"{BIN}{i}_{name}"] for name in ("said", "solid", "voxels")] for i in range(BINS)]
    )
    return rows[rows[:, 2] >= LEAST_VOXELS]


def draw_reliability(study: Study, results: Results, path: Path) -> None:
    """Draw a panel a dive with the default and the whole configurations."""
    figure = new_figure(*panel_size(len(study.dives)))
    for axes, dive in zip(panels(figure, len(study.dives)), study.dives, strict=True):
        axes.fill_between([0, 1], [-PROMISED, 1 - PROMISED], [PROMISED, 1 + PROMISED],
                          color="0.9", zorder=0)  # fmt: skip
        axes.plot([0, 1], [0, 1], color="0.6", lw=0.8, zorder=1)
        for setting, colour in zip((DEFAULT, *study.wholes), COLOURS, strict=False):
            figures = results.rows.get(key_of(setting, dive))
            if figures is not None:
                _draw(axes, bins_of(figures), setting, colour)
        axes.set(xlim=(0, 1), ylim=(0, 1), title=dive.name)
        axes.set_xlabel("probability in the map")
        axes.set_ylabel("share that is occupied")
    figure.axes[0].legend(loc="upper left", fontsize=8)
    figure.suptitle("What the map's probabilities are worth  (grey: within 0.1)", fontsize=12)
    lay_out(figure)
    save(figure, path)


def _draw(axes: Axes, bins: NDArray[np.float64], setting: Setting, colour: str) -> None:
    """A line, and points of an area that tells the number of voxels."""
    said, solid, voxels = bins.T
    axes.plot(said, solid, color=colour, lw=1.2, label=setting.label, zorder=2)
    axes.scatter(
        said, solid, s=6.0 * np.log10(np.maximum(voxels, 1.0)) ** 2, color=colour, zorder=3
    )
