"""What all plots of a study share: axes, marks, labels apart from each other, small files."""

import io
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator
from matplotlib.transforms import Bbox
from PIL import Image

from studies.accuracy_cost.front import Point, front

__all__ = [
    "DEFAULT_STYLE",
    "PUBLISHED_STYLE",
    "draw_front",
    "label_points",
    "lay_out",
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
LEAST_ROOM = 0.2
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
            least = LEAST_ROOM * abs(high) if name == "x" else 0.0
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
