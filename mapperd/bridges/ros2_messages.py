"""ROS 2 messages of the state of a map stream.

Names, frames and meanings follow REP-103, REP-105 and Nav2. Stamps are the daemon's.
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapperd.bridges.vehicle import VehiclePose
from mapperd.client.validation import bearings_of
from mapperd.export.rosbag import NOBODY_KNOWS, Messages
from mapperd.geometry.frames import Pose
from mapperd.odometry.fusion import FusedPose
from mapperd.wire.messages import FanMessage, ImageMessage, LocalizationMessage, ReturnsMessage

__all__ = ["MARKER_CHANGE", "LiveMessages", "parameter_type", "plain_parameter", "planar_pose"]

Floats = NDArray[np.float64]

PLANAR = np.ix_([0, 1, 5], [0, 1, 5])
RETURN = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "u1")])

OK, WARN, ERROR, STALE = 0, 1, 2, 3
"""Levels of DiagnosticStatus."""

LOG_LEVELS = {"debug": 10, "info": 20, "notice": 20, "warning": 30, "error": 40}
"""Levels of rcl_interfaces/Log by severity."""

CUBE, SPHERE = 1, 2
ADD, DELETE_ALL = 0, 3
"""Kinds and actions of Marker."""

MARKER_CHANGE: Mapping[str, tuple[float, float, float, float]] = {
    "appeared": (0.1, 0.8, 0.2, 0.4),
    "vanished": (0.9, 0.2, 0.1, 0.4),
}
"""Colour of the box of a change, by its kind."""

ROBOT_M, ROBOT_COLOUR = 0.5, (1.0, 0.3, 0.3, 0.8)
NS = 1_000_000_000


class LiveMessages(Messages):
    """Makes the messages of a bridge, of the classes of `RosTypes`."""

    def __init__(self, types: dict[str, Any]) -> None:
        super().__init__(types)
        self._directions_of: tuple[bytes, list[Any]] = b"", []

    def ping(
        self,
        image: ImageMessage,
        pixels: NDArray[np.uint8],
        frame: str,
        fan: FanMessage | None,
        sound_speed_mps: float,
    ) -> Any:  # noqa: ANN401 made at run time
        """marine_acoustic_msgs/ProjectedSonarImage; beams point along x of the frame.

        Args:
            image: of the ping.
            pixels: (rows, beams).
            frame: of the sonar.
            fan: has the vertical aperture.
            sound_speed_mps: 0 if unknown.
        """
        bearings = bearings_of(image)
        aperture = [] if fan is None else [fan.vertical_aperture_rad] * len(bearings)
        ranges_m = (np.arange(image.rows) + 0.5) * image.range_resolution_m
        return self._of(
            "marine_acoustic_msgs/msg/ProjectedSonarImage",
            header=self._header(image.stamp_ns, frame),
            ping_info=self._of(
                "marine_acoustic_msgs/msg/PingInfo",
                frequency=0.0,
                sound_speed=sound_speed_mps,
                tx_beamwidths=np.array(aperture, np.float32),
                rx_beamwidths=np.zeros(0, np.float32),
            ),
            beam_directions=self._directions(image.bearings_rad, bearings),
            ranges=ranges_m.astype(np.float32),
            image=self._of(
                "marine_acoustic_msgs/msg/SonarImageData",
                is_bigendian=False,
                dtype=0,
                beam_count=image.beams,
                data=np.ascontiguousarray(pixels).reshape(-1),
            ),
        )

    def _directions(self, key: bytes, bearings_rad: Floats) -> list[Any]:
        """Return a vector for each beam; the last ones are kept, as most pings have the same."""
        if key != self._directions_of[0]:
            zeros = np.zeros(len(bearings_rad))
            vectors = np.stack([np.cos(bearings_rad), -np.sin(bearings_rad), zeros], axis=1)
            self._directions_of = key, [self._vector(one) for one in vectors]
        return self._directions_of[1]

    def returns(self, returns: ReturnsMessage, frame: str) -> Any:  # noqa: ANN401
        """sensor_msgs/PointCloud2 of the first returns of a ping, in the sonar's frame."""
        points = np.frombuffer(returns.points, "<f4").reshape(-1, 3)
        rows = np.empty(len(points), RETURN)
        rows["x"], rows["y"], rows["z"] = points.T
        rows["intensity"] = np.frombuffer(returns.intensities, np.uint8)
        return self.points(returns.stamp_ns, frame, rows)

    def vehicle_odometry(self, located: VehiclePose, frame: str, child: str) -> Any:  # noqa: ANN401
        """nav_msgs/Odometry: the pose in the odometry's frame, the twist in the base."""
        covariance = located.covariance
        if covariance is None:
            covariance = np.diag(np.full(6, NOBODY_KNOWS))
        fused = FusedPose(located.pose, located.velocity_mps, None, covariance, 0, 0.0)
        return self.odometry(located.stamp_ns, frame, child, fused)

    def estimate(
        self, stamp_ns: int, frame: str, mean: Floats, covariance: Floats, height_m: float
    ) -> Any:  # noqa: ANN401
        """geometry_msgs/PoseWithCovarianceStamped of (x, y, yaw) and its covariance (3, 3)."""
        whole = np.zeros((6, 6))
        whole[PLANAR] = covariance
        x_m, y_m, yaw_rad = mean.tolist()
        return self._of(
            "geometry_msgs/msg/PoseWithCovarianceStamped",
            header=self._header(stamp_ns, frame),
            pose=self._of(
                "geometry_msgs/msg/PoseWithCovariance",
                pose=self._pose(planar_pose(x_m, y_m, yaw_rad, height_m)),
                covariance=whole.reshape(-1),
            ),
        )

    def particles(
        self, state: LocalizationMessage, stamp_ns: int, frame: str, height_m: float
    ) -> tuple[tuple[Any, Floats], tuple[Any, Floats]]:
        """geometry_msgs/PoseArray and nav2_msgs/ParticleCloud of the particles.

        Each comes without elements, and with those as the rows that `DdsPublisher.publish` takes.
        """
        x_m, y_m, yaw_rad, weight = (
            np.frombuffer(state.particles, "<f4").reshape(-1, 4).astype(np.float64).T
        )
        zero = np.zeros_like(x_m)
        turns = (zero, zero, np.sin(yaw_rad / 2), np.cos(yaw_rad / 2))
        rows = np.stack([x_m, y_m, zero + height_m, *turns, weight], axis=1)
        header = self._header(stamp_ns, frame)
        array = self._of("geometry_msgs/msg/PoseArray", header=header, poses=[])
        cloud = self._of("nav2_msgs/msg/ParticleCloud", header=header, particles=[])
        return (array, rows[:, :-1]), (cloud, rows)

    def diagnostics(self, stamp_ns: int, statuses: Sequence[Any]) -> Any:  # noqa: ANN401
        """diagnostic_msgs/DiagnosticArray of `diagnostic` statuses."""
        return self._of(
            "diagnostic_msgs/msg/DiagnosticArray",
            header=self._header(stamp_ns, ""),
            status=list(statuses),
        )

    def diagnostic(
        self, level: int, name: str, text: str, hardware: str, values: Mapping[str, object]
    ) -> Any:  # noqa: ANN401
        """diagnostic_msgs/DiagnosticStatus."""
        return self._of(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=level,
            name=name,
            message=text,
            hardware_id=hardware,
            values=[
                self._of("diagnostic_msgs/msg/KeyValue", key=key, value=str(value))
                for key, value in values.items()
            ],
        )

    def log(self, stamp_ns: int, severity: str, name: str, text: str) -> Any:  # noqa: ANN401
        """rcl_interfaces/Log."""
        return self._of(
            "rcl_interfaces/msg/Log",
            stamp=self._time(stamp_ns),
            level=LOG_LEVELS.get(severity, 20),
            name=name,
            msg=text,
            file="",
            function="",
            line=0,
        )

    def markers(
        self,
        stamp_ns: int,
        frame: str,
        robots_m: Iterable[Sequence[float]],
        changes: Iterable[Mapping[str, Any]],
    ) -> Any:  # noqa: ANN401
        """visualization_msgs/MarkerArray of robots and changes; it replaces all earlier ones.

        Args:
            stamp_ns: Unix time.
            frame: of the served map.
            robots_m: positions of other robots.
            changes: of the daemon's status, with `kind`, `low_m` and `high_m`.
        """
        markers = [self._marker(stamp_ns, frame, action=DELETE_ALL)]
        for number, place in enumerate(robots_m):
            pose = Pose(np.asarray(place, np.float64), np.eye(4)[0])
            markers.append(
                self._marker(
                    stamp_ns,
                    frame,
                    group="robots",
                    number=number,
                    kind=SPHERE,
                    pose=pose,
                    size_m=np.full(3, ROBOT_M),
                    colour=ROBOT_COLOUR,
                )
            )
        for number, change in enumerate(changes):
            low, high = (np.asarray(change[name], np.float64) for name in ("low_m", "high_m"))
            code = str(change["kind"])
            pose = Pose((low + high) / 2, np.eye(4)[0])
            markers.append(
                self._marker(
                    stamp_ns,
                    frame,
                    group=code,
                    number=number,
                    pose=pose,
                    size_m=high - low,
                    colour=MARKER_CHANGE[code],
                )
            )
        return self._of("visualization_msgs/msg/MarkerArray", markers=markers)

    def _marker(
        self,
        stamp_ns: int,
        frame: str,
        *,
        group: str = "",
        number: int = 0,
        action: int = ADD,
        kind: int = CUBE,
        pose: Pose | None = None,
        size_m: Floats | None = None,
        colour: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0),
    ) -> Any:  # noqa: ANN401
        red, green, blue, alpha = colour
        return self._of(
            "visualization_msgs/msg/Marker",
            header=self._header(stamp_ns, frame),
            ns=group,
            id=number,
            type=kind,
            action=action,
            pose=self._pose(pose or Pose(np.zeros(3), np.eye(4)[0])),
            scale=self._vector(np.zeros(3) if size_m is None else size_m),
            color=self._of("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=alpha),
            lifetime=self._of("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
            frame_locked=False,
            points=[],
            colors=[],
            texture_resource="",
            texture=self._of(
                "sensor_msgs/msg/CompressedImage",
                header=self._header(0, ""),
                format="",
                data=np.zeros(0, np.uint8),
            ),
            uv_coordinates=[],
            text="",
            mesh_resource="",
            mesh_file=self._of(
                "visualization_msgs/msg/MeshFile", filename="", data=np.zeros(0, np.uint8)
            ),
            mesh_use_embedded_materials=False,
        )

    def parameter(self, value: object) -> Any:  # noqa: ANN401
        """rcl_interfaces/ParameterValue of a setting; tables are JSON text."""
        kind, field, plain = parameter_type(value)
        fields: dict[str, Any] = {
            "type": kind,
            "bool_value": False,
            "integer_value": 0,
            "double_value": 0.0,
            "string_value": "",
            "byte_array_value": np.zeros(0, np.uint8),
            "bool_array_value": np.zeros(0, np.bool_),
            "integer_array_value": np.zeros(0, np.int64),
            "double_array_value": np.zeros(0, np.float64),
            "string_array_value": [],
        }
        if field:
            fields[field] = plain
        return self._of("rcl_interfaces/msg/ParameterValue", **fields)

    def descriptor(self, name: str, fact: Mapping[str, Any]) -> Any:  # noqa: ANN401
        """rcl_interfaces/ParameterDescriptor of the facts of a setting."""
        unit = f" [{fact['unit']}]" if fact.get("unit") else ""
        return self._of(
            "rcl_interfaces/msg/ParameterDescriptor",
            name=name,
            type=parameter_type(fact.get("value"))[0],
            description=f"{fact.get('description', '')}{unit}",
            additional_constraints=str(fact.get("allowed", "")),
            read_only=not fact.get("dynamic", False),
            dynamic_typing=False,
            floating_point_range=[],
            integer_range=[],
        )

    def parameter_list(self, names: Sequence[str], prefixes: Sequence[str]) -> Any:  # noqa: ANN401
        """rcl_interfaces/ListParametersResult."""
        return self._of(
            "rcl_interfaces/msg/ListParametersResult", names=list(names), prefixes=list(prefixes)
        )

    def set_result(self, reason: str) -> Any:  # noqa: ANN401
        """rcl_interfaces/SetParametersResult; an empty reason is success."""
        return self._of(
            "rcl_interfaces/msg/SetParametersResult", successful=not reason, reason=reason
        )

    def no_grid(self) -> Any:  # noqa: ANN401
        """nav_msgs/OccupancyGrid of one unknown cell: readers refuse one without cells."""
        return self._of(
            "nav_msgs/msg/OccupancyGrid",
            header=self._header(0, ""),
            info=self._of(
                "nav_msgs/msg/MapMetaData",
                map_load_time=self._time(0),
                resolution=1.0,
                width=1,
                height=1,
                origin=self._pose(Pose(np.zeros(3), np.eye(4)[0])),
            ),
            data=np.full(1, -1, np.int8),
        )


def planar_pose(x_m: float, y_m: float, yaw_rad: float, height_m: float = 0.0) -> Pose:
    """Return a level pose."""
    turn = np.array([math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2)])
    return Pose(np.array([x_m, y_m, height_m]), turn)


def parameter_type(value: object) -> tuple[int, str, Any]:
    """Return number, field and content of a ParameterValue for a plain value."""
    if value is None:
        return 0, "", None
    scalars: tuple[tuple[type, int, str], ...] = (
        (bool, 1, "bool_value"),
        (int, 2, "integer_value"),
        (float, 3, "double_value"),
        (str, 4, "string_value"),
    )
    for kind, number, field in scalars:
        if isinstance(value, kind):
            return number, field, value
    if isinstance(value, list) and value:
        if all(isinstance(one, str) for one in value):
            return 9, "string_array_value", value
        if all(isinstance(one, int | float) and not isinstance(one, bool) for one in value):
            return 8, "double_array_value", np.array(value, np.float64)
    return 4, "string_value", json.dumps(value)


def plain_parameter(value: Any) -> object:  # noqa: ANN401 a ParameterValue
    """Return the plain value of a ParameterValue; None if it is not set."""
    fields = {
        1: "bool_value",
        2: "integer_value",
        3: "double_value",
        4: "string_value",
        6: "bool_array_value",
        7: "integer_array_value",
        8: "double_array_value",
        9: "string_array_value",
    }
    field = fields.get(value.type)
    if field is None:
        return None
    found = getattr(value, field)
    return found.tolist() if isinstance(found, np.ndarray) else found
