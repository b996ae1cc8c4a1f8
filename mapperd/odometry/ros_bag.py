"""Poses in ROS bags: odometry, poses, and transforms; no ROS is needed.

ROS uses the same axes as map and vehicle here (REP-103). Frames whose names end in `_ned` or `_frd`
use those axes instead.
"""

import contextlib
import math
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mapperd.config.tree import Config
from mapperd.errors import ConfigError, missing_extra
from mapperd.geometry.frames import (
    Body,
    Pose,
    World,
    quaternion_product,
    quaternion_to_matrix,
)
from mapperd.odometry.records import MAX_COVARIANCE
from mapperd.odometry.trajectory_files import pose_chunk
from oculus_driver.errors import RecordingError
from oculus_driver.recording import Chunk

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys.store import Typestore

__all__ = ["RosPoses", "is_ros_bag", "message_time_ns", "open_ros_bag", "ros_messages"]

NS = 10**9
POSES = {
    "nav_msgs/msg/Odometry": "pose.pose",
    "geometry_msgs/msg/PoseWithCovarianceStamped": "pose.pose",
    "geometry_msgs/msg/PoseStamped": "pose",
}
"""Message types with a pose, and the path to it."""

TRANSFORMS = "tf2_msgs/msg/TFMessage"
STATIC = "/tf_static"
SUFFIXES = (".mcap", ".db3", ".bag")
MAX_CHAIN = 32
"""Maximum number of transforms between two frames."""

NAMED_TOPICS = 8
HEAD_BYTES = 64


def is_ros_bag(path: Path) -> bool:
    """Return whether a path looks like a ROS bag: a folder of one, or a file by its content."""
    try:
        if path.is_dir():
            return (path / "metadata.yaml").is_file()
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    except OSError:  # the reader reports the cause
        return False
    return path.suffix in SUFFIXES and (
        head.startswith((b"#ROSBAG", b"SQLite format 3\0"))
        or (head.startswith(b"\x89MCAP0\r\n") and b"ros" in head[17:32])
    )


@contextlib.contextmanager
def open_ros_bag(path: Path) -> "Iterator[AnyReader]":
    """Open a bag of ROS 1 or 2.

    Raises:
        ConfigError: the library is not installed.
        RecordingError: the bag is damaged.
    """
    try:
        from rosbags.highlevel import AnyReader  # noqa: PLC0415 an extra
    except ModuleNotFoundError as error:
        raise ConfigError(f"{path}: {missing_extra('rosbags', 'ros')}") from error
    with _explained(path):
        store = None if path.suffix == ".bag" else _default_types()
        reader = AnyReader([path], default_typestore=store)
        reader.open()
    try:
        yield reader
    finally:
        reader.close()


@lru_cache(maxsize=1)
def _default_types() -> "Typestore":
    """Return message types for bags without definitions."""
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415 an extra

    return get_typestore(Stores.ROS2_HUMBLE)


def ros_messages(
    path: Path, reader: "AnyReader", topics: Sequence[str]
) -> Iterator[tuple[str, str, int, Any]]:
    """Yield topic, type, time in ns and content of the messages of some topics, in order.

    Raises:
        RecordingError: the bag is damaged.
    """
    connections = [one for one in reader.connections if one.topic in topics]
    if not connections:
        return
    with _explained(path):
        for connection, stamp_ns, data in reader.messages(connections):
            kind = connection.msgtype
            yield connection.topic, kind, stamp_ns, reader.deserialize(data, kind)


def message_time_ns(header: Any, bag_ns: int) -> int:  # noqa: ANN401 made at run time
    """Return the time of a header; without one, that of the bag."""
    stamp = header.stamp
    return int(stamp.sec) * NS + int(stamp.nanosec) or bag_ns


@contextlib.contextmanager
def _explained(path: Path) -> Iterator[None]:
    """Report damage as one line, whatever the library raises for it."""
    try:
        yield
    except (RecordingError, ConfigError):
        raise
    except Exception as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise RecordingError(f"{path}: cannot be read as a ROS bag: {reason}") from error


class RosPoses:
    """The poses of one topic of a bag, or of its transforms.

    Args:
        path: of the folder or file.
        offset_ns: added to all times.
        topic: of the poses; None selects the only one, else the transforms.
        frames: fixed frame and body frame of the transforms; None selects them by `config`.
        config: names of the frames.

    Attributes:
        path: as given.
        expected: what is read, for people.
    """

    kind = "ROS bag"
    is_finished = True

    def __init__(
        self,
        path: Path,
        offset_ns: int,
        topic: str | None,
        frames: tuple[str, str] | None,
        config: Config,
    ) -> None:
        self.path = path
        self._offset_ns = offset_ns
        self._topic = topic
        self._frames = frames
        self._fixed = (config.amcl.odom_frame_id, config.frames.map)
        self._base = config.frames.base
        wanted = f"from {frames[0]} to {frames[1]}" if frames else f"to {self._base}"
        self.expected = f"poses in {topic}" if topic else f"poses or transforms {wanted}"

    def chunks(self) -> Iterator[Chunk]:
        """Yield the poses in the order of the bag."""
        with open_ros_bag(self.path) as reader:
            types = {name: info.msgtype or "" for name, info in reader.topics.items()}
            topic = self._chosen(types)
            if topic is not None:
                yield from self._poses(reader, topic)
                return
            topics = [name for name, kind in types.items() if kind == TRANSFORMS]
            fixed, body = self._frames or self._found(reader, topics)
            yield from self._transforms(reader, topics, fixed, body)

    def _chosen(self, types: dict[str, str]) -> str | None:
        """Return the topic to read, None for the transforms."""
        found = [name for name, kind in types.items() if kind in POSES]
        if self._topic is not None:
            if types.get(self._topic) == TRANSFORMS:
                return None
            if self._topic not in found:
                raise self._bad(f"has no poses in {self._topic}, but in {_listed(found)}")
            return self._topic
        if self._frames is not None:
            return None
        if len(found) > 1:
            raise self._bad(
                f"has several topics with poses; choose one with --odometry-topic: {_listed(found)}"
            )
        if not found and TRANSFORMS not in types.values():
            raise self._bad(
                "has no odometry: no nav_msgs/Odometry, geometry_msgs/PoseStamped, "
                f"PoseWithCovarianceStamped or tf2_msgs/TFMessage, but {_listed(list(types))}; "
                "give another file with --odometry, or the --pose of a vehicle that stands still"
            )
        return found[0] if found else None

    def _poses(self, reader: "AnyReader", topic: str) -> Iterator[Chunk]:
        for _, kind, bag_ns, message in ros_messages(self.path, reader, [topic]):
            pose = message
            for name in POSES[kind].split("."):
                pose = getattr(pose, name)
            place, turn = pose.position, pose.orientation
            has_covariance = POSES[kind] == "pose.pose"
            yield pose_chunk(
                message_time_ns(message.header, bag_ns) + self._offset_ns,
                (place.x, place.y, place.z),
                (turn.w, turn.x, turn.y, turn.z),
                world=_world(message.header.frame_id),
                body=_body(getattr(message, "child_frame_id", "")),
                covariance=_covariance(message.pose.covariance) if has_covariance else None,
            )

    def _found(self, reader: "AnyReader", topics: Sequence[str]) -> tuple[str, str]:
        """Return the first fixed frame that the vehicle's frame has a transform from."""
        edges: dict[str, str] = {}
        for _, _, _, message in ros_messages(self.path, reader, topics):
            for one in message.transforms:
                edges.setdefault(_plain(one.child_frame_id), _plain(one.header.frame_id))
        above = list(_above(edges, self._base))
        for fixed in self._fixed:
            if fixed in above:
                return fixed, self._base
        pairs = [f"{parent} {child}" for child, parent in edges.items()]
        raise self._bad(
            f"has no transforms from {' or '.join(self._fixed)} to {self._base}; choose two frames "
            f"with --odometry-frames, such as {_listed(pairs)}"
        )

    def _transforms(
        self, reader: "AnyReader", topics: Sequence[str], fixed: str, body: str
    ) -> Iterator[Chunk]:
        """Yield the body in the fixed frame at each message of the nearest moving transform."""
        edges: dict[str, str] = {}
        poses: dict[str, Pose] = {}
        still: set[str] = set()
        last_ns: int | None = None
        for topic, _, bag_ns, message in ros_messages(self.path, reader, topics):
            for one in message.transforms:
                child, pose = _plain(one.child_frame_id), _pose_of(one.transform)
                if pose is None:
                    continue
                edges[child], poses[child] = _plain(one.header.frame_id), pose
                if topic == STATIC:
                    still.add(child)
                chain = [body, *_above(edges, body)]
                if fixed not in chain:
                    continue
                chain = chain[: chain.index(fixed)]
                moving = next((link for link in chain if link not in still), body)
                stamp_ns = message_time_ns(one.header, bag_ns)
                if child != moving or (last_ns is not None and stamp_ns <= last_ns):
                    continue
                last_ns = stamp_ns
                whole = _chained([poses[link] for link in reversed(chain)])
                yield pose_chunk(
                    stamp_ns + self._offset_ns,
                    whole.position_m.tolist(),
                    whole.map_q_base.tolist(),
                    world=_world(fixed),
                    body=_body(body),
                )

    def _bad(self, problem: str) -> RecordingError:
        return RecordingError(f"{self.path}: {problem}")


def _listed(names: Sequence[str]) -> str:
    more = ", …" if len(names) > NAMED_TOPICS else ""
    return (", ".join(names[:NAMED_TOPICS]) or "nothing") + more


def _plain(frame: str) -> str:
    return frame.removeprefix("/")


def _above(edges: dict[str, str], frame: str) -> Iterator[str]:
    """Yield the frames above a frame, nearest first."""
    for _ in range(MAX_CHAIN):
        parent = edges.get(frame)
        if parent is None:
            return
        yield parent
        frame = parent


def _pose_of(transform: Any) -> Pose | None:  # noqa: ANN401 made at run time
    """Return a transform as the pose of the child; None if it is not a rigid transform."""
    place, turn = transform.translation, transform.rotation
    wxyz = np.array([turn.w, turn.x, turn.y, turn.z])
    norm = math.hypot(*wxyz.tolist())
    if not 0.99 <= norm <= 1.01:  # noqa: PLR2004 as of other poses
        return None
    try:
        return Pose(np.array([place.x, place.y, place.z]), wxyz / norm)
    except ValueError:
        return None


def _chained(poses: Sequence[Pose]) -> Pose:
    """Return the last frame of a chain in the parent of the first."""
    whole = poses[0]
    for pose in poses[1:]:
        turn = quaternion_product(whole.map_q_base, pose.map_q_base)
        place = whole.position_m + quaternion_to_matrix(whole.map_q_base) @ pose.position_m
        whole = Pose(place, turn / np.linalg.norm(turn))
    return whole


def _world(frame: str) -> World:
    return "ned" if frame.endswith("_ned") else "enu"


def _body(frame: str) -> Body:
    return "frd" if frame.endswith("_frd") else "flu"


def _covariance(values: Sequence[float]) -> list[float] | None:
    """Return the upper triangle of a covariance (36,); None if unknown or invalid."""
    matrix = np.asarray(values, np.float64).reshape(6, 6)
    diagonal = np.diag(matrix)
    if not np.isfinite(matrix).all() or diagonal.min() <= 0 or diagonal.max() > MAX_COVARIANCE:
        return None
    triangle: list[float] = matrix[np.triu_indices(6)].tolist()
    return triangle
