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
"""Default standard deviations of an initial pose; RViz uses the same."""

Metres = Annotated[float, Meta(ge=-1e6, le=1e6)]
Angle = Annotated[float, Meta(ge=-100, le=100)]
Deviation = Annotated[float, Meta(ge=0, le=1e6)]
Covariance = Annotated[float, Meta(ge=-1e12, le=1e12)]
Row = tuple[Covariance, Covariance, Covariance]


class PoseRequest(Struct, frozen=True, forbid_unknown_fields=True):
    """Requested position and heading of the vehicle on the map.

    Attributes:
        x_m, y_m, yaw_rad: mean; the heading counter-clockwise from x.
        std_xy_m, std_yaw_rad: standard deviations; None is `STD_XY_M`, `STD_YAW_RAD`.
        covariance: of (x, y, yaw), instead of both.
        frame: frame of the pose; empty is the map frame.
    """

    x_m: Metres
    y_m: Metres
    yaw_rad: Angle
    std_xy_m: Deviation | None = None
    std_yaw_rad: Deviation | None = None
    covariance: tuple[Row, Row, Row] | None = None
    frame: Annotated[str, Meta(max_length=64)] = ""

    def gaussian(self) -> PlanarGaussian:
        """Return the pose as a Gaussian.

        Raises:
            ValueError: the covariance is invalid, a number is not finite, or both a covariance and
                a standard deviation are given.
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
    """A request cannot be carried out; nothing changed.

    Attributes:
        reason: short and stable: `bad_name`, `bad_format`, `cannot_write`, `no_store`, `busy`,
            `no_session`; of localization also `localization_off`, `bad_pose`, `wrong_frame`,
            `no_map`, `no_such_map`, `bad_map`, `no_filter`, `no_free_cells`, `first_map_only`.
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
        """The event log."""

    def status(self) -> dict[str, Any]:
        """Return the status as plain values with units in the keys; cheap, from any thread.

        Keys: `phase`, `activity` (`phase`, or that nothing is mapped), `reason`, `t_s` (the
        daemon's clock), `problems` (most severe first, each with `code` and `text`),
        `version`, `uptime_s`, `sonar`, `odometry`, `pose` (None before the first),
        `localization` (None where it is off), `pings`, `latency_ms`, `behind`, `map`, `store`,
        `recording`, `robots`, `servers`.
        """

    async def save(self, name: str, origin: str) -> dict[str, Any]:
        """Write the map into a file of the folder for maps.

        Args:
            name: file name without a folder; its suffix selects the format.
            origin: who requests it.

        Returns:
            `path`, `bytes`, `seconds`.

        Raises:
            OperationError: it cannot be written.
        """

    async def reset(self, origin: str) -> dict[str, Any]:
        """Empty the map; mapping continues with the next ping.

        Raises:
            OperationError: the store cannot be emptied.
        """

    async def reload(self, origin: str) -> dict[str, Any]:
        """Reload the settings files.

        Returns:
            `changed` (name to value), `refused` (name to reason), `waiting` (names).
        """

    async def snapshot(self, origin: str) -> dict[str, Any]:
        """Flush the map and the recording to disk.

        Returns:
            `bytes`, `seconds`.

        Raises:
            OperationError: there is no store, or it cannot be written.
        """

    def localization(self, particles: int = 0) -> dict[str, Any]:
        """Return the state of localization; cheap, from any thread.

        Args:
            particles: maximum number of particles to include.

        Returns:
            As `mapperd.localization.report.localization_report`.
        """

    async def initial_pose(self, asked: PoseRequest, origin: str) -> dict[str, Any]:
        """Start localization at a pose; without a map it waits for one.

        Raises:
            OperationError: `bad_pose`, `wrong_frame`, `localization_off`, `busy`.
        """

    async def global_localization(self, origin: str) -> dict[str, Any]:
        """Start localization with particles over the whole map.

        Raises:
            OperationError: `no_map`, `no_free_cells`, `localization_off`, `busy`.
        """

    async def request_nomotion_update(self, origin: str) -> dict[str, Any]:
        """Update the filter with the next scan even if the vehicle does not move.

        Raises:
            OperationError: `no_filter`, `localization_off`, `busy`.
        """

    async def set_map(self, name: str, asked: PoseRequest | None, origin: str) -> dict[str, Any]:
        """Switch to another map and pose; both take effect, or neither.

        Args:
            name: name of a file in the maps folder.
            asked: the pose; None continues from the last estimate, or as configured.
            origin: who requests it.

        Returns:
            `path`.

        Raises:
            OperationError: `bad_name`, `bad_format`, `no_such_map`, `bad_map`, `bad_pose`,
                `wrong_frame`, `no_filter`, `no_free_cells`, `first_map_only`, `localization_off`,
                `busy`.
        """
