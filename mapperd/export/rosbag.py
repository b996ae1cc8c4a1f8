"""ROS 2 bags of a mapper's topics, written without ROS.

Messages of ROS 2, by the definitions that rosbags brings: no ROS is installed.

ROS has our axes (REP-103: east, north, up; forward, left, up), but quaternions x, y, z, w.
"""

import contextlib
import shutil
import sqlite3
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import Config
from mapperd.errors import ExportError, ExportExtraError, missing_extra
from mapperd.export.cells import FREE, OCCUPIED, UNKNOWN, GridLayer, Heights, known_cells
from mapperd.export.clouds import POINT
from mapperd.geometry.frames import Pose, quaternion_to_matrix
from mapperd.mapping.queries import MapContent, VoxelCloud
from mapperd.odometry.fusion import FusedPose

__all__ = ["GRID_TOPIC", "Bag", "Messages", "Storage", "Turned", "open_bag"]

NOBODY_KNOWS = 1e6
"""Variance of unknown values; zero would mean exact."""

ENCODINGS = {1: "mono8", 2: "mono16", 4: "32SC1"}
"""Encoding of an image by the bytes of a sample."""

POINT_TYPES = {"u1": 2, "u2": 4, "f4": 7}
"""Datatypes of PointField."""

_OCCUPANCY = np.zeros(3, np.int8)
_OCCUPANCY[[UNKNOWN, FREE, OCCUPIED]] = -1, 0, 100


@dataclass(frozen=True, slots=True)
class Turned:
    """A frame in another one: its pose there."""

    frame: str
    child: str
    pose: Pose


class Messages:
    """Makes messages of one kind of ROS.

    Args:
        types: class by name, as a type store of rosbags has them.
    """

    def __init__(self, types: dict[str, Any]) -> None:
        self._types = types

    def image(self, stamp_ns: int, frame: str, image: NDArray[Any]) -> Any:  # noqa: ANN401 made at run time
        """sensor_msgs/Image of samples (rows, beams), as they are."""
        data = np.ascontiguousarray(image, dtype=image.dtype.newbyteorder("<"))
        return self._of(
            "sensor_msgs/msg/Image",
            header=self._header(stamp_ns, frame),
            height=image.shape[0],
            width=image.shape[1],
            encoding=ENCODINGS[image.dtype.itemsize],
            is_bigendian=0,
            step=image.shape[1] * image.dtype.itemsize,
            data=data.reshape(-1).view(np.uint8),
        )

    def odometry(self, stamp_ns: int, frame: str, child: str, fused: FusedPose) -> Any:  # noqa: ANN401
        """nav_msgs/Odometry: the pose in `frame`, the twist in `child`, as REP-103 has it."""
        to_base = quaternion_to_matrix(fused.pose.map_q_base).T
        linear = None if fused.velocity_mps is None else to_base @ fused.velocity_mps
        return self._of(
            "nav_msgs/msg/Odometry",
            header=self._header(stamp_ns, frame),
            child_frame_id=child,
            pose=self._of(
                "geometry_msgs/msg/PoseWithCovariance",
                pose=self._pose(fused.pose),
                covariance=np.ascontiguousarray(fused.covariance, np.float64).reshape(-1),
            ),
            twist=self._of(
                "geometry_msgs/msg/TwistWithCovariance",
                twist=self._of(
                    "geometry_msgs/msg/Twist",
                    linear=self._vector(np.zeros(3) if linear is None else linear),
                    angular=self._vector(
                        np.zeros(3) if fused.rate_radps is None else fused.rate_radps
                    ),
                ),
                covariance=np.diag(np.full(6, NOBODY_KNOWS)).reshape(-1),
            ),
        )

    def transforms(self, stamp_ns: int, turned: Iterable[Turned]) -> Any:  # noqa: ANN401
        """tf2_msgs/TFMessage."""
        return self._of(
            "tf2_msgs/msg/TFMessage",
            transforms=[
                self._of(
                    "geometry_msgs/msg/TransformStamped",
                    header=self._header(stamp_ns, each.frame),
                    child_frame_id=each.child,
                    transform=self._of(
                        "geometry_msgs/msg/Transform",
                        translation=self._vector(each.pose.position_m),
                        rotation=self._quaternion(each.pose),
                    ),
                )
                for each in turned
            ],
        )

    def cloud(self, stamp_ns: int, frame: str, voxels: VoxelCloud) -> Any:  # noqa: ANN401
        """sensor_msgs/PointCloud2: voxel centres, `intensity` is the probability, and `count`."""
        points = np.empty(len(voxels), POINT)
        begin = 0
        for some in voxels.batches():
            part = points[begin : begin + len(some)]
            for axis, name in enumerate("xyz"):
                part[name] = some.centres_m[:, axis]
            part["intensity"] = some.probability
            part["count"] = some.count
            begin += len(some)
        return self.points(stamp_ns, frame, points)

    def points(self, stamp_ns: int, frame: str, rows: NDArray[np.void]) -> Any:  # noqa: ANN401
        """sensor_msgs/PointCloud2 of a packed structured array, little endian."""
        kind = rows.dtype
        fields = [
            self._of(
                "sensor_msgs/msg/PointField",
                name=name,
                offset=offset,
                datatype=POINT_TYPES[field.str[1:]],
                count=1,
            )
            for name, (field, offset, *_) in (kind.fields or {}).items()
        ]
        return self._of(
            "sensor_msgs/msg/PointCloud2",
            header=self._header(stamp_ns, frame),
            height=1,
            width=len(rows),
            fields=fields,
            is_bigendian=False,
            point_step=kind.itemsize,
            row_step=kind.itemsize * len(rows),
            data=rows.view(np.uint8),
            is_dense=True,
        )

    def grid(self, stamp_ns: int, frame: str, cells: GridLayer, resolution_m: float) -> Any:  # noqa: ANN401
        """nav_msgs/OccupancyGrid: 0 free, 100 occupied, -1 unknown; its origin is the corner."""
        window = cells.window
        corner = Pose(
            np.array([window.x * resolution_m, window.y * resolution_m, 0.0]), np.eye(4)[0]
        )
        return self._of(
            "nav_msgs/msg/OccupancyGrid",
            header=self._header(stamp_ns, frame),
            info=self._of(
                "nav_msgs/msg/MapMetaData",
                map_load_time=self._time(stamp_ns),
                resolution=resolution_m,
                width=window.width,
                height=window.height,
                origin=self._pose(corner),
            ),
            data=_OCCUPANCY[cells.values.astype(np.intp)].reshape(-1),
        )

    def _pose(self, pose: Pose) -> Any:  # noqa: ANN401
        x, y, z = pose.position_m.tolist()
        return self._of(
            "geometry_msgs/msg/Pose",
            position=self._of("geometry_msgs/msg/Point", x=x, y=y, z=z),
            orientation=self._quaternion(pose),
        )

    def _quaternion(self, pose: Pose) -> Any:  # noqa: ANN401
        w, x, y, z = pose.map_q_base.tolist()
        return self._of("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def _vector(self, values: NDArray[np.float64]) -> Any:  # noqa: ANN401
        x, y, z = values.tolist()
        return self._of("geometry_msgs/msg/Vector3", x=x, y=y, z=z)

    def _header(self, stamp_ns: int, frame: str) -> Any:  # noqa: ANN401
        return self._of("std_msgs/msg/Header", stamp=self._time(stamp_ns), frame_id=frame)

    def _time(self, stamp_ns: int) -> Any:  # noqa: ANN401
        seconds, rest = divmod(stamp_ns, 10**9)
        return self._of("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)

    def _of(self, kind: str, **fields: object) -> Any:  # noqa: ANN401
        return self._types[kind](**fields)


Storage = Literal["mcap", "sqlite3"]

SONAR_TOPIC = "/sensor/sonar/oculus/m750d/image"
ODOMETRY_TOPIC = "/fast_lio/odometry"
CLOUD_TOPIC = "/sonar_3d_map"
"""Names of the ROS node that mapperd replaces."""

GRID_TOPIC = "/map"
"""Where Nav2 looks for one."""

VERSION: Literal[8] = 8
"""Version of the bag: readable from ROS 2 Humble on; version 9 stores QoS as lists."""


class Bag:
    """Messages by topic; stamps are Unix nanoseconds.

    Args:
        writer: of rosbags, open.
        config: names of frames.

    Attributes:
        config: as given.
        counts: topic to messages.
    """

    def __init__(self, writer: Any, config: Config) -> None:  # noqa: ANN401 an extra
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415

        self.config = config
        self.counts: dict[str, int] = {}
        self._writer = writer
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        self._messages = Messages(dict(self._store.types))
        self._connections: dict[str, Any] = {}

    def image(self, stamp_ns: int, image: NDArray[Any]) -> None:
        """A ping's image."""
        message = self._messages.image(stamp_ns, self.config.frames.sonar, image)
        self._write(SONAR_TOPIC, stamp_ns, message)

    def odometry(self, stamp_ns: int, fused: FusedPose) -> None:
        """The vehicle in the odometry's frame."""
        config = self.config
        message = self._messages.odometry(
            stamp_ns, config.amcl.odom_frame_id, config.frames.base, fused
        )
        self._write(ODOMETRY_TOPIC, stamp_ns, message)

    def transforms(self, stamp_ns: int, turned: Iterable[Turned], *, static: bool = False) -> None:
        """Write transforms; static ones are latched."""
        message = self._messages.transforms(stamp_ns, turned)
        self._write("/tf_static" if static else "/tf", stamp_ns, message, keep=static)

    def cloud(self, stamp_ns: int, sonar_map: MapContent) -> None:
        """The occupied voxels."""
        voxels = sonar_map.occupied()
        message = self._messages.cloud(stamp_ns, self.config.frames.map, voxels)
        self._write(CLOUD_TOPIC, stamp_ns, message, keep=True)

    def grid(self, stamp_ns: int, sonar_map: MapContent) -> None:
        """The map from above, between the heights of the settings; nothing of an empty one.

        Raises:
            ExportError: it is too large.
        """
        export = sonar_map.config.export
        cells = known_cells(sonar_map, Heights(export.min_z, export.max_z))
        if cells is None:
            return
        message = self._messages.grid(
            stamp_ns, self.config.frames.map, cells, sonar_map.resolution_m
        )
        self._write(GRID_TOPIC, stamp_ns, message, keep=True)

    def _write(self, topic: str, stamp_ns: int, message: Any, *, keep: bool = False) -> None:  # noqa: ANN401
        kind = message.__msgtype__
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, kind, typestore=self._store, offered_qos_profiles=[_quality(keep=keep)]
            )
        data = self._store.serialize_cdr(message, kind)
        self._writer.write(self._connections[topic], stamp_ns, data)
        self.counts[topic] = self.counts.get(topic, 0) + 1


@contextlib.contextmanager
def open_bag(path: Path, config: Config, storage: Storage) -> Iterator[Bag]:
    """Write a bag, a folder, that takes its place only when all went well.

    Raises:
        ExportError: the library is not there, the folder is there already, or it cannot be written.
    """
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer, WriterError  # noqa: PLC0415 an extra
    except ImportError:
        raise ExportExtraError(missing_extra("rosbags", "ros")) from None
    if path.exists():
        raise ExportError(f"{path}: is there already")
    partial = path.with_name(f".{path.name}.partial")
    try:
        shutil.rmtree(partial, ignore_errors=True)  # of somebody who was killed
        partial.mkdir()
        inner = partial / path.name  # files in a bag are named after it
        with Writer(inner, version=VERSION, storage_plugin=StoragePlugin[storage.upper()]) as bag:
            yield Bag(bag, config)
        inner.rename(path)
    except (OSError, sqlite3.Error, WriterError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ExportError(f"{path}: cannot be written: {reason}") from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _quality(*, keep: bool) -> Any:  # noqa: ANN401
    """Reliable QoS; maps and static transforms are transient local."""
    from rosbags import interfaces as ros  # noqa: PLC0415

    endless = ros.QosTime(2147483647, 4294967295)
    return ros.Qos(
        ros.QosHistory.KEEP_LAST,
        1 if keep else 10,
        ros.QosReliability.RELIABLE,
        ros.QosDurability.TRANSIENT_LOCAL if keep else ros.QosDurability.VOLATILE,
        endless,
        endless,
        ros.QosLiveliness.AUTOMATIC,
        endless,
        avoid_ros_namespace_conventions=False,
    )
