"""The demo's picture: the scene, one ping of it, and the map."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from demo.ply_points import VoxelCloud
from demo.render import Camera, cubes, render
from oculus_driver.ping import Ping, decode_ping
from oculus_driver.recording import OCULUS, open_recording
from oculus_driver.stream import StreamParser

CAMERA = Camera(
    eye_m=(-10.5, -14.5, 3.4),
    target_m=(0.1, 0.0, -4.4),
    width=1100,
    height=660,
    field_of_view_deg=50.0,
)
WATER = (0.055, 0.10, 0.15)
INK = "#dfe8ee"
HEIGHTS_M = (-6.8, -2.8)
FAN_PIXELS = 720


def draw_demo(
    path: Path, scene_m: NDArray[np.float64], voxels: VoxelCloud, ping: Ping, caption: str
) -> None:
    """Write the picture.

    Args:
        path: PNG file.
        scene_m: triangles of the true scene, (F, 3, 3).
        voxels: the map.
        ping: one of the survey.
        caption: what stands beneath.
    """
    figure = Figure(figsize=(16.0, 3.9), facecolor=WATER)
    FigureCanvasAgg(figure)
    left, middle, right = figure.subplots(1, 3, width_ratios=(1.0, 1.0, 1.0))
    left.imshow(_perspective(scene_m, scene_m.mean(axis=1)[:, 2]))
    left.set_title("the scene", color=INK)
    draw_fan(middle, ping)
    boxes = cubes(voxels.centres_m, voxels.edge_m)
    right.imshow(_perspective(boxes, np.repeat(voxels.centres_m[:, 2], 12)))
    right.set_title(f"the map, voxels of {voxels.edge_m:g} m", color=INK)
    for axes in (left, middle, right):
        axes.set_axis_off()
    figure.text(0.5, 0.03, caption, color=INK, ha="center", fontsize=11)
    figure.subplots_adjust(left=0.005, right=0.995, top=0.91, bottom=0.10, wspace=0.02)
    figure.savefig(path, dpi=110)


def read_ping(capture: Path, ping_id: int) -> Ping:
    """Find one ping of a recording.

    Raises:
        ValueError: it holds no such ping.
    """
    parser = StreamParser()
    with open_recording(capture) as recording:
        for chunk in recording:
            if chunk.encoding != OCULUS:
                continue
            for message in parser.feed(chunk.data, chunk.arrival_ns):
                ping = decode_ping(message)
                if isinstance(ping, Ping) and ping.ping_id == ping_id:
                    return ping
    raise ValueError(f"{capture}: no ping {ping_id}")


def _perspective(
    triangles_m: NDArray[np.float64], heights_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    low, high = HEIGHTS_M
    share = np.clip((heights_m - low) / (high - low), 0.0, 1.0)
    colours = mpl.colormaps["viridis"](0.25 + 0.75 * share)[:, :3]
    return render(triangles_m, colours, CAMERA, WATER)


def draw_fan(axes: Axes, ping: Ping) -> None:
    """The ping as a fan that opens downwards, as this sonar looks; port is on the left."""
    edge_rad = float(ping.bearings_rad[-1])
    reach_m = ping.max_range_m
    half_m = reach_m * float(np.sin(edge_rad))
    across, down = np.meshgrid(
        np.linspace(-half_m, half_m, FAN_PIXELS), np.linspace(0.0, reach_m, FAN_PIXELS)
    )
    row = (np.hypot(across, down) / ping.range_resolution_m).astype(int)
    bearing = np.arctan2(across, down)
    beam = np.searchsorted(ping.bearings_rad, bearing).clip(0, ping.beams - 1)
    outside = (row >= ping.rows) | (np.abs(bearing) > edge_rad)
    level = np.ma.masked_array(ping.image[np.minimum(row, ping.rows - 1), beam], outside)
    colours = mpl.colormaps["inferno"].with_extremes(bad=(0.0, 0.0, 0.0, 0.0))
    axes.imshow(level, cmap=colours, vmin=0, vmax=150, extent=(-half_m, half_m, reach_m, 0.0))
    axes.set_title(f"one ping of it: {ping.beams} beams, {reach_m:.1f} m", color=INK)
