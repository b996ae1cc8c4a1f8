"""Requests that a running daemon accepts from its socket, a broker or a signal."""

import math
from typing import Annotated, Any, Protocol

import numpy as np
from msgspec import Meta, Struct

from mapperd.config.live import ConfigStore
from mapperd.errors import MapperdError
from mapperd.events import EventLog
from mapperd.geometry.gaussian import PlanarGaussian

__all__ = ["STD_XY_M", "STD_YAW_RAD", "DaemonApi", "OperationError", "PoseRequest"]

STD_XY_M = 0.5
STD_YAW_RAD = math.pi / 12
"""Of a pose that is given without: what RViz gives with a pose that is drawn by hand."""

Metres = Annotated[float, Meta(ge=-1e6, le=1e6)]
Angle = Annotated[float, Meta(ge=-100, le=100)]
Deviation = Annotated[float, Meta(ge=0, le=1e6)]
Covariance = Annotated[float, Meta(ge=-1e12, le=1e12)]
Row = tuple[Covariance, Covariance, Covariance]


class PoseRequest(Struct, frozen=True, forbid_unknown_fields=True):
    """The vehicle's place and heading on the map, as it comes from outside.

    Attributes:
        x_m, y_m, yaw_rad: mean; the heading counter-clockwise from x.
        std_xy_m, std_yaw_rad: standard deviations; None is `STD_XY_M`, `STD_YAW_RAD`.
        covariance: of (x, y, yaw), instead of both.
        frame: that the pose is in; empty is the map's.
    """

    x_m: Metres
    y_m: Metres
    yaw_rad: Angle
    std_xy_m: Deviation | None = None
    std_yaw_rad: Deviation | None = None
    covariance: tuple[Row, Row, Row] | None = None
    frame: Annotated[str, Meta(max_length=64)] = ""

    def gaussian(self) -> PlanarGaussian:
        """The pose as the filter takes it.

        Raises:
            ValueError: the covariance is none, a number is not finite, or both a covariance and a
                standard deviation are given.
        """
        return PlanarGaussian(self.x_m, self.y_m, self.yaw_rad, self._covariance())

    def _covariance(self) -> np.ndarray:
        if self.covariance is not None:
            if self.std_xy_m is not None or self.std_yaw_rad is not None:
                raise ValueError("a covariance or standard deviations, not both")
            return np.array(self.covariance)
        xy_m = STD_XY_M if self.std_xy_m is None else self.std_xy_m
        yaw_rad = STD_YAW_RAD if self.std_yaw_rad is None else self.std_yaw_rad
        return np.diag([xy_m**2, xy_m**2, yaw_rad**2])


class OperationError(MapperdError):
    """What was asked cannot be done; nothing changed.

    Attributes:
        reason: short and stable: `bad_name`, `bad_format`, `cannot_write`, `no_store`, `busy`; of
            localization also `localization_off`, `bad_pose`, `wrong_frame`, `no_map`,
            `no_such_map`, `bad_map`, `no_filter`, `no_free_cells`, `first_map_only`.
    """

    def __init__(self, message: str, reason: str) -> None:
        super().__init__(message)
        self.reason = reason


class DaemonApi(Protocol):
    """The daemon, as its servers see it. Coroutines run in the daemon's event loop."""

    @property
    def settings(self) -> ConfigStore:
        """The settings in force; changes go through it."""

    @property
    def events(self) -> EventLog:
        """What happened."""

    def status(self) -> dict[str, Any]:
        """How it goes, in plain values with units in the keys; cheap, from any thread.

        Keys: `phase`, `reason`, `version`, `uptime_s`, `sonar`, `odometry`, `pose` (None before the
        first), `localization` (None where it is off), `pings`, `latency_ms`, `behind`, `map`,
        `store`, `recording`, `robots`, `servers`.
        """

    async def save(self, name: str, origin: str) -> dict[str, Any]:
        """Write the map into a file of the folder for maps.

        Args:
            name: of the file, without a folder; its suffix says the format.
            origin: who asks.

        Returns:
            `path`, `bytes`, `seconds`.

        Raises:
            OperationError: it cannot be written.
        """

    async def reset(self, origin: str) -> dict[str, Any]:
        """Empty the map; pings from the next one on fill it again.

        Raises:
            OperationError: the store cannot be emptied.
        """

    async def reload(self, origin: str) -> dict[str, Any]:
        """Read the settings' files again.

        Returns:
            `changed` (name to value), `refused` (name to reason), `waiting` (names).
        """

    async def snapshot(self, origin: str) -> dict[str, Any]:
        """Bring the map and the recording to the disk now.

        Returns:
            `bytes`, `seconds`.

        Raises:
            OperationError: there is no store, or it cannot be written.
        """

    def localization(self, particles: int = 0) -> dict[str, Any]:
        """Where the vehicle is on the known map; cheap, from any thread.

        Args:
            particles: of the cloud, at most so many.

        Returns:
            As `mapperd.localization.report.localization_report`.
        """

    async def initial_pose(self, asked: PoseRequest, origin: str) -> dict[str, Any]:
        """Begin localization at a pose; without a map it waits for one.

        Raises:
            OperationError: `bad_pose`, `wrong_frame`, `localization_off`, `busy`.
        """

    async def global_localization(self, origin: str) -> dict[str, Any]:
        """Begin localization anywhere on the map.

        Raises:
            OperationError: `no_map`, `no_free_cells`, `localization_off`, `busy`.
        """

    async def request_nomotion_update(self, origin: str) -> dict[str, Any]:
        """Have the next scan be an update, even if nothing moves.

        Raises:
            OperationError: `no_filter`, `localization_off`, `busy`.
        """

    async def set_map(self, name: str, asked: PoseRequest | None, origin: str) -> dict[str, Any]:
        """Localize on another map, from a pose on: both or neither.

        Args:
            name: of a file in the folder for maps.
            asked: the pose; None goes on from the last estimate, or as the settings say.
            origin: who asks.

        Returns:
            `path`.

        Raises:
            OperationError: `bad_name`, `bad_format`, `no_such_map`, `bad_map`, `bad_pose`,
                `wrong_frame`, `no_filter`, `no_free_cells`, `first_map_only`, `localization_off`,
                `busy`.
        """
