"""A ROS 2 bag that is being written: the topics of a mapper."""

import contextlib
import shutil
import sqlite3
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Literal

from numpy.typing import NDArray

from mapperd.config.tree import Config
from mapperd.errors import ExportError
from mapperd.export.cells import Heights, known_cells
from mapperd.export.ros_messages import Messages, Turned
from mapperd.mapping.sonar_map import SonarMap
from mapperd.odometry.fusion import FusedPose

__all__ = ["GRID_TOPIC", "MISSING", "Bag", "Storage", "open_bag"]

Storage = Literal["mcap", "sqlite3"]

MISSING = "rosbags cannot be imported (pip install 'mapperd[ros]')"

GRID_TOPIC = "/map"
"""Where Nav2 looks for one."""

VERSION: Literal[8] = 8
"""Of the bag: releases of ROS from Humble on read it; 9 says services of quality as lists."""


class Bag:
    """Topics by the names of the settings; stamps are Unix nanoseconds.

    Args:
        writer: of rosbags, open.
        config: names of topics and frames.

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
        self._write(self.config.topics.sonar, stamp_ns, message)

    def odometry(self, stamp_ns: int, fused: FusedPose) -> None:
        """The vehicle in the odometry's frame."""
        config = self.config
        message = self._messages.odometry(
            stamp_ns, config.amcl.odom_frame_id, config.frames.base, fused
        )
        self._write(config.topics.odometry, stamp_ns, message)

    def transforms(self, stamp_ns: int, turned: Iterable[Turned], *, static: bool = False) -> None:
        """Frames in other frames; static ones are told to whoever comes later, too."""
        message = self._messages.transforms(stamp_ns, turned)
        self._write("/tf_static" if static else "/tf", stamp_ns, message, keep=static)

    def cloud(self, stamp_ns: int, sonar_map: SonarMap) -> None:
        """The occupied voxels."""
        voxels = sonar_map.voxels("occupied")
        message = self._messages.cloud(stamp_ns, self.config.frames.map, voxels)
        self._write(self.config.topics.pointcloud, stamp_ns, message, keep=True)

    def grid(self, stamp_ns: int, sonar_map: SonarMap) -> None:
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
        raise ExportError(MISSING) from None
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
    """Reliable; what is kept is told to whoever comes later: maps and static transforms."""
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
