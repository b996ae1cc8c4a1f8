"""The picture of all scenes: each one's truth, a ping of it, and its map coloured by its error."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from demo.picture import INK, WATER, draw_fan
from demo.ply_points import VoxelCloud
from demo.render import Camera, cubes, render
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from oculus_driver.ping import Ping

PIXELS = (560, 400)
FIELD_OF_VIEW_DEG = 40.0
VIEWS_DEG = {"ship_hull": (-65.0, -28.0), "tank": (-100.0, 62.0), "open_water": (-150.0, 10.0)}
"""Azimuth and elevation of the eye about what was seen, where it is not the usual."""
USUAL_DEG = (-120.0, 32.0)
REACH = 0.62
"""Of the seen part's diagonal that has to fit beside its middle."""
WORST_M = 0.3
"""The error that is drawn reddest."""


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """What is drawn of one scene; the fields are those of `scene_maps.SceneMap`."""

    name: str
    truth_m: NDArray[np.float64]
    seen_m: NDArray[np.float64]
    voxels: VoxelCloud
    error_m: NDArray[np.float64]
    ping: Ping
    caption: str


def draw_panels(path: Path, panels: Sequence[Panel]) -> None:
    """Write the picture: one row a scene."""
    figure = Figure(figsize=(15.0, 3.9 * len(panels)), facecolor=WATER)
    FigureCanvasAgg(figure)
    rows = figure.subplots(len(panels), 3, squeeze=False)
    for (left, middle, right), panel in zip(rows, panels, strict=True):
        _draw_row(left, middle, right, panel)
    figure.subplots_adjust(
        left=0.005, right=0.995, top=1.0 - 0.3 / (3.9 * len(panels)), bottom=0.004, wspace=0.02
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=80)


def _draw_row(left: Axes, middle: Axes, right: Axes, panel: Panel) -> None:
    camera = _camera(panel)
    triangles_m = _facing_parts(panel)
    heights = _shades("viridis", triangles_m.mean(axis=1)[:, 2], panel.seen_m[:, 2])
    left.imshow(render(triangles_m, heights, camera, WATER))
    left.set_title(panel.name, color=INK)
    draw_fan(middle, panel.ping)
    share = np.clip(panel.error_m / WORST_M, 0.0, 1.0)
    colours = mpl.colormaps["RdYlGn_r"](np.repeat(share, 12))[:, :3]
    boxes = cubes(panel.voxels.centres_m, panel.voxels.edge_m)
    right.imshow(render(boxes, colours, camera, WATER))
    right.set_title(panel.caption, color=INK, fontsize=8)
    for axes in (left, middle, right):
        axes.set_axis_off()


def _shades(
    name: str, values: NDArray[np.float64], scale: NDArray[np.float64]
) -> NDArray[np.float64]:
    low, high = float(scale.min()), float(scale.max())
    share = np.clip((values - low) / max(high - low, 0.5), 0.0, 1.0)
    colours = mpl.colormaps[name](0.25 + 0.75 * share)
    return np.array(colours[:, :3], dtype=np.float64)


def _facing_parts(panel: Panel) -> NDArray[np.float64]:
    """The truth; where the eye is below, without what lies lower than what was seen of interest."""
    if VIEWS_DEG.get(panel.name, USUAL_DEG)[1] > 0.0:
        return panel.truth_m
    floor_m = panel.truth_m[..., 2].min() + 1.0
    above: NDArray[np.float64] = panel.truth_m[panel.truth_m[..., 2].max(axis=1) > floor_m]
    return above


def _camera(panel: Panel) -> Camera:
    low, high = np.percentile(panel.seen_m, [1.0, 99.0], axis=0)
    middle, reach_m = (low + high) / 2.0, REACH * float(np.linalg.norm(high - low))
    azimuth, elevation = np.radians(VIEWS_DEG.get(panel.name, USUAL_DEG))
    distance_m = reach_m / math.tan(math.radians(FIELD_OF_VIEW_DEG / 2.0))
    towards = np.array(
        [
            math.cos(elevation) * math.cos(azimuth),
            math.cos(elevation) * math.sin(azimuth),
            math.sin(elevation),
        ]
    )
    eye = middle + distance_m * towards
    width, height = PIXELS
    x, y, z = (float(part) for part in eye)
    to_x, to_y, to_z = (float(part) for part in middle)
    return Camera((x, y, z), (to_x, to_y, to_z), width, height, FIELD_OF_VIEW_DEG)
