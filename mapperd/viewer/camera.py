"""Camera of each browser: behind the vehicle, above it, or free."""

from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from viser import ClientHandle

__all__ = ["VIEWS", "CameraMode", "Cameras", "whole_view"]

CameraMode = Literal["follow", "top", "free"]
VIEWS: tuple[CameraMode, ...] = ("follow", "top", "free")

BEHIND_M = np.array([-7.0, -4.0, 5.0])
"""Initial offset of a following camera from the vehicle, base frame without roll and pitch."""

ABOVE_M = 25.0
MOVED_M = 0.005


class Cameras:
    """Moves the cameras of browsers; use from one thread."""

    def __init__(self) -> None:
        self._modes: dict[int, CameraMode] = {}
        self._at: dict[int, NDArray[np.float64]] = {}

    def mode(self, client: "ClientHandle") -> CameraMode:
        """Camera mode of a browser."""
        return self._modes.get(client.client_id, "free")

    def choose(
        self, client: "ClientHandle", mode: CameraMode, vehicle_m: ArrayLike | None, yaw: float
    ) -> None:
        """Change the camera mode of a browser.

        Args:
            client: the browser.
            mode: the new mode.
            vehicle_m: (3,) map frame; None if unknown.
            yaw: heading of the vehicle, radians from x counter-clockwise.
        """
        self._modes[client.client_id] = mode
        self._at.pop(client.client_id, None)
        if mode == "free":
            client.camera.up_direction = (0.0, 0.0, 1.0)
        elif vehicle_m is not None:
            self._begin(client, mode, np.asarray(vehicle_m, np.float64), yaw)

    def follow(self, clients: list["ClientHandle"], vehicle_m: ArrayLike, yaw: float) -> None:
        """Move following cameras with the vehicle; they keep direction and distance.

        The position of a slow browser is that of some time ago.
        """
        vehicle = np.asarray(vehicle_m, np.float64)
        for client in clients:
            mode = self.mode(client)
            if mode == "free":
                continue
            before = self._at.get(client.client_id)
            if before is None:
                self._begin(client, mode, vehicle, yaw)
            elif float(np.linalg.norm(vehicle - before)) > MOVED_M:
                offset = client.camera.position - client.camera.look_at
                self._at[client.client_id] = vehicle
                _place(client, vehicle, offset)

    def forget(self, client_id: int) -> None:
        """Remove a browser."""
        self._modes.pop(client_id, None)
        self._at.pop(client_id, None)

    def _begin(
        self, client: "ClientHandle", mode: CameraMode, vehicle: NDArray[np.float64], yaw: float
    ) -> None:
        self._at[client.client_id] = vehicle
        if mode == "top":
            up, offset = (0.0, 1.0, 0.0), np.array([0.0, 0.0, ABOVE_M])
        else:
            c, s = np.cos(yaw), np.sin(yaw)
            up = (0.0, 0.0, 1.0)
            offset = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ BEHIND_M
        with client.atomic():
            client.camera.up_direction = up
            _place(client, vehicle, offset)


def _place(
    client: "ClientHandle", vehicle: NDArray[np.float64], offset: NDArray[np.float64]
) -> None:
    """Have the camera look at the vehicle from an offset."""
    with client.atomic():
        client.camera.position = vehicle + offset
        client.camera.look_at = vehicle


def whole_view(
    low_m: ArrayLike, high_m: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Position and target of a camera that shows a box (3,), (3,)."""
    low, high = np.asarray(low_m, np.float64), np.asarray(high_m, np.float64)
    middle = (low + high) / 2
    away = max(4.0, float(np.linalg.norm(high - low))) * np.array([-0.42, -0.62, 0.55])
    return middle + away, middle
