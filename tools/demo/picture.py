"""The demo's picture: the scene, one ping of it, and the map."""

import math
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from demo.map_truth import OccupiedVoxels
from oculus_driver.ping import Ping, decode_ping
from oculus_driver.recording import OCULUS, open_recording
from oculus_driver.stream import StreamParser

LIGHT = np.array([-0.45, -0.6, 0.66])
AMBIENT = 0.5
FOG = 2.0
"""Where the water has swallowed 63 % of a surface's colour: times the eye's distance to what it
looks at."""
SHADOW_LIFT_M = 0.02


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole that looks from one point to another, up being +z.

    Attributes:
        eye_m, target_m: positions.
        width, height: of the picture, pixels.
        field_of_view_deg: horizontal.
    """

    eye_m: tuple[float, float, float]
    target_m: tuple[float, float, float]
    width: int = 1000
    height: int = 720
    field_of_view_deg: float = 42.0

    def rays(self) -> NDArray[np.float64]:
        """Unit directions, (height * width, 3), row by row from the top left."""
        forward = np.subtract(self.target_m, self.eye_m)
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        up = np.cross(right, forward)
        half = math.tan(math.radians(self.field_of_view_deg) / 2.0)
        across = np.linspace(-half, half, self.width)
        down = np.linspace(half, -half, self.height) * self.height / self.width
        rays = forward + across[None, :, None] * right + down[:, None, None] * up
        unit: NDArray[np.float64] = rays / np.linalg.norm(rays, axis=2, keepdims=True)
        return unit.reshape(-1, 3)


def render(
    triangles_m: NDArray[np.float64],
    colours: NDArray[np.float64],
    camera: Camera,
    water: tuple[float, float, float],
) -> NDArray[np.float64]:
    """Draw.

    Args:
        triangles_m: (F, 3, 3).
        colours: of each triangle, (F, 3), 0..1.
        camera: where from.
        water: colour of nothing, and of the far.

    Returns:
        Picture (height, width, 3), 0..1.
    """
    scene = EmbreeScene()
    mesh = TriangleMesh(scene, triangles_m.astype(np.float32))
    rays = camera.rays()
    origins = np.broadcast_to(np.asarray(camera.eye_m), rays.shape)
    distance, face = _cast(scene, origins, rays)
    hit = face >= 0
    normal = _normals(triangles_m[face[hit]], rays[hit])
    points = origins[hit] + rays[hit] * distance[hit, None] + SHADOW_LIFT_M * normal
    _, blocker = _cast(scene, points, np.broadcast_to(LIGHT, points.shape))
    lit = np.clip(normal @ LIGHT, 0.0, None) * (blocker < 0)
    shaded = colours[face[hit]] * (AMBIENT + (1.0 - AMBIENT) * lit)[:, None]
    fog_m = FOG * float(np.linalg.norm(np.subtract(camera.target_m, camera.eye_m)))
    clear = np.exp(-np.square(distance[hit] / fog_m))[:, None]
    picture = np.broadcast_to(np.asarray(water), rays.shape).copy()
    picture[hit] = shaded * clear + np.asarray(water) * (1.0 - clear)
    del mesh  # Embree reads it until here
    shaped: NDArray[np.float64] = picture.reshape(camera.height, camera.width, 3)
    return shaped


def cubes(centres_m: NDArray[np.float64], edge_m: float) -> NDArray[np.float64]:
    """Triangles of cubes around points, (12 N, 3, 3), twelve a cube in order."""
    corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) - 0.5
    faces = np.array(
        [
            [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
            [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
        ]
    )  # fmt: skip
    solid = corner[faces] * edge_m
    placed: NDArray[np.float64] = centres_m[:, None, None, :] + solid[None]
    return placed.reshape(-1, 3, 3)


def _cast(
    scene: EmbreeScene, origins_m: NDArray[np.float64], directions: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    found = scene.run(
        np.ascontiguousarray(origins_m, dtype=np.float32),
        np.ascontiguousarray(directions, dtype=np.float32),
        output=True,
    )
    return found["tfar"].astype(np.float64), found["primID"].astype(np.int64)


def _normals(triangles_m: NDArray[np.float64], rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit normals on the side that the ray comes from."""
    normal = np.cross(triangles_m[:, 1] - triangles_m[:, 0], triangles_m[:, 2] - triangles_m[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    away = np.sum(normal * rays, axis=1) > 0.0
    normal[away] *= -1.0
    return normal


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
    path: Path, scene_m: NDArray[np.float64], voxels: OccupiedVoxels, ping: Ping, caption: str
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
