"""Draws what moves on the map: vehicle, path, field of view, returns, robots, localization.

Also the boxes of what has changed against a known map.
"""

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd.viewer.shapes import Nodes, box_lines, ellipse, fan_lines, strip, vehicle_parts
from mapperd.wire.messages import (
    FanMessage,
    LocalizationMessage,
    PathMessage,
    PoseMessage,
    ReturnsMessage,
    RobotsMessage,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from viser import SceneApi

__all__ = ["Actors"]

VEHICLE_M = 0.7
PATH_PIECE = 500
"""Points of the path in one node; only the last node is sent again as the path grows."""

MAX_ROBOTS = 32
MAX_PARTICLES = 3000
MAX_CHANGES = 50
SIGMAS = 2.0

LAYERS = ("path", "returns", "robots", "localization", "changes")

PATH = (56, 189, 248)
FAN = (250, 204, 21)
RETURNS = (255, 255, 255)
ROBOT = (236, 72, 153)
SCAN = (74, 222, 128)
PARTICLES = (192, 132, 252)
ELLIPSE = (244, 114, 182)
CHANGES = {"appeared": (74, 222, 128), "vanished": (248, 113, 113)}


class Actors:
    """Draws moving objects; use from one thread.

    Args:
        scene: scene of the server.
    """

    def __init__(self, scene: "SceneApi") -> None:
        self._scene = scene
        for name in LAYERS:
            scene.add_frame(f"/{name}", show_axes=False)
        scene.add_frame("/grid", show_axes=True, axes_length=1.0, axes_radius=0.02)
        self._floor_m: float | None = None
        self._vehicle = scene.add_frame("/vehicle", show_axes=False, visible=False)
        self._sonar = scene.add_frame("/sonar", show_axes=False, visible=False)
        for part in vehicle_parts(VEHICLE_M):
            scene.add_mesh_simple(
                f"/vehicle/{part.name}",
                part.vertices,
                part.faces,
                color=part.colour,
                flat_shading=True,
                cast_shadow=False,
                receive_shadow=False,
            )
        scene.add_line_segments(
            "/vehicle/ahead",
            np.array([[[VEHICLE_M / 2, 0, 0], [VEHICLE_M / 2 + 1.5, 0, 0]]], np.float32),
            (239, 68, 68),
            thickness=3.0,
            thickness_units="screen",
        )
        self._path_sent = 0
        self._pieces = 0
        self._robots: set[str] = set()
        self._changes: list[Any] = []
        self._nodes = Nodes()

    def floor(self, z_m: float) -> None:
        """Draw the grid under the map: cells of 1 m, lines of 10 m, axes at the map's origin."""
        if z_m == self._floor_m:
            return
        self._floor_m = z_m
        self._scene.add_grid(
            "/grid/floor",
            infinite_grid=True,
            cell_size=1.0,
            cell_color=(60, 70, 85),
            section_size=10.0,
            section_color=(110, 125, 145),
            fade_distance=150.0,
            shadow_opacity=0.0,
            position=(0.0, 0.0, z_m),
        )

    def pose(self, pose: PoseMessage) -> None:
        """Move the vehicle."""
        x, y, z, w = pose.orientation_xyzw
        self._vehicle.wxyz, self._vehicle.position = (w, x, y, z), pose.position_m
        x, y, z, w = pose.sonar_orientation_xyzw
        self._sonar.wxyz, self._sonar.position = (w, x, y, z), pose.sonar_position_m
        self._vehicle.visible = self._sonar.visible = True
        if pose.covariance is None:
            self._nodes.remove("/localization/pose")
        else:
            plane = np.array(pose.covariance).reshape(6, 6)[:2, :2]
            self._ellipse("/localization/pose", plane, pose.position_m)

    def take(self, message: object, path: NDArray[np.float64], z_m: float) -> None:
        """Draw a message of the stream; other kinds are ignored.

        Args:
            message: the message.
            path: the whole path, (N, 3) metres, map frame.
            z_m: height of planar shapes.
        """
        match message:
            case PathMessage():
                self.path(path, message.first)
            case FanMessage():
                self.fan(message)
            case ReturnsMessage():
                self.returns(message)
            case RobotsMessage():
                self.robots(message)
            case LocalizationMessage():
                self.localization(message, z_m)
            case _:
                pass

    def fan(self, fan: FanMessage) -> None:
        """Draw the field of view."""
        self._nodes.put("/sonar/fan", self._lines(FAN, 1.5), points=fan_lines(fan))

    def path(self, points: NDArray[np.float64], first: int) -> int:
        """Draw the path, (N, 3) metres; return the bytes sent.

        Points from `first` on are new or differ from those sent before.
        """
        if min(first, len(points)) < self._path_sent:
            self._forget_path()
        if len(points) == self._path_sent or len(points) < 2:  # noqa: PLR2004 a line has two ends
            return 0
        sent = 0
        for piece in range(
            max(0, self._path_sent - 1) // PATH_PIECE, -(-len(points) // PATH_PIECE)
        ):
            part = points[piece * PATH_PIECE : (piece + 1) * PATH_PIECE + 1]
            if len(part) > 1:
                # Relative to its first point, because graphics use single precision.
                self._nodes.put(
                    f"/path/{piece}",
                    self._lines(PATH, 2.5),
                    points=strip(part - part[0]),
                    position=tuple(part[0].tolist()),
                )
                sent += 24 * (len(part) - 1)
                self._pieces = max(self._pieces, piece + 1)
        self._path_sent = len(points)
        return sent

    def returns(self, returns: ReturnsMessage) -> None:
        """Draw the returns of the newest ping."""
        points = np.frombuffer(returns.points, "<f4").reshape(-1, 3)
        if len(points) == 0 or returns.sonar_position_m is None:
            self._nodes.remove("/returns/last")
            return
        x, y, z, w = returns.sonar_orientation_xyzw or (0.0, 0.0, 0.0, 1.0)
        self._nodes.put(
            "/returns/last",
            self._dots(RETURNS, 0.09),
            points=points,
            wxyz=(w, x, y, z),
            position=returns.sonar_position_m,
        )

    def robots(self, robots: RobotsMessage) -> None:
        """Draw the newest sightings of robots."""
        newest = sorted(robots.seen)[-MAX_ROBOTS:]
        last_ns = newest[-1][0] if newest else 0
        shown = set()
        for number, (stamp_ns, x, y, z) in enumerate(newest):
            name = f"/robots/{number}"
            shown |= {name, f"{name}_label"}
            self._nodes.put(
                name,
                partial(self._scene.add_icosphere, radius=0.2, color=ROBOT, cast_shadow=False),
                position=(x, y, z),
            )
            age_s = (last_ns - stamp_ns) / 1e9
            self._nodes.put(
                f"{name}_label",
                partial(self._scene.add_label, anchor="bottom-center"),
                text=f"robot {age_s:.0f} s before" if age_s else "robot",
                position=(x, y, z + 0.35),
            )
        for name in self._robots - shown:
            self._nodes.remove(name)
        self._robots = shown

    def changes(self, changes: list[Any]) -> None:
        """Draw the boxes of the changes of the daemon's status, with the number of their voxels."""
        if changes == self._changes:
            return
        for one in self._changes[-MAX_CHANGES:]:
            self._nodes.remove(f"/changes/{one['id']}")
            self._nodes.remove(f"/changes/{one['id']}_label")
        self._changes = changes
        for one in changes[-MAX_CHANGES:]:
            low, high = (np.array(one[name], np.float64) for name in ("low_m", "high_m"))
            self._nodes.put(
                f"/changes/{one['id']}",
                self._lines(CHANGES[one["kind"]], 2.5),
                points=box_lines(high - low),
                position=tuple(low.tolist()),
            )
            self._nodes.put(
                f"/changes/{one['id']}_label",
                partial(self._scene.add_label, anchor="bottom-center"),
                text=f"{one['kind']}: {one['voxels']} voxels",
                position=(*((low + high) / 2)[:2].tolist(), float(high[2])),
            )

    def localization(self, state: LocalizationMessage, z_m: float) -> None:
        """Draw particles, the newest scan and the two-sigma ellipse at a height."""
        particles = np.frombuffer(state.particles, "<f4").reshape(-1, 4)[:MAX_PARTICLES]
        flat = np.column_stack([particles[:, :2], np.full(len(particles), z_m, np.float32)])
        self._cloud("/localization/particles", flat, self._dots(PARTICLES, 0.05))
        scan = np.frombuffer(state.scan, "<f4").reshape(-1, 3)
        self._cloud("/localization/scan", scan, self._dots(SCAN, 0.1))
        pose: Any = state.report.get("pose")
        if isinstance(pose, dict) and pose.get("covariance"):
            at = (float(pose["x_m"]), float(pose["y_m"]), z_m)
            self._ellipse("/localization/best", np.array(pose["covariance"])[:2, :2], at)
        else:
            self._nodes.remove("/localization/best")

    def forget(self) -> None:
        """Remove everything."""
        self._vehicle.visible = self._sonar.visible = False
        self._nodes.clear()
        self._robots = set()
        self._changes = []
        self._path_sent = self._pieces = 0

    def show(self, name: str, *, shown: bool) -> None:
        """Show or hide one kind: one of `LAYERS`, `grid`, or `sonar/fan`."""
        node = self._scene.get_handle_by_name(f"/{name}")
        if node is not None:
            node.visible = shown

    def _lines(self, colour: tuple[int, int, int], thickness: float) -> "Callable[..., object]":
        return partial(
            self._scene.add_line_segments,
            colors=colour,
            thickness=thickness,
            thickness_units="screen",
        )

    def _dots(self, colour: tuple[int, int, int], size_m: float) -> "Callable[..., object]":
        return partial(
            self._scene.add_point_cloud,
            colors=colour,
            point_size=size_m,
            point_shape="circle",
            point_shading="flat",
            precision="float32",
        )

    def _cloud(self, name: str, points: NDArray[np.float32], make: "Callable[..., object]") -> None:
        if len(points):
            self._nodes.put(name, make, points=points)
        else:
            self._nodes.remove(name)

    def _ellipse(self, name: str, plane: ArrayLike, at_m: tuple[float, float, float]) -> None:
        lines = ellipse(plane, SIGMAS)
        self._nodes.put(name, self._lines(ELLIPSE, 3.0), points=lines, position=at_m)

    def _forget_path(self) -> None:
        for piece in range(self._pieces):
            self._nodes.remove(f"/path/{piece}")
        self._path_sent = self._pieces = 0
