"""The plots of a study: one a knob, and one of everything that was measured."""

import io
import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator
from matplotlib.transforms import Bbox
from numpy.typing import NDArray
from PIL import Image

from studies.accuracy_cost.front import Plane, Point, front, mean_point, plane_of, point_on
from studies.accuracy_cost.results import StudyResults, key_of
from studies.accuracy_cost.study import DEFAULT, Column, Knob, Selection, Setting, Study

__all__ = [
    "BIN",
    "DEFAULT_STYLE",
    "PUBLISHED_STYLE",
    "bins_of",
    "draw_front",
    "draw_knob",
    "draw_reliability",
    "draw_summary",
    "has_bins",
    "label_points",
    "lay_out",
    "measured_knob",
    "new_figure",
    "panel_size",
    "panels",
    "save",
    "scale",
]


DEFAULT_STYLE: dict[str, Any] = {"marker": "*", "markersize": 15, "color": "#d62728"}
PUBLISHED_STYLE: dict[str, Any] = {"marker": "s", "markersize": 8, "color": "#7b3294"}
DPI = 90
LOG_FROM = 4.0
"""Axes that span more than this ratio are logarithmic."""
MIN_ROOM = 0.2
"""Beside the costs: the noise of equal ones must not fill the plot."""
STEPS, WIDE = (1.0, 2.0, 5.0), 100.0
"""Ticks of a logarithmic axis, but for one that spans more than this ratio."""
PLACES = ((7, 4), (7, -11), (-7, 4), (-7, -11), (0, 9), (0, -16), (14, 12), (14, -20), (-14, 12))
"""Where a label may stand beside its point, in points; the first that is free."""


def new_figure(width: float, height: float) -> Figure:
    """A figure that is drawn without a display."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def panel_size(number: int) -> tuple[float, float]:
    """Width and height in inches of a figure of some panels."""
    return {1: (6.5, 4.6), 2: (10.0, 4.4), 3: (13.0, 4.2), 4: (10.5, 8.0)}.get(number, (13.0, 8.0))


def panels(figure: Figure, number: int) -> list[Axes]:
    """A panel for each of some titles, at most three in a row."""
    columns = min(number, 3) if number != 4 else 2  # noqa: PLR2004 four look best two by two
    rows = math.ceil(number / columns)
    grid = list(figure.subplots(rows, columns, squeeze=False).flat)
    for axes in grid[number:]:
        axes.remove()
    for axes in grid[:number]:
        axes.grid(alpha=0.25, which="both")
        axes.spines[["top", "right"]].set_visible(False)
    return grid[:number]


def scale(axes: Axes, points: Iterable[Point]) -> None:
    """Choose logarithmic or plain axes, with room for the labels."""
    known = [point for point in points if point.known]
    for name, values in (
        ("x", [point.cost for point in known]),
        ("y", [point.error for point in known]),
    ):
        if not values:
            continue
        low, high = min(values), max(values)
        if low > 0 and high / low > LOG_FROM:
            getattr(axes, f"set_{name}scale")("log")
            axis = getattr(axes, f"{name}axis")
            axis.set_major_locator(LogLocator(subs=STEPS if high / low < WIDE else (1.0,)))
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter("")
            room = (high / low) ** 0.12
            getattr(axes, f"set_{name}lim")(low / room, high * room)
        else:
            least = MIN_ROOM * abs(high) if name == "x" else 0.0
            room = max(0.15 * (high - low), least) or 0.1 * abs(high) or 1.0
            getattr(axes, f"set_{name}lim")(low - room, high + room)


def draw_front(axes: Axes, points: Iterable[Point]) -> None:
    """Draw the front as steps: what is above them is beaten."""
    best = front(points)
    right, top = axes.get_xlim()[1], axes.get_ylim()[1]
    if best:
        x = [best[0].cost, *(point.cost for point in best), right]
        y = [top, *(point.error for point in best), best[-1].error]
        axes.plot(x, y, drawstyle="steps-post", color="#2ca02c", lw=1.2, zorder=1)


def lay_out(figure: Figure) -> None:
    """Give the panels their places, for good."""
    figure.draw_without_rendering()
    figure.set_layout_engine("none")


def label_points(
    axes: Axes, labelled: Sequence[tuple[Point, str]], points: Iterable[Point]
) -> None:
    """Write labels where they lie on no other and on none of the points drawn.

    The figure is laid out before.
    """
    pixels = axes.get_figure(root=True).dpi / 72.0  # type: ignore[union-attr]
    frame = axes.get_window_extent()
    places = axes.transData.transform([(point.cost, point.error) for point, _ in labelled])
    drawn = axes.transData.transform([(point.cost, point.error) for point in points])
    taken = [Bbox.from_bounds(x - 7, y - 7, 14, 14) for x, y in drawn]
    for (point, text), (x, y) in zip(labelled, places, strict=True):
        note = axes.annotate(
            text,
            (point.cost, point.error),
            (0, 0),
            textcoords="offset points",
            fontsize=8,
            zorder=5,
        )
        size = note.get_window_extent()
        boxes = {
            (dx, dy): _beside(x + dx * pixels, y + dy * pixels, size.width, size.height, dx)
            for dx, dy in PLACES
        }
        best = min(PLACES, key=lambda place: _crowding(boxes[place], frame, taken))
        note.xyann = best
        note.set_horizontalalignment(_side(best[0]))
        taken.append(boxes[best])


def _side(dx: int) -> Literal["left", "center", "right"]:
    return "left" if dx > 0 else "right" if dx < 0 else "center"


def _beside(x: float, y: float, width: float, height: float, dx: int) -> Bbox:
    """Where a text of a size lies that begins, ends or is centred at x."""
    left = {"left": x, "center": x - width / 2, "right": x - width}[_side(dx)]
    return Bbox.from_bounds(left, y, width, height)


def _crowding(box: Bbox, frame: Bbox, taken: Sequence[Bbox]) -> float:
    """How much of a text is covered, or outside; the latter is worse."""
    outside = box.width * box.height - _overlap(box, frame)
    return 10.0 * float(outside) + sum(_overlap(box, other) for other in taken)


def _overlap(a: Bbox, b: Bbox) -> float:
    shared = Bbox.intersection(a, b)
    return float(shared.width * shared.height) if shared is not None else 0.0


def save(figure: Figure, path: Path) -> None:
    """Write a picture with a palette: it stays in the repository for good."""
    data = io.BytesIO()
    figure.savefig(data, dpi=DPI, format="png")
    path.parent.mkdir(parents=True, exist_ok=True)
    with Image.open(data) as image:
        few = image.convert("RGB").quantize(256, method=Image.Quantize.MAXCOVERAGE)
        few.save(path, optimize=True)


PUBLISHED = "published"
"""Label of the whole configuration that the published system has."""
WHOLE_MARKS = ("D", "^", "v", "P", "X", "o")
LABELLED_ON_FRONT = 7
AXIS_WIDTH = 45
"""Characters of an axis title's line."""


def measured_knob(results: StudyResults, knob: Knob) -> bool:
    """Whether any setting of a knob but the default is in the results."""
    measured = {key.setting for key in results.rows}
    return any(setting.key in measured for setting in knob.settings if setting.overrides)


def draw_knob(study: Study, results: StudyResults, knob: Knob, path: Path) -> None:
    """Draw error against cost of a knob's settings: a panel a dive, and the mean over them."""
    plane = plane_of(study, knob)
    groups = _groups(study, results, knob.settings, plane)
    figure = new_figure(*panel_size(len(groups)))
    for axes, (title, points) in zip(panels(figure, len(groups)), groups, strict=True):
        scale(axes, points)
        draw_front(axes, points)
        known = [point for point in points if point.known]
        axes.plot(
            [point.cost for point in known], [point.error for point in known],
            ":", color="0.6", lw=0.8, zorder=0,
        )  # fmt: skip
        for point in known:
            _mark(axes, point, published=point.setting.label == knob.published)
        _name_axes(axes, study, plane, title)
    figure.suptitle(_title(knob, width=60 * min(len(groups), 2)), fontsize=12)
    lay_out(figure)
    for axes, (_, points) in zip(figure.axes, groups, strict=True):
        known = [point for point in points if point.known]
        label_points(axes, [(point, _label(point, knob)) for point in known], known)
    save(figure, path)


def draw_summary(study: Study, results: StudyResults, path: Path) -> None:
    """Draw all that was measured: every knob, the front over all, the whole configurations."""
    settings = Selection().settings_of(study)
    plane = plane_of(study)
    groups = _groups(study, results, settings, plane)
    figure = new_figure(*panel_size(len(groups)))
    wholes = {whole.key: whole for whole in study.wholes}
    for axes, (title, points) in zip(panels(figure, len(groups)), groups, strict=True):
        scale(axes, points)
        draw_front(axes, points)
        _draw_all(axes, [point for point in points if point.known], wholes)
        _name_axes(axes, study, plane, title)
    figure.suptitle(f"All settings of the study of {study.name}", fontsize=12)
    lay_out(figure)
    for axes, (_, points) in zip(figure.axes, groups, strict=True):
        label_points(axes, _named(study, points, wholes), [p for p in points if p.known])
    save(figure, path)


def _named(
    study: Study, points: Sequence[Point], wholes: Mapping[str, Setting]
) -> list[tuple[Point, str]]:
    """Points with labels: the default, whole configurations, and some along the front."""
    best = front(points)
    every_nth = max(1, -(-len(best) // LABELLED_ON_FRONT))
    named = {point.setting.key: point for point in best[::every_nth]}
    named |= {p.setting.key: p for p in points if p.known and p.setting.key in {"", *wholes}}
    return [(point, _whole_label(study, key, wholes)) for key, point in named.items()]


def _draw_all(axes: Axes, points: Sequence[Point], wholes: Mapping[str, Setting]) -> None:
    marks = dict(zip(wholes, WHOLE_MARKS, strict=False))
    for point in points:
        key = point.setting.key
        if key in marks and key:
            published = wholes[key].label.startswith(PUBLISHED)
            style = PUBLISHED_STYLE if published else {"marker": marks[key], "color": "#1f77b4"}
            axes.plot(point.cost, point.error, zorder=4, **style)
        elif key:
            axes.plot(point.cost, point.error, "o", color="0.65", markersize=4, zorder=2)
        else:
            axes.plot(point.cost, point.error, zorder=4, **DEFAULT_STYLE)


def _groups(
    study: Study, results: StudyResults, settings: Sequence[Setting], plane: Plane
) -> list[tuple[str, list[Point]]]:
    """Titles of panels and what is in them."""
    groups = [
        (dive.name, [point_on(plane, results, setting, dive) for setting in settings])
        for dive in study.dives
    ]
    if len(groups) > 1:
        means = [mean_point(plane, results, setting, study.dives) for setting in settings]
        groups.append(("mean", means))
    return [(title, points) for title, points in groups if any(point.known for point in points)]


def _mark(axes: Axes, point: Point, *, published: bool) -> None:
    if published:
        style = PUBLISHED_STYLE | {"markersize": 13, "fillstyle": "none", "markeredgewidth": 1.5}
        axes.plot(point.cost, point.error, zorder=3, linestyle="none", **style)
    if point.setting.overrides:
        axes.plot(point.cost, point.error, "o", color="#1f77b4", markersize=6, zorder=4)
    else:
        axes.plot(point.cost, point.error, zorder=4, **DEFAULT_STYLE)


def _label(point: Point, knob: Knob) -> str:
    names = [] if point.setting.overrides else ["default"]
    names += ["published"] if point.setting.label == knob.published else []
    return f"{point.setting.label} ({', '.join(names)})" if names else point.setting.label


def _whole_label(study: Study, key: str, wholes: Mapping[str, Setting]) -> str:
    """Label a setting with its knob too, where all knobs are in one plot."""
    if not key:
        return DEFAULT.label
    if key in wholes:
        return wholes[key].label
    return next(
        f"{knob.name}: {setting.label}"
        for knob in study.knobs
        for setting in knob.settings
        if setting.key == key
    )


def _title(knob: Knob, width: int) -> str:
    marks = "star: default" + (", square: published" if knob.published else "")
    return textwrap.fill(f"{knob.title} ({marks}; line: front)", width)


def _name_axes(axes: Axes, study: Study, plane: Plane, title: str) -> None:
    columns: dict[str, Column] = {column.name: column for column in study.columns}
    axes.set_xlabel(textwrap.fill(columns[plane.cost].title, AXIS_WIDTH))
    axes.set_ylabel(textwrap.fill(columns[plane.error].title, AXIS_WIDTH))
    axes.set_title(title, fontsize=10)


BIN, BINS = "bin", 10
"""How the columns of a bin begin, such as `bin0_voxels`."""
MIN_VOXELS = 100
"""Bins of fewer voxels are not drawn."""
PROMISED = 0.1
COLOURS = ("#d62728", "#7b3294", "#e08214", "#1f77b4", "#2ca02c", "#666666")


def has_bins(results: StudyResults) -> bool:
    """Whether a study counts the voxels of each probability."""
    return f"{BIN}0_voxels" in results.columns


def bins_of(figures: dict[str, float]) -> NDArray[np.float64]:
    """Rows (N, 3) of the filled bins: mean probability, occupied share, voxels."""
    rows = np.array(
        [[figures[f"{BIN}{i}_{name}"] for name in ("said", "solid", "voxels")] for i in range(BINS)]
    )
    return rows[rows[:, 2] >= MIN_VOXELS]


def draw_reliability(study: Study, results: StudyResults, path: Path) -> None:
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
    """A line, and points whose area grows with the number of voxels."""
    probability, solid, voxels = bins.T
    axes.plot(probability, solid, color=colour, lw=1.2, label=setting.label, zorder=2)
    axes.scatter(
        probability, solid, s=6.0 * np.log10(np.maximum(voxels, 1.0)) ** 2, color=colour, zorder=3
    )
