"""What bridges take from the state of a client: the pose that is sure, and a slice of the map."""

import math
from collections import OrderedDict
from collections.abc import AsyncIterator, Callable, Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mapperd.client.changes import ClientChange, ConnectionStatus
from mapperd.client.mirror import MapMirror, keys_of, names_of
from mapperd.errors import ExportError
from mapperd.export.cells import FREE, MAX_CELLS, OCCUPIED, UNKNOWN, GridLayer, GridWindow
from mapperd.export.clouds import POINT
from mapperd.geometry.frames import Pose, quaternion_product, quaternion_to_matrix
from mapperd.wire.blocks import UNKNOWN as UNKNOWN_CELL
from mapperd.wire.messages import (
    BLOCK_EDGE,
    FanMessage,
    LocalizationMessage,
    PoseMessage,
    RobotsMessage,
    StatusMessage,
    WelcomeMessage,
)

__all__ = [
    "NS",
    "REPORT_VALID_S",
    "BridgeClient",
    "CloudCache",
    "ConnectionState",
    "HeldLocalization",
    "LinkReporter",
    "MapFrames",
    "RateLimit",
    "VehiclePose",
    "has_odom_pose",
    "inverse",
    "map_odom_of",
    "map_slice",
    "planar_estimate",
    "sure_pose",
]

Floats = NDArray[np.float64]

NS = 1_000_000_000
REPORT_VALID_S = 3.0
"""A state of localization counts for this time: states come five times a second, and on a slow link
every other second."""

PLANAR = np.ix_([0, 1, 5], [0, 1, 5])
"""Indices of x, y and the turn about z in the covariance of a pose."""


class BridgeClient(Protocol):
    """What bridges use of a client of the map stream."""

    @property
    def mirror(self) -> MapMirror | None: ...  # noqa: D102
    @property
    def link(self) -> ConnectionStatus: ...  # noqa: D102
    @property
    def welcome(self) -> WelcomeMessage | None: ...  # noqa: D102
    @property
    def settings(self) -> Mapping[str, Any]: ...  # noqa: D102
    @property
    def pose(self) -> PoseMessage | None: ...  # noqa: D102
    @property
    def fan(self) -> FanMessage | None: ...  # noqa: D102
    @property
    def robots(self) -> RobotsMessage | None: ...  # noqa: D102
    @property
    def localization(self) -> LocalizationMessage | None: ...  # noqa: D102
    @property
    def status(self) -> StatusMessage | None: ...  # noqa: D102
    def changes(self) -> AsyncIterator[ClientChange]: ...  # noqa: D102
    async def ask(self, do: str, **fields: Any) -> dict[str, Any]: ...  # noqa: ANN401, D102


class LinkReporter:
    """Reports each state of the connection to the daemon in one line; attempts are not reported.

    Args:
        report: takes the lines.
    """

    def __init__(self, report: Callable[[str], None]) -> None:
        self._report = report
        self._reported = ""

    def take(self, link: ConnectionStatus) -> bool:
        """Report a state; return whether the daemon is connected."""
        text = f"daemon {link.address}: {link.state} {link.reason}".strip()
        if link.state in ("connected", "waiting") and link.state != self._reported:
            self._reported = link.state
            self._report(text)
        return link.state == "connected"


class RateLimit:
    """Lets through what is due by a rate: on average it is never exceeded.

    Args:
        rate_hz: 0 lets nothing through.
    """

    def __init__(self, rate_hz: float) -> None:
        self._period_s = 1 / rate_hz if rate_hz else math.inf
        self._next_s = -math.inf

    def due(self, now_s: float) -> bool:
        """Return whether something may pass now, and count it.

        Args:
            now_s: monotonic time.
        """
        if now_s < self._next_s or math.isinf(self._period_s):
            return False
        late = now_s - self._next_s > self._period_s
        self._next_s = (now_s if late else self._next_s) + self._period_s
        return True


@dataclass(frozen=True, slots=True, eq=False)
class VehiclePose:
    """Pose of the vehicle's base in the map.

    Attributes:
        stamp_ns: Unix time.
        pose: base in the map.
        velocity_mps: (3,), map frame; None if unknown.
        covariance: (6, 6) of x, y, z and rotations about the map's axes; None if unknown.
    """

    stamp_ns: int
    pose: Pose
    velocity_mps: Floats | None = None
    covariance: Floats | None = None

    @classmethod
    def of(cls, message: PoseMessage) -> "VehiclePose":
        """Return the pose of a message."""
        covariance, velocity = message.covariance, message.velocity_mps
        return cls(
            message.stamp_ns,
            Pose(np.asarray(message.position_m), _unit(message.orientation_xyzw)),
            None if velocity is None else np.asarray(velocity, np.float64),
            None if covariance is None else np.reshape(covariance, (6, 6)).astype(np.float64),
        )

    def moved(self, by: Pose) -> "VehiclePose":
        """Return the pose in another frame, in which this one's frame has the pose `by`."""
        turn = quaternion_to_matrix(by.map_q_base)
        both = np.kron(np.eye(2), turn)
        velocity, covariance = self.velocity_mps, self.covariance
        quaternion = quaternion_product(by.map_q_base, self.pose.map_q_base)
        return VehiclePose(
            self.stamp_ns,
            Pose(
                turn @ self.pose.position_m + by.position_m, quaternion / np.linalg.norm(quaternion)
            ),
            None if velocity is None else turn @ velocity,
            None if covariance is None else both @ covariance @ both.T,
        )


def sure_pose(
    vehicle: PoseMessage, localization: LocalizationMessage | None, *, odometry: bool
) -> VehiclePose | str:
    """Return the pose in the known map while localization is sure, or why there is none.

    Args:
        vehicle: newest pose of the daemon.
        localization: newest state; None if there is none.
        odometry: without localization, the pose by odometry is sure too.
    """
    report: Mapping[str, Any] = {} if localization is None else localization.report
    state = str(report.get("state", "off"))
    if state == "off" and odometry and vehicle.source == "odometry":
        return VehiclePose.of(vehicle)
    if state != "localized" or report.get("sure") is not True:
        return f"localization: {'not sure' if state == 'localized' else state}"
    if vehicle.source == "localization":
        return _with_unknown(VehiclePose.of(vehicle))
    correction, estimate = map_odom_of(report), planar_estimate(report)
    if correction is None or estimate is None:
        return "localization: no transform"
    located = VehiclePose.of(vehicle).moved(correction)
    covariance = np.zeros((6, 6)) if located.covariance is None else located.covariance
    covariance[[0, 1, 5], :] = covariance[:, [0, 1, 5]] = 0.0
    covariance[PLANAR] = estimate[1]
    return _with_unknown(
        VehiclePose(located.stamp_ns, located.pose, located.velocity_mps, covariance)
    )


UNKNOWN_VARIANCE = np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1])
"""Metres and radians, squared: larger than those of estimates in use, and small enough for an
autopilot that makes one figure of all axes, as ArduPilot does, to still use the others."""


def _with_unknown(located: VehiclePose) -> VehiclePose:
    """Return the pose with a large variance for the axes that have none: localization is planar."""
    if located.covariance is None:
        return located
    missing = np.where(np.diag(located.covariance) > 0, 0.0, UNKNOWN_VARIANCE)
    return replace(located, covariance=located.covariance + np.diag(missing))


def held(last: LocalizationMessage | None, new: LocalizationMessage) -> LocalizationMessage:
    """Return the newest state; a sure one without a transform leaves the last one in force.

    A ping that says nothing of the pose, such as one without echoes, has no transform of its own.

    Args:
        last: state in force; None if there is none.
        new: as it came.
    """
    is_sure = new.report.get("state") == "localized" and new.report.get("sure") is True
    if last is None or not is_sure or map_odom_of(new.report) is not None:
        return new
    return new if map_odom_of(last.report) is None else last


class HeldLocalization:
    """The state of localization in force, and whether it still counts.

    Attributes:
        message: as of `held`; None if there is none.
    """

    def __init__(self) -> None:
        self.message: LocalizationMessage | None = None
        self._came_s = -math.inf

    def take(self, new: LocalizationMessage, now_s: float, age_s: float = 0.0) -> None:
        """Take the newest state.

        Args:
            new: as it came.
            now_s: monotonic time.
            age_s: since it was so.
        """
        self.message = new if self.is_stale(now_s) else held(self.message, new)
        self._came_s = now_s - age_s

    def is_stale(self, now_s: float) -> bool:
        """Return whether no state came for `REPORT_VALID_S`, so that nothing is sure."""
        if self.message is None or self.message.report.get("state", "off") == "off":
            return False
        return now_s - self._came_s > REPORT_VALID_S


class ConnectionState:
    """What the daemon sent on this connection: that of an earlier one may be another session's.

    Attributes:
        vehicle: newest pose; None before the first.
        localization: its state in force.
        status: the last one that had content, as heartbeats without room for it are empty; {}
            before the first.
    """

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget everything: the connection broke."""
        self.vehicle: PoseMessage | None = None
        self.localization = HeldLocalization()
        self.status: Mapping[str, Any] = {}
        self._beat: tuple[int, float] | None = None

    def take(self, change: ClientChange, now_s: float) -> None:
        """Take a change of the client.

        Args:
            change: as it came.
            now_s: monotonic time.
        """
        if isinstance(change, StatusMessage):
            self.status = change.status or self.status
            self._beat = change.stamp_ns, now_s
        elif isinstance(change, LocalizationMessage):
            self.localization.take(change, now_s, self._report_age_s(change, now_s))
        elif isinstance(change, PoseMessage):
            self.vehicle = change

    def age_s(self, stamp_ns: int, now_s: float) -> float:
        """Return the age of a stamp by the daemon's clock; infinite before its first heartbeat.

        A daemon sends its newest pose to each new connection, however old it is.
        """
        if self._beat is None:
            return math.inf
        beat_ns, came_s = self._beat
        return (beat_ns - stamp_ns) / NS + now_s - came_s

    def _report_age_s(self, message: LocalizationMessage, now_s: float) -> float:
        """Return the age of a state; 0 if it has no transform, whose stamp is that of the scan."""
        transform = message.report.get("map_odom")
        stamp_s = transform.get("t_s") if isinstance(transform, Mapping) else None
        if not isinstance(stamp_s, int | float):
            return 0.0
        return max(self.age_s(round(stamp_s * NS), now_s), 0.0)

    @property
    def localizes(self) -> bool | None:
        """Whether the daemon localizes on a known map; None until it is known."""
        message = self.localization.message
        if message is not None:
            return bool(message.report.get("state", "off") != "off")
        return self.status.get("localization") is not None if self.status else None


def map_odom_of(report: Mapping[str, Any]) -> Pose | None:
    """Return the pose of the odometry's frame in the map; None while it is not published."""
    transform = report.get("map_odom")
    if not isinstance(transform, Mapping):
        return None
    try:
        quaternion = np.asarray(transform["orientation_wxyz"], np.float64)
        return Pose(
            np.asarray(transform["position_m"], np.float64), quaternion / np.linalg.norm(quaternion)
        )
    except (KeyError, TypeError, ValueError):
        return None


def planar_estimate(report: Mapping[str, Any]) -> tuple[Floats, Floats] | None:
    """Return (x, y, yaw) and its covariance (3, 3); None if the report has no valid one."""
    found = report.get("pose")
    try:
        mean = np.array([found[name] for name in ("x_m", "y_m", "yaw_rad")], np.float64)  # type: ignore[index]
        covariance = np.asarray(found["covariance"], np.float64)  # type: ignore[index]
    except (KeyError, TypeError, ValueError):
        return None
    if covariance.shape != (3, 3) or not (
        np.isfinite(mean).all() and np.isfinite(covariance).all()
    ):
        return None
    return mean, covariance


@dataclass(frozen=True, slots=True, eq=False)
class MapFrames:
    """The tree of frames of REP-105: map, odometry, base, sonar.

    Attributes:
        map_of_odom: pose of the odometry's frame in the map.
        odom_of_base: pose of the base in the odometry's frame.
        base_of_sonar: pose of the sonar on the base.
        served_in_odom: the daemon maps by odometry while it localizes on another map: what it
            serves as its map lies in the odometry's frame.
    """

    map_of_odom: Pose
    odom_of_base: Pose
    base_of_sonar: Pose
    served_in_odom: bool

    @classmethod
    def of(cls, vehicle: PoseMessage, localization: LocalizationMessage | None) -> "MapFrames":
        """Return the frames at a pose; without localization the odometry's frame is the map.

        A pose that comes with that of the odometry needs no transform of localization.
        """
        base, odom = VehiclePose.of(vehicle).pose, _odom_pose_of(vehicle)
        sonar = Pose(np.asarray(vehicle.sonar_position_m), _unit(vehicle.sonar_orientation_xyzw))
        report = {} if localization is None else localization.report
        correction = map_odom_of(report)
        mounting = _relative(base, sonar)
        if odom is not None:
            return cls(
                _relative(inverse(base), inverse(odom)), odom, mounting, served_in_odom=False
            )
        if correction is None:
            return cls(Pose(np.zeros(3), np.eye(4)[0]), base, mounting, served_in_odom=False)
        if vehicle.source == "localization":
            return cls(correction, _relative(correction, base), mounting, served_in_odom=False)
        return cls(correction, base, mounting, served_in_odom=True)


def has_odom_pose(vehicle: PoseMessage) -> bool:
    """Whether the message has the base in the odometry's frame."""
    return vehicle.odom_position_m is not None and vehicle.odom_orientation_xyzw is not None


def _odom_pose_of(vehicle: PoseMessage) -> Pose | None:
    """Return the base in the odometry's frame; None if the message has none."""
    if vehicle.odom_position_m is None or vehicle.odom_orientation_xyzw is None:
        return None
    return Pose(np.asarray(vehicle.odom_position_m), _unit(vehicle.odom_orientation_xyzw))


def inverse(pose: Pose) -> Pose:
    """Return the pose of the frame in the base, for a pose of the base in the frame."""
    back = pose.map_q_base * (1, -1, -1, -1)
    return Pose(-(quaternion_to_matrix(back) @ pose.position_m), back)


def _relative(frame: Pose, pose: Pose) -> Pose:
    """Return a pose in a frame, both given in a third one."""
    back = frame.map_q_base * (1, -1, -1, -1)
    turn = quaternion_product(back, pose.map_q_base)
    place = quaternion_to_matrix(back) @ (pose.position_m - frame.position_m)
    return Pose(place, turn / math.hypot(*turn.tolist()))


def _unit(xyzw: tuple[float, ...]) -> Floats:
    x, y, z, w = xyzw
    length = math.hypot(x, y, z, w)
    return np.array([w / length, x / length, y / length, z / length])


def map_slice(
    mirror: MapMirror,
    low_m: float,
    high_m: float,
    centre_m: Floats | None = None,
    radius_m: float = math.inf,
) -> GridLayer | None:
    """Return what is known of each column between two heights; None where nothing is.

    A column is OCCUPIED where one of its cells is, else FREE where one is. Cells count whose
    centres lie between the heights.

    Args:
        mirror: the map.
        low_m: lower height, map frame.
        high_m: upper height.
        centre_m: (2,) or (3,), map frame; None for the whole map.
        radius_m: only blocks that are nearer to the centre.

    Raises:
        ExportError: the grid is too large.
    """
    with mirror.lock:
        cell_m, info = mirror.cell_m, mirror.info
        edge_m = BLOCK_EDGE * cell_m
        keys = mirror.keys()
        chosen = ((keys[:, 2] + 1) * edge_m > low_m) & (keys[:, 2] * edge_m < high_m)
        if centre_m is not None:
            off_m = np.abs((keys[:, :2] + 0.5) * edge_m - np.asarray(centre_m)[:2]) - edge_m / 2
            chosen &= np.hypot(*np.maximum(off_m, 0).T) < radius_m
        keys = keys[chosen]
        cells = mirror.cells_of(keys)
        classes = mirror.interest.detail == "classes"
    if not len(keys):
        return None
    step = 1.0 if classes else info.log_odds_step
    above, below = (
        (0, 0)
        if classes
        else (math.floor(info.occupied_log_odds / step), math.ceil(info.free_log_odds / step))
    )
    low, high = keys[:, :2].min(axis=0), keys[:, :2].max(axis=0)
    width, height = (int(edge) for edge in high - low + 1)
    if width * height * BLOCK_EDGE**2 > MAX_CELLS:
        raise ExportError(
            f"a grid of {width * BLOCK_EDGE} x {height * BLOCK_EDGE} cells is too large; "
            f"allowed: {MAX_CELLS} together"
        )
    z_m = (keys[:, 2, None].astype(np.int64) * BLOCK_EDGE + np.arange(BLOCK_EDGE) + 0.5) * cell_m
    counts = ((z_m >= low_m) & (z_m <= high_m))[:, :, None]
    cells = np.where(counts, cells.reshape(-1, BLOCK_EDGE, BLOCK_EDGE**2), UNKNOWN_CELL)
    highest = cells.max(axis=1)
    free = ((cells < below) & (cells != UNKNOWN_CELL)).any(axis=1)
    known = np.where(highest > above, OCCUPIED, np.where(free, FREE, UNKNOWN)).astype(np.uint8)
    grid = np.full((height, width, BLOCK_EDGE, BLOCK_EDGE), UNKNOWN, np.uint8)
    column = keys[:, :2] - low
    np.maximum.at(grid, (column[:, 1], column[:, 0]), known.reshape(-1, BLOCK_EDGE, BLOCK_EDGE))
    values = grid.transpose(0, 2, 1, 3).reshape(height * BLOCK_EDGE, width * BLOCK_EDGE)
    if not values.any():
        return None
    window = GridWindow(
        int(low[0]) * BLOCK_EDGE, int(low[1]) * BLOCK_EDGE, width * BLOCK_EDGE, height * BLOCK_EDGE
    )
    return GridLayer(values, window)


class CloudCache:
    """Points of the occupied cells by block, so that only changed blocks are read again."""

    def __init__(self) -> None:
        self._rows: OrderedDict[bytes, NDArray[np.void]] = OrderedDict()

    def clear(self) -> None:
        """Forget all blocks."""
        self._rows.clear()

    def update(self, mirror: MapMirror, names: Collection[bytes]) -> None:
        """Read changed blocks."""
        with mirror.lock:
            cell_m = mirror.cell_m
            cells = mirror.cells(keys=keys_of(names))
        for name in names:
            self._rows.pop(name, None)
        if not len(cells):
            return
        owner = np.floor(cells.centres_m / (BLOCK_EDGE * cell_m)).astype(np.int32)
        begins = np.flatnonzero(np.r_[True, (owner[1:] != owner[:-1]).any(axis=1)])
        rows = np.empty(len(cells), POINT)
        rows["x"], rows["y"], rows["z"] = cells.centres_m.T
        rows["intensity"] = cells.probability
        rows["count"] = cells.count
        for name, part in zip(names_of(owner[begins]), np.split(rows, begins[1:]), strict=True):
            self._rows[name] = part

    def rows(self) -> NDArray[np.void]:
        """Return all points."""
        if not self._rows:
            return np.empty(0, POINT)
        return np.concatenate(list(self._rows.values()))
