"""The picture of two passes: both maps of the second one on the first one's, and the errors."""

from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from studies.localization.pass_maps import Course

mpl.use("Agg")
import matplotlib.pyplot as plt

__all__ = ["Panel", "draw"]

Floats = NDArray[np.float64]

MOST_M = 1.0
"""Of distances that colours tell apart."""


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """A second pass's map.

    Attributes:
        title: says how it was mapped, and how well it agrees.
        centres_m: (N, 3) of its voxels.
        distance_m: (N,) to the nearest of the first pass.
        said: (M, 2) where it thought it was.
    """

    title: str
    centres_m: Floats
    distance_m: Floats
    said: Floats


def draw(path: Path, first_m: Floats, panels: list[Panel], course: Course) -> None:
    """Two maps from above, each column of voxels in the colour of its middle one; errors below."""
    picture = plt.figure(figsize=(10, 11.5))
    rows = picture.add_gridspec(3, 2, height_ratios=(1.6, 1.6, 1.0), hspace=0.3)
    window_m = _window_m(first_m, course)
    for k, panel in enumerate(panels):
        axes = picture.add_subplot(rows[k, :])
        places, _ = _columns(first_m)
        axes.scatter(places[:, 0], places[:, 1], s=1.5, color="#c8c8c8", lw=0)
        places, middle = _columns(panel.centres_m, panel.distance_m)
        colours = axes.scatter(
            places[:, 0], places[:, 1], c=middle, s=1.5, cmap="turbo", vmin=0, vmax=MOST_M, lw=0
        )
        axes.plot(*course.true[:, :2].T, color="black", lw=1.0, label="true way")
        axes.plot(*panel.said.T, color="#d62728", lw=1.0, label="way as mapped")
        axes.set_title(panel.title, fontsize=9)
        axes.set(aspect="equal", xlim=window_m[:, 0], ylim=window_m[:, 1], ylabel="y, m")
        axes.legend(loc="lower right", fontsize=7)
        bar = picture.colorbar(colours, ax=axes, shrink=0.8, pad=0.02)
        bar.set_label("m to the first pass (grey)", fontsize=8)
    _draw_errors(picture.add_subplot(rows[2, 0]), course, "place")
    _draw_errors(picture.add_subplot(rows[2, 1]), course, "heading")
    picture.savefig(path, dpi=85, bbox_inches="tight")
    plt.close(picture)


def _window_m(first_m: Floats, course: Course) -> Floats:
    """(2, 2) corners around the ways and what stands beside them; single far voxels lie outside."""
    most = np.quantile(first_m[:, :2], (0.005, 0.98), axis=0)
    both = np.concatenate([most, course.true[:, :2], course.odometry[:, :2]])
    return np.stack([both.min(axis=0) - 1.0, both.max(axis=0) + 1.0])


def _draw_errors(axes: Axes, course: Course, what: str) -> None:
    since_s = course.time_s - course.time_s[0]
    for said, name, colour in (
        (course.odometry, "odometry", "#9a9a9a"),
        (course.said, "localization", "#1f77b4"),
    ):
        place = what == "place"
        errors = course.errors_m(said) if place else np.degrees(course.errors_rad(said))
        axes.plot(since_s, errors, color=colour, lw=0.9, label=name)
    axes.set_ylim(0.0, None)
    axes.set_ylabel("error of the place, m" if what == "place" else "error of the heading, deg")
    axes.set_xlabel("seconds of the second pass")
    axes.legend(fontsize=7)


def _columns(centres_m: Floats, value: Floats | None = None) -> tuple[Floats, Floats]:
    """(C, 2) places that have voxels, seen from above, and the median value of each (C,)."""
    value = np.zeros(len(centres_m)) if value is None else value
    order = np.lexsort((value, centres_m[:, 1], centres_m[:, 0]))
    places, first, count = np.unique(
        centres_m[order, :2], axis=0, return_index=True, return_counts=True
    )
    return places, value[order][first + count // 2]
