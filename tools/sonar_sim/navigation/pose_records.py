"""What others report of the vehicle: native records and MAVLink, on their way to a live path.

The simulator's map is ENU and its base FLU; vehicles send NED and FRD.
"""

import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Protocol

import msgpack
import numpy as np
from numpy.typing import NDArray

from sonar_sim.geometry.live_path import LivePath
from sonar_sim.geometry.pose import FramePose, rotation_by, rotation_of, rotation_of_quaternion
from sonar_sim.navigation.fix import FRD_R_FLU, NED_R_ENU
from sonar_sim.scene.vehicle import Vehicle, metres_per_degree

Vector = NDArray[np.float64]
NATIVE_KEYS = {"v", "t", "clk", "w", "b", "p", "q", "u", "r", "a", "pc", "uc", "rst", "src"}
MAX_RECORD_BYTES = 2048
MAX_REACH_M, MAX_SPEED_MPS, MAX_TURN_RPS = 1e6, 100.0, 100.0
"""What a vehicle stays below; a pose that is not finite would stop the simulator."""
MALFORMED = (ValueError, TypeError, KeyError, OverflowError, RecursionError)
LOCAL_FRAMES, BODY_FRAMES = (1, 20), (8, 12)
"""MAV_FRAME of positions in the map, LOCAL_NED and LOCAL_FRD, and of velocities along the body."""
JUMP_MPS, JUMP_M = 20.0, 1.0
"""What moves farther than this was put somewhere else."""
MAX_GAP_S = 1.0
"""Two positions further apart in time tell no velocity."""
LATES_OF_A_CLOCK = 3
"""So many late records in order come from a clock that was set back; two if they are far off."""
DELAY_WINDOW_S = 5.0
"""The smallest delay is looked for in this long, and in as long before."""
LOCAL_S = 2.0
"""So long after a local position geographic ones are not used."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseRecord:
    """What one message states of the vehicle; None where it does not.

    Attributes:
        stamp_s: of its validity, on the sender's clock.
        position_m: of the base in the map, (3,).
        rotation: map_R_base, (3, 3).
        map_mps: velocity in the map's axes, (3,).
        body_mps: velocity in the base's axes, (3,).
        rates_rps: turn rates in the base's axes, (3,).
    """

    stamp_s: float | None
    position_m: Vector | None = None
    rotation: Vector | None = None
    map_mps: Vector | None = None
    body_mps: Vector | None = None
    rates_rps: Vector | None = None


class PoseDecoder(Protocol):
    """One format."""

    def decode(self, data: bytes, arrival_s: float) -> Iterator[PoseRecord | None]:
        """Decode a datagram or piece of a stream; None stands for what is malformed."""


class NativeRecords:
    """Native records: a MessagePack map, or JSON, a datagram."""

    def decode(self, data: bytes, arrival_s: float) -> Iterator[PoseRecord | None]:
        """Decode one record."""
        del arrival_s
        if len(data) > MAX_RECORD_BYTES:
            yield None
            return
        try:
            fields = json.loads(data) if data[:1] == b"{" else msgpack.unpackb(data)
            record = _native(fields)
            yield record if _is_plausible(record) else None
        except (*MALFORMED, msgpack.exceptions.UnpackException):
            yield None


def _is_plausible(record: PoseRecord) -> bool:
    """Whether all numbers are finite and those of a vehicle."""
    bounds = (
        (record.position_m, MAX_REACH_M),
        (record.map_mps, MAX_SPEED_MPS),
        (record.body_mps, MAX_SPEED_MPS),
        (record.rates_rps, MAX_TURN_RPS),
        (record.rotation, 1.1),
    )
    is_timed = record.stamp_s is None or math.isfinite(record.stamp_s)
    return is_timed and all(
        values is None or bool(np.all(np.abs(values) <= most))  # NaN is not
        for values, most in bounds
    )


def _native(fields: Any) -> PoseRecord:  # noqa: ANN401 whatever a datagram holds
    """Check a record.

    Raises:
        ValueError, TypeError, KeyError: it is none.
    """
    if not isinstance(fields, dict) or fields.keys() - NATIVE_KEYS or fields.get("v") != 1:
        raise ValueError("not a native record")
    north_first = {"ned": True, "local_frd": True, "enu": False, "local_flu": False}[fields["w"]]
    body_down = {"frd": True, "flu": False}[fields["b"]]
    is_stamped = {"unix": True, "boot": True, "arrival": False}[fields["clk"]]
    world = NED_R_ENU if north_first else np.eye(3)  # its own inverse
    body = FRD_R_FLU if body_down else np.eye(3)

    def vector(key: str, count: int = 3) -> Vector | None:
        if key not in fields:
            return None
        values = np.array(fields[key], dtype=np.float64)
        if values.shape != (count,) or not np.isfinite(values).all():
            raise ValueError(f"{key} is not {count} numbers")
        return values

    position, velocity, rates = vector("p"), vector("u"), vector("r")
    if position is not None and np.abs(position).max() > MAX_REACH_M:
        raise ValueError("p is out of range")
    quaternion = vector("q", 4)
    return PoseRecord(
        fields["t"] / 1e9 if is_stamped else None,
        position_m=None if position is None else world @ position,
        rotation=None if quaternion is None else world @ rotation_of_quaternion(quaternion) @ body,
        body_mps=None if velocity is None else body @ velocity,
        rates_rps=None if rates is None else body @ rates,
    )


class MavlinkRecords:
    """MAVLink 1 and 2: position and attitude of the first autopilot that is heard.

    Args:
        vehicle: whose map origin geographic positions count from.

    Attributes:
        autopilot: its system id; None while none was heard.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        # Takes half a second: only who follows MAVLink waits for it.
        from pymavlink.dialects.v20 import common  # noqa: PLC0415

        self._link = common.MAVLink(None)
        self._link.robust_parsing = True
        self._autopilot_component = common.MAV_COMP_ID_AUTOPILOT1
        self._vehicle = vehicle
        self._local_s = -math.inf
        self.autopilot: int | None = None

    def decode(self, data: bytes, arrival_s: float) -> Iterator[PoseRecord | None]:
        """Decode a datagram or piece of a stream."""
        for message in self._link.parse_buffer(data) or ():
            kind = message.get_type()
            if kind == "BAD_DATA":
                yield None
                continue
            if message.get_srcComponent() != self._autopilot_component:
                continue
            system = message.get_srcSystem()
            if self.autopilot is None:
                self.autopilot = system
            if system != self.autopilot or kind not in _READERS:
                continue
            if kind == "GLOBAL_POSITION_INT" and arrival_s - self._local_s < LOCAL_S:
                continue  # the local one is finer
            record = self._read(message)
            if kind == "LOCAL_POSITION_NED" and record is not None:
                self._local_s = arrival_s
            yield record

    def _read(self, message: Any) -> PoseRecord | None:  # noqa: ANN401 of pymavlink
        """Read one message; None if its numbers are not those of a vehicle."""
        try:
            with np.errstate(invalid="ignore"):  # inf is checked afterwards
                record = _READERS[message.get_type()](message, self._vehicle)
        except MALFORMED:
            return None
        return record if _is_plausible(record) else None

    def interval_requests(self, period_us: int) -> bytes:
        """Ask for position and attitude at a period, by MAV_CMD_SET_MESSAGE_INTERVAL."""
        from pymavlink.dialects.v20 import common  # noqa: PLC0415 as above

        sender = common.MAVLink(None, srcSystem=255, srcComponent=common.MAV_COMP_ID_SYSTEM_CONTROL)
        ids = (
            common.MAVLINK_MSG_ID_ATTITUDE,
            common.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
            common.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
        )
        commands = (
            common.MAVLink_command_long_message(
                self.autopilot or 1,
                self._autopilot_component,
                common.MAV_CMD_SET_MESSAGE_INTERVAL,
                0,
                one,
                period_us,
                0,
                0,
                0,
                0,
                0,
            )
            for one in ids
        )
        return b"".join(bytes(command.pack(sender)) for command in commands)


def _attitude(message: Any, vehicle: Vehicle) -> PoseRecord:  # noqa: ANN401 of pymavlink
    del vehicle
    ned_R_frd = rotation_of(message.roll, message.pitch, message.yaw)  # noqa: N806 frames
    return _turned(message, ned_R_frd)


def _attitude_quaternion(message: Any, vehicle: Vehicle) -> PoseRecord:  # noqa: ANN401
    del vehicle
    quaternion = np.array([message.q1, message.q2, message.q3, message.q4], dtype=np.float64)
    return _turned(message, rotation_of_quaternion(quaternion))


def _turned(message: Any, ned_R_frd: Vector) -> PoseRecord:  # noqa: ANN401, N803
    rates = np.array([message.rollspeed, message.pitchspeed, message.yawspeed])
    return PoseRecord(
        message.time_boot_ms / 1e3,
        rotation=NED_R_ENU @ ned_R_frd @ FRD_R_FLU,
        rates_rps=FRD_R_FLU @ rates,
    )


def _local_position(message: Any, vehicle: Vehicle) -> PoseRecord:  # noqa: ANN401
    del vehicle
    return PoseRecord(
        message.time_boot_ms / 1e3,
        position_m=NED_R_ENU @ np.array([message.x, message.y, message.z]),
        map_mps=NED_R_ENU @ np.array([message.vx, message.vy, message.vz]),
    )


def _global_position(message: Any, vehicle: Vehicle) -> PoseRecord:  # noqa: ANN401
    if message.lat == 0 and message.lon == 0:
        return PoseRecord(message.time_boot_ms / 1e3)  # no fix yet
    north_m, east_m = metres_per_degree(vehicle.latitude_deg)
    position = np.array(
        [
            (message.lon / 1e7 - vehicle.longitude_deg) * east_m,
            (message.lat / 1e7 - vehicle.latitude_deg) * north_m,
            message.relative_alt / 1e3,
        ]
    )
    velocity = np.array([message.vx, message.vy, message.vz]) / 100.0
    return PoseRecord(message.time_boot_ms / 1e3, position_m=position, map_mps=NED_R_ENU @ velocity)


def _odometry(message: Any, vehicle: Vehicle) -> PoseRecord:  # noqa: ANN401
    del vehicle
    quaternion = np.array(message.q, dtype=np.float64)
    rates = np.array([message.rollspeed, message.pitchspeed, message.yawspeed])
    velocity = np.array([message.vx, message.vy, message.vz])
    in_the_map = message.child_frame_id in LOCAL_FRAMES
    if message.frame_id not in LOCAL_FRAMES or not (
        in_the_map or message.child_frame_id in BODY_FRAMES
    ):
        raise ValueError(f"frames {message.frame_id} and {message.child_frame_id} are not read")
    return PoseRecord(
        message.time_usec / 1e6,
        position_m=NED_R_ENU @ np.array([message.x, message.y, message.z]),
        rotation=NED_R_ENU @ rotation_of_quaternion(quaternion) @ FRD_R_FLU,
        map_mps=NED_R_ENU @ velocity if in_the_map else None,
        body_mps=None if in_the_map else FRD_R_FLU @ velocity,
        rates_rps=FRD_R_FLU @ rates,
    )


_READERS: Mapping[str, Callable[[Any, Vehicle], PoseRecord]] = MappingProxyType(
    {
        "ATTITUDE": _attitude,
        "ATTITUDE_QUATERNION": _attitude_quaternion,
        "LOCAL_POSITION_NED": _local_position,
        "GLOBAL_POSITION_INT": _global_position,
        "ODOMETRY": _odometry,
    }
)


class PoseAssembler:
    """Makes a live path of records that state parts of a pose, each at its own time.

    Stamps are carried to the path's clock by the smallest delay of the last seconds. A record that
    is stamped before another of its kind is late. Some late ones in order come from a clock that
    was set back.

    Args:
        path: gets each pose as soon as position and attitude are known.
    """

    def __init__(self, path: LivePath) -> None:
        self._path = path
        self._position: tuple[float, Vector, Vector] | None = None
        self._attitude: tuple[float, Vector, Vector] | None = None
        self._last_s = -math.inf
        self._begin()

    def _begin(self) -> None:
        """Know nothing of the sender's clock."""
        self._newest_s = {"position_m": -math.inf, "rotation": -math.inf}
        self._lates, self._late_s = 0, -math.inf
        self._window_s = -math.inf
        self._delays_s = math.inf, math.inf

    @property
    def is_placed(self) -> bool:
        """Whether position and attitude have come."""
        return self._position is not None and self._attitude is not None

    def take(self, record: PoseRecord, arrival_s: float) -> bool:
        """Add a record.

        Args:
            record: all of its numbers are finite.
            arrival_s: on the path's clock.

        Returns:
            False if it is late, and ignored.
        """
        time_s = arrival_s
        stamp_s = record.stamp_s
        if stamp_s is not None:
            on_time = self._on_time(record, stamp_s)
            if on_time is None:
                return False
            record = on_time
            time_s = stamp_s + self._offset(stamp_s, arrival_s)
        if record.rotation is not None:
            rates = np.zeros(3) if record.rates_rps is None else record.rates_rps
            self._attitude = time_s, record.rotation, rates
        if record.position_m is not None:
            self._position = time_s, record.position_m, self._map_velocity(record, time_s)
        if self.is_placed:
            self._publish(time_s)
        return True

    def _on_time(self, record: PoseRecord, stamp_s: float) -> PoseRecord | None:
        """Return what of a record is newer than what is known; None if nothing is."""
        parts = {"position_m": record.position_m, "rotation": record.rotation}
        stated = [name for name, value in parts.items() if value is not None]
        late = [name for name in stated if stamp_s < self._newest_s[name]]
        if stated and late == stated:
            self._lates = self._lates + 1 if stamp_s > self._late_s else 1
            self._late_s = stamp_s
            age_s = max(self._newest_s[name] for name in late) - stamp_s
            if self._lates < (2 if age_s > MAX_GAP_S else LATES_OF_A_CLOCK):
                return None
            self._begin()  # its clock was set back
            late = []
        self._lates = 0
        self._newest_s.update({name: stamp_s for name in stated if name not in late})
        return replace(record, **dict.fromkeys(late)) if late else record

    def _offset(self, stamp_s: float, arrival_s: float) -> float:
        """Return what carries the sender's clock to the path's."""
        now_s, before_s = self._delays_s
        passed_s = arrival_s - self._window_s
        if passed_s > DELAY_WINDOW_S:
            before_s = now_s if passed_s <= 2.0 * DELAY_WINDOW_S else math.inf
            now_s, self._window_s = math.inf, arrival_s
        self._delays_s = min(now_s, arrival_s - stamp_s), before_s
        return min(self._delays_s)

    def _map_velocity(self, record: PoseRecord, time_s: float) -> Vector:
        """Return the stated velocity, else that from the last position if it did not jump."""
        if record.map_mps is not None:
            return record.map_mps
        if record.body_mps is not None and self._attitude is not None:
            velocity: Vector = self._attitude[1] @ record.body_mps
            return velocity
        if self._position is None or record.position_m is None:
            return np.zeros(3)
        before_s, before_m, _ = self._position
        passed_s = time_s - before_s
        moved_m = record.position_m - before_m
        if not 0.0 < passed_s < MAX_GAP_S or np.linalg.norm(moved_m) > JUMP_MPS * passed_s:
            return np.zeros(3)
        return np.asarray(moved_m / passed_s)

    def _publish(self, time_s: float) -> None:
        """Join the newest position and attitude, each carried to one time."""
        assert self._position is not None  # noqa: S101 both are known
        assert self._attitude is not None  # noqa: S101
        at_s = self._last_s = max(time_s, self._last_s)
        placed_s, position_m, map_mps = self._position
        turned_s, rotation, rates_rps = self._attitude
        pose = FramePose(
            position_m + map_mps * min(at_s - placed_s, LOCAL_S),
            rotation @ rotation_by(rates_rps * min(at_s - turned_s, LOCAL_S)),
        )
        # What has not been heard for long is no motion any more.
        map_mps = map_mps if at_s - placed_s <= LOCAL_S else np.zeros(3)
        rates_rps = rates_rps if at_s - turned_s <= LOCAL_S else np.zeros(3)
        leap_m = pose.position_m - self._path.pose(at_s).position_m
        if self._path.updates == 0 or _is_jump(leap_m, at_s - self._path.last_s):
            self._path.jump(at_s, pose)
        self._path.update(at_s, pose, pose.rotation.T @ map_mps, rates_rps)


def _is_jump(moved_m: Vector, passed_s: float) -> bool:
    """Whether a vehicle cannot have moved so far in that time."""
    return float(np.linalg.norm(moved_m)) > JUMP_M + JUMP_MPS * max(passed_s, 0.0)
