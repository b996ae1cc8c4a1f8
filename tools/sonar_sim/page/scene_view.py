"""What a page draws: a scene with its vehicles, and pings as pictures."""

import contextlib
from collections import deque
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oculus_driver.fan import FanGeometry, fit_fan
from oculus_driver.ping import Ping, decode_ping
from oculus_driver.render import Painter, Style
from oculus_driver.render.painter import warp_to_fan
from oculus_driver.stream import StreamParser
from sonar_sim.geometry.pose import FramePose, quaternion_of
from sonar_sim.scene.scenario import Scenario
from sonar_sim.scene.scene import Scene, Surface

if TYPE_CHECKING:
    from viser import SceneApi

COLOURS = {
    "mud": (92, 82, 68),
    "sand": (168, 148, 110),
    "gravel": (130, 124, 114),
    "rock": (110, 112, 118),
    "concrete": (150, 152, 150),
    "overgrown_concrete": (104, 128, 98),
    "sheet_piling": (120, 92, 76),
    "rusty_steel": (148, 84, 56),
    "painted_steel": (60, 110, 170),
    "overgrown_steel": (96, 116, 84),
    "wood": (140, 104, 66),
    "rubber": (44, 44, 48),
    "neoprene": (40, 44, 60),
}
OTHER = (140, 146, 156)
VEHICLE_COLOURS = ((250, 204, 21), (56, 189, 248), (236, 72, 153), (74, 222, 128))
FAN_COLOUR = (250, 204, 21)
BLUEROV_M = (0.46, 0.34, 0.25)
"""Length, width and height of the vehicle that is drawn where a scene states none."""
TRAIL_POINTS = 400
TRAIL_STEP_M = 0.1
IMAGE_TURN = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""Turns a picture of the page, x right and y down, into the sonar's plane: ahead x, port y."""


class SceneView:
    """What is drawn in three dimensions; use from one thread.

    Args:
        scene: of the page's server.
        scenarios: of each sonar, all in one scene.
    """

    def __init__(self, scene: "SceneApi", scenarios: tuple[Scenario, ...]) -> None:
        self._scene = scene
        self._scenarios = scenarios
        self._moving: list[tuple[Surface, Any]] = []
        self._vehicles: dict[str, Any] = {}
        self._trails: dict[str, deque[NDArray[np.float64]]] = {}
        self._sonars: dict[str, Any] = {}
        self._pictures: dict[str, Any] = {}
        self._draw_scene(scenarios[0].scene)
        for one in scenarios:
            self._draw_vehicle(one)

    def _draw_scene(self, scene: Scene) -> None:
        for number, surface in enumerate(scene.surfaces):
            node = self._scene.add_mesh_simple(
                f"/scene/{number}",
                surface.vertices_m.astype(np.float32),
                surface.faces.astype(np.uint32),
                color=COLOURS.get(surface.material.name, OTHER),
                flat_shading=not surface.smooth,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )
            if surface.motion is not None:
                self._moving.append((surface, node))

    def _draw_vehicle(self, one: Scenario) -> None:
        name = one.vehicle.name
        if name not in self._vehicles:
            key = f"/vehicles/{len(self._vehicles)}"
            colour = VEHICLE_COLOURS[len(self._vehicles) % len(VEHICLE_COLOURS)]
            frame = self._scene.add_frame(key, show_axes=False)
            size_m = one.vehicle.size_m or BLUEROV_M
            self._scene.add_box(f"{key}/body", color=colour, dimensions=size_m, cast_shadow=False)
            nose = (0.1 * size_m[0], 0.6 * size_m[1], 0.6 * size_m[2])
            self._scene.add_box(
                f"{key}/nose",
                color=(239, 68, 68),
                dimensions=nose,
                position=(0.55 * size_m[0], 0.0, 0.0),
                cast_shadow=False,
            )
            self._vehicles[name] = frame
            self._trails[name] = deque(maxlen=TRAIL_POINTS)
        key = f"/sonars/{len(self._sonars)}"
        frame = self._scene.add_frame(key, show_axes=False)
        self._scene.add_line_segments(
            f"{key}/fan", _fan_lines(one), FAN_COLOUR, thickness=1.0, thickness_units="screen"
        )
        self._sonars[one.name] = frame

    def move(self, poses: dict[str, FramePose], time_s: float) -> None:
        """Put vehicles, sonars and moving objects where they are.

        Args:
            poses: map_T_base by the vehicle's name.
            time_s: of the scene.
        """
        for name, pose in poses.items():
            _put(self._vehicles[name], pose)
            self._trace(name, pose.position_m)
        for one in self._scenarios:
            _put(self._sonars[one.name], poses[one.vehicle.name] @ one.mounting.pose)
        for surface, node in self._moving:
            if surface.motion is not None:
                _put(node, surface.motion.pose(time_s))

    def _trace(self, name: str, here_m: NDArray[np.float64]) -> None:
        trail = self._trails[name]
        if trail and float(np.linalg.norm(here_m - trail[-1])) < TRAIL_STEP_M:
            return
        trail.append(here_m)
        if len(trail) > 1:
            points = np.array(trail, dtype=np.float32)
            number = list(self._trails).index(name)
            self._scene.add_line_segments(
                f"/trails/{number}",
                np.stack([points[:-1], points[1:]], axis=1),
                VEHICLE_COLOURS[number % len(VEHICLE_COLOURS)],
                thickness=2.0,
                thickness_units="screen",
            )

    def show_ping(
        self, sonar: str, picture: NDArray[np.uint8], size_m: tuple[float, float], at: FramePose
    ) -> None:
        """Lay a ping's picture into the plane of its fan.

        Args:
            sonar: name of its scenario.
            picture: RGBA, (height, width, 4), the sonar in the middle of its lower edge.
            size_m: its width and height.
            at: map_T_sonar at the transmission.
        """
        middle = at @ FramePose(np.array([size_m[1] / 2.0, 0.0, 0.0]), IMAGE_TURN)
        number = list(self._sonars).index(sonar)
        node = self._pictures.get(sonar)
        if node is not None and node.image.shape == picture.shape:
            with contextlib.suppress(AttributeError):
                node.image = picture
                _put(node, middle)
                return
        self._pictures[sonar] = self._scene.add_image(
            f"/pings/{number}",
            picture,
            *size_m,
            format="png",
            cast_shadow=False,
            receive_shadow=False,
            wxyz=quaternion_of(middle.rotation),
            position=middle.position_m,
        )


def _put(node: Any, pose: FramePose) -> None:  # noqa: ANN401 of viser
    node.position = pose.position_m
    node.wxyz = quaternion_of(pose.rotation)


def _fan_lines(one: Scenario) -> NDArray[np.float32]:
    """Outline of a sonar's field of view in its frame, (N, 2, 3)."""
    sonar = one.sonar
    half, up = sonar.half_aperture_rad, sonar.vertical_width_rad / 2.0
    bearing = np.linspace(-half, half, 33)
    lines = []
    for elevation in (-up, up):
        flat = np.cos(elevation)
        arc = sonar.range_m * np.stack(
            [
                flat * np.cos(bearing),
                -flat * np.sin(bearing),
                np.full_like(bearing, np.sin(elevation)),
            ],
            axis=1,
        )
        lines.append(np.stack([arc[:-1], arc[1:]], axis=1))
        lines.append(np.stack([np.zeros((2, 3)), arc[[0, -1]]], axis=1))
    return np.concatenate(lines).astype(np.float32)


PANEL_PX = 460
TEXTURE_PX = 384
GAMMA = 0.6
WATER_ALPHA, ECHO_ALPHA = 60, 255


def ping_of(message: bytes) -> Ping | None:
    """Read a message as the driver does; None if it is no ping."""
    parser = StreamParser()
    for found in (*parser.feed(message), *parser.finish()):
        ping = decode_ping(found)
        if isinstance(ping, Ping):
            return ping
    return None


class PingPictures:
    """Paints pings; the geometry of the last shape is kept."""

    def __init__(self) -> None:
        self._painter = Painter(Style(height_px=PANEL_PX))
        self._fan: FanGeometry | None = None
        self._shape: tuple[object, ...] = ()

    def panel(self, ping: Ping) -> NDArray[np.uint8]:
        """Paint the fan with rings and captions, RGB, (height, width, 3)."""
        return np.ascontiguousarray(self._painter.paint(ping)[..., ::-1])

    def texture(self, ping: Ping) -> tuple[NDArray[np.uint8], float, float]:
        """Paint the fan bare: water is faint, and what is outside of the fan clear.

        Returns:
            RGBA, (height, width, 4), ahead is up and starboard right; its width and height in m.
            The sonar is in the middle of the lower edge.
        """
        shape = (ping.rows, ping.beams, ping.range_resolution_m, ping.bearings_rad.tobytes())
        if self._fan is None or shape != self._shape:
            half = max(float(np.abs(np.sin(ping.bearings_rad)).max()), 0.1)
            width_px = max(16, round(2.0 * half * TEXTURE_PX))
            size = (width_px, TEXTURE_PX)
            self._fan = fit_fan(ping.bearings_rad, ping.max_range_m, size, (0, 0, 0, 0))
            self._shape = shape
        fan = self._fan
        full = float(np.iinfo(ping.image.dtype).max)
        level = np.clip(np.asarray(ping.image, dtype=np.float32) / full, 0.0, 1.0) ** GAMMA
        warped = np.clip(warp_to_fan(level.astype(np.float32), fan), 0.0, 1.0)
        grey = np.rint(255.0 * warped).astype(np.uint8)
        colours = cv2.applyColorMap(grey, cv2.COLORMAP_INFERNO)[..., ::-1]
        alpha = WATER_ALPHA + (ECHO_ALPHA - WATER_ALPHA) * np.minimum(1.0, 2.5 * warped)
        alpha[fan.outside] = 0.0
        picture = np.dstack([colours, alpha.astype(np.uint8)]).astype(np.uint8)
        return picture, fan.width_px * fan.metres_per_px, fan.height_px * fan.metres_per_px
