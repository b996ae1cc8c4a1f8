"""Requests that a running daemon accepts from its socket, a broker or a signal."""

import math
from collections import OrderedDict
from collections.abc import Iterable
from typing import Annotated, Any, Literal, Protocol

import numpy as np
from msgspec import Meta, Struct

from mapperd.config.live import ConfigStore
from mapperd.errors import MapperdError
from mapperd.events import EventLog, Severity
from mapperd.geometry.gaussian import PlanarGaussian

__all__ = [
    "STD_XY_M",
    "STD_YAW_RAD",
    "ChangeReport",
    "DaemonApi",
    "OperationError",
    "PoseRequest",
    "ReportedChanges",
]

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


class ChangeReport(Struct, frozen=True, forbid_unknown_fields=True):
    """A difference of the live map from a known one, as a client has found it.

    Attributes:
        kind: something `appeared` or `vanished`, or the change is `over`.
        id: of the change; a later report of it replaces this one.
        low_m, high_m: corners of its box, map frame.
        voxels: number of voxels.
    """

    kind: Literal["appeared", "vanished", "over"]
    id: Annotated[str, Meta(pattern="^[A-Za-z0-9_.-]{1,64}$")]
    low_m: tuple[Metres, Metres, Metres] = (0.0, 0.0, 0.0)
    high_m: tuple[Metres, Metres, Metres] = (0.0, 0.0, 0.0)
    voxels: Annotated[int, Meta(ge=0, le=2**53)] = 0


MAX_CHANGES = 200
CHANGE_SEVERITIES = {"appeared": Severity.WARNING, "vanished": Severity.NOTICE}


class ReportedChanges:
    """The changes of the map that clients have reported; in the event loop only."""

    def __init__(self) -> None:
        self._changes: OrderedDict[str, tuple[ChangeReport, str]] = OrderedDict()

    def take(
        self, reports: Iterable[ChangeReport], known: str, events: EventLog, *, begin: bool
    ) -> None:
        """Add reports, and an event for each that is new.

        Args:
            reports: the changes.
            known: name of the known map.
            events: takes the events.
            begin: forget earlier reports.
        """
        before, earlier = self._changes, OrderedDict(self._changes)
        if begin:
            before.clear()
        for one in reports:
            if one.kind == "over":
                if before.pop(one.id, None) is not None:
                    text = f"change {one.id} against {known} is over"
                    events.add(Severity.INFO, "change_over", text, id=one.id, map=known)
                continue
            known_before = earlier.get(one.id)
            before[one.id] = (one, known)
            if known_before is None or known_before[0].kind != one.kind:
                events.add(
                    CHANGE_SEVERITIES[one.kind], one.kind, _text(one, known), **_facts(one, known)
                )
        while len(before) > MAX_CHANGES:
            before.popitem(last=False)

    def plain(self) -> list[dict[str, Any]]:
        """Return the changes as plain values: `kind`, `id`, `low_m`, `high_m`, `voxels`, `map`."""
        return [{"kind": one.kind, **_facts(one, known)} for one, known in self._changes.values()]


def _facts(change: ChangeReport, known: str) -> dict[str, Any]:
    return {
        "id": change.id,
        "low_m": list(change.low_m),
        "high_m": list(change.high_m),
        "voxels": change.voxels,
        "map": known,
    }


def _text(change: ChangeReport, known: str) -> str:
    ranges = zip("xyz", change.low_m, change.high_m, strict=True)
    where = ", ".join(f"{axis} {low:.1f} to {high:.1f}" for axis, low, high in ranges)
    return f"something has {change.kind} against {known}: {change.voxels} voxels at {where} m"


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

    @property
    def changes(self) -> ReportedChanges:
        """The changes of the map that clients have reported."""

    def status(self) -> dict[str, Any]:
        """Return the status as plain values with units in the keys; cheap, from any thread.

        Keys: `phase`, `activity` (`phase`, or that nothing is mapped), `reason`, `t_s` (the
        daemon's clock), `problems` (most severe first, each with `code` and `text`),
        `version`, `uptime_s`, `sonar`, `odometry`, `pose` (None before the first),
        `localization` (None where it is off), `pings`, `latency_ms`, `behind`, `map`, `store`,
        `recording`, `robots`, `changes`, `servers`.
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
