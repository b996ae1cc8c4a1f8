"""The map as a picture: top, side and front view, coloured by height.

matplotlib belongs to the extra `topside`; it is imported only when a picture is drawn.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from mapperd.mapping.queries import VoxelCloud
from mapperd.mapping.sonar_map import Voxels

__all__ = ["MAX_PIXELS", "MapProjection", "can_draw", "project", "write_picture"]

Floats = NDArray[np.float64]

MAX_PIXELS = 1500
"""Along one side of a view; a longer map gets several voxels to the pixel."""


@dataclass(frozen=True, slots=True, eq=False)
class MapProjection:
    """A map seen along one axis.

    Attributes:
        height_m: (rows, columns) float64, NaN where no voxel is; the highest voxel of each pixel.
        extent_m: left, right, bottom, top of the grid in the map frame.
    """

    height_m: NDArray[np.float64]
    extent_m: tuple[float, float, float, float]


def project(
    voxels: VoxelCloud, resolution_m: float, planes: Sequence[tuple[int, int]]
) -> list[MapProjection]:
    """Project voxels so that each is drawn as a square of its true size.

    Args:
        voxels: at least 1; they are read once.
        resolution_m: voxel edge.
        planes: for each view the axes (0, 1, 2) that run to the right and upwards.
    """
    pixels = [_HeightPixels(voxels.box_m[:, plane], resolution_m, plane) for plane in planes]
    for some in voxels.batches():
        for one in pixels:
            one.add(some)
    return [one.view() for one in pixels]


class _HeightPixels:
    """Pixels of one view.

    Args:
        box_m: (2, 2) lowest and highest centre, along the axes of the plane.
        resolution_m: voxel edge.
        plane: axes that run to the right and upwards.
    """

    def __init__(self, box_m: Floats, resolution_m: float, plane: tuple[int, int]) -> None:
        self._low_m = box_m[0] - resolution_m / 2
        self._resolution_m = resolution_m
        self._plane = list(plane)
        most = self._cells(box_m[1])
        self._scale = 1 + most // MAX_PIXELS  # each axis alone: a long map may be thin
        width, height = (most // self._scale + 1).tolist()
        self._grid = np.full((height, width), -np.inf)

    def add(self, voxels: Voxels) -> None:
        """Add voxels."""
        cells = self._cells(voxels.centres_m[:, self._plane])
        columns, rows = (cells // self._scale).T
        np.maximum.at(self._grid, (rows, columns), voxels.centres_m[:, 2])

    def view(self) -> MapProjection:
        """Return the view of all voxels."""
        height, width = self._grid.shape
        left, bottom = (float(edge) for edge in self._low_m)
        pixel_m = self._scale * self._resolution_m
        right, top = left + width * float(pixel_m[0]), bottom + height * float(pixel_m[1])
        grid = np.where(np.isneginf(self._grid), np.nan, self._grid)
        return MapProjection(grid, (left, right, bottom, top))

    def _cells(self, places_m: Floats) -> NDArray[np.int64]:
        cells = np.floor((places_m - self._low_m) / self._resolution_m)
        return np.asarray(cells, dtype=np.int64)


PAPER, INK, WATER = "#ffffff", "#1b2733", "#eef2f5"
SIZE_IN, DPI = (15.0, 11.0), 110
COLOURS = "viridis"
MARGIN = 0.03
"""Share of a side left empty around a map, so that no voxel sticks to the frame."""
FLATTEST = 1 / 8
"""A flatter side view is stretched vertically, with a note."""


def can_draw() -> bool:
    """Return whether matplotlib can be imported."""
    try:
        import matplotlib.backends.backend_agg  # noqa: F401, PLC0415 an extra
    except Exception:  # noqa: BLE001 an installation can be broken in any way
        return False
    return True


def write_picture(file: BinaryIO, voxels: VoxelCloud, resolution_m: float, title: str) -> None:
    """Draw the occupied voxels as a PNG.

    Args:
        file: where to.
        voxels: occupied voxels, perhaps none.
        resolution_m: voxel edge.
        title: a line over the picture.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415 an extra
    from matplotlib.figure import Figure  # noqa: PLC0415

    figure = Figure(figsize=SIZE_IN, dpi=DPI, facecolor=PAPER)
    FigureCanvasAgg(figure)
    figure.suptitle(title, color=INK, fontsize=13, x=0.06, ha="left")
    if len(voxels):
        _draw_views(figure, voxels, resolution_m)
    else:
        figure.text(0.5, 0.5, "no occupied voxels", ha="center", color=INK, fontsize=16)
    figure.savefig(file, format="png")


def _draw_views(figure: Any, voxels: VoxelCloud, resolution_m: float) -> None:  # noqa: ANN401 untyped
    low, high = voxels.box_m
    east, north, up = (float(edge) for edge in high - low + resolution_m)
    grid = figure.add_gridspec(
        2,
        3,
        width_ratios=[1, float(np.clip(north / east, 0.4, 1.5)), 0.025],
        height_ratios=[1, float(np.clip(up / north, 0.35, 1.5))],
        left=0.06,
        right=0.94,
        top=0.9,
        bottom=0.07,
        hspace=0.22,
        wspace=0.16,
    )
    heights = (float(low[2]) - resolution_m / 2, float(high[2]) + resolution_m / 2)
    views = (
        (grid[0, :2], "top view, from above", 0, 1),
        (grid[1, 0], "side view, looking north", 0, 2),
        (grid[1, 1], "front view, looking west", 1, 2),
    )
    planes = [(across, upwards) for _, _, across, upwards in views]
    projected = project(voxels, resolution_m, planes)
    for (place, label, across, upwards), view in zip(views, projected, strict=True):
        axes = figure.add_subplot(place, facecolor=WATER)
        image = _draw_view(axes, view, (across, upwards), heights)
        stretch = _stretch(axes)
        axes.set_aspect(stretch)
        stretched = f"; {'xyz'[upwards]} drawn times {stretch:g}" if stretch > 1 else ""
        axes.set_title(label + stretched, color=INK, fontsize=11, loc="left")
        _draw_scale(axes)
    bar = figure.colorbar(image, cax=figure.add_subplot(grid[:, 2]))
    bar.set_label("height z [m]", color=INK)


def _draw_view(
    axes: Any,  # noqa: ANN401 matplotlib has no types
    view: MapProjection,
    plane: tuple[int, int],
    heights_m: tuple[float, float],
) -> Any:  # noqa: ANN401
    """Draw the voxels as true-size squares; returns the image for the colour bar."""
    names = ("x east [m]", "y north [m]", "z up [m]")
    image = axes.imshow(
        view.height_m,
        origin="lower",
        extent=view.extent_m,
        interpolation="nearest",
        interpolation_stage="data",  # else 100 bytes for each pixel
        cmap=COLOURS,
        vmin=heights_m[0],
        vmax=heights_m[1],
    )
    left, right, bottom, top = view.extent_m
    axes.set_xlim(left - MARGIN * (right - left), right + MARGIN * (right - left))
    axes.set_ylim(bottom - MARGIN * (top - bottom), top + MARGIN * (top - bottom))
    axes.set_xlabel(names[plane[0]], color=INK)
    axes.set_ylabel(names[plane[1]], color=INK)
    axes.ticklabel_format(useOffset=False, style="plain")
    axes.grid(visible=True, color=INK, alpha=0.12, linewidth=0.6)
    return image


def _stretch(axes: Any) -> float:  # noqa: ANN401
    """1, or the first of 2, 5, 10, ... that keeps a flat view readable."""
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    flatness = (top - bottom) / (right - left)
    return 1.0 if flatness >= FLATTEST else _round_up(FLATTEST / flatness)


def _draw_scale(axes: Any) -> None:  # noqa: ANN401
    """A bar of a round length, a fifth of the view or so, in the lower left corner."""
    from matplotlib.patheffects import withStroke  # noqa: PLC0415 an extra
    from matplotlib.transforms import ScaledTranslation  # noqa: PLC0415

    left, right = axes.get_xlim()
    length_m = _round_up((right - left) / 8)
    start_m = left + 0.02 * (right - left)
    halo = [withStroke(linewidth=3, foreground=PAPER)]
    dots = axes.figure.dpi_scale_trans
    for height_pt, draw in ((7, "bar"), (11, "text")):
        place = axes.get_xaxis_transform() + ScaledTranslation(0, height_pt / 72, dots)
        style = {"transform": place, "color": INK, "path_effects": halo}
        if draw == "bar":
            axes.plot([start_m, start_m + length_m], [0, 0], linewidth=3, **style)
        else:
            axes.text(start_m, 0, f"{length_m:g} m", fontsize=9, **style)


def _round_up(value: float) -> float:
    """The first of ..., 1, 2, 5, 10, ... that is not below the value."""
    decade = 10.0 ** math.floor(math.log10(value))
    return next(step * decade for step in (1, 2, 5, 10) if step * decade >= value * (1 - 1e-9))
