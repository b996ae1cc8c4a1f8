"""Sonar data in ROS bags: raw Oculus bytes, and images whose message defines a whole ping.

| message | what is read |
|---|---|
| any with Oculus messages in `uint8[] data`: apl_msgs/RawData, OculusStampedPing | all |
| oculus_interfaces/Ping | bearings, gains, samples, speed of sound |
| marine_acoustic_msgs/ProjectedSonarImage | beams, ranges, samples, speed of sound |

Images become ping messages of the sonar's own format, so all follow the ordinary way.
"""

import io
import itertools
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mapperd.odometry.ros_bag import is_ros_bag, message_time_ns, open_ros_bag, ros_messages
from oculus_driver.encode import encode_ping
from oculus_driver.errors import EncodeError, RecordingError
from oculus_driver.recording import OCULUS, Chunk, Recording, open_recording
from oculus_driver.recording.chunk import Progress
from oculus_driver.wire import HEADER, MAX_MESSAGE_SIZE

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

__all__ = ["ROS_BAG", "RosRecording", "open_source"]

ROS_BAG = "ros-bag"
NS = 10**9
OCULUS_HEAD = b"SO"
"""First bytes of every message of the sonar."""

RECEIVED = 0
"""Direction of apl_msgs/RawData from the sonar."""

RAW, PING, IMAGE = "raw", "Ping", "ProjectedSonarImage"
KINDS = (RAW, PING, IMAGE)
"""Best first: a bag often holds the same pings twice."""

PACKAGES = {PING: ("oculus_interfaces",), IMAGE: ("marine_acoustic_msgs", "acoustic_msgs")}
SAMPLES = {0: "u1", 2: "u2", 4: "u4"}
"""Unsigned types by `SonarImageData.dtype`."""

MAX_ELEVATION = 0.05
"""Of a unit vector out of the fan's plane: 3 degrees."""

SPACING_TOLERANCE = 0.05
"""Of a row: single precision at 300 m and rows of 1 mm."""

MIN_ROWS = 2


def open_source(path: Path) -> Recording:
    """Return the recording in a file, or the sonar data of a ROS bag.

    Raises:
        RecordingError: it is no recording, or a bag without sonar data.
        ConfigError: it is a ROS bag, and the library is not installed.
    """
    try:
        return open_recording(path)
    except RecordingError:
        if not path.exists() or not is_ros_bag(path):
            raise
    try:
        return RosRecording(path)
    except RecordingError as error:
        folder = path.parent
        if path.is_dir() or not is_ros_bag(folder) or not _is_readable(folder):
            raise
        raise RecordingError(f"{error}; pass the bag's folder: {folder}") from error


def _is_readable(bag: Path) -> bool:
    """Return whether a bag has sonar data."""
    try:
        RosRecording(bag)
    except RecordingError:
        return False
    return True


class RosRecording(Recording):
    """The sonar data of a bag, as the sonar's stream.

    Args:
        path: of the folder or file.

    Raises:
        RecordingError: the bag cannot be read, or has no sonar data.
    """

    def __init__(self, path: Path) -> None:
        parts = path.iterdir() if path.is_dir() else [path]
        with open_ros_bag(path) as reader:
            self._topics = _sonar_topics(path, reader)
            self._bag_ns = (reader.start_time, max(reader.end_time, reader.start_time + 1))
        if not self._topics:
            raise RecordingError(
                f"{path}: a ROS bag without sonar data; raw Oculus messages, "
                "oculus_interfaces/Ping and marine_acoustic_msgs/ProjectedSonarImage can be mapped"
            )
        size = sum(part.stat().st_size for part in parts)
        super().__init__(path, ROS_BAG, io.BytesIO(), size)

    def _chunks(self, progress: Progress) -> Iterator[Chunk]:
        start_ns, end_ns = self._bag_ns
        links = {
            topic: "sonar" if k == 0 else f"sonar-{k + 1}" for k, topic in enumerate(self._topics)
        }
        numbers = itertools.count(1)
        try:
            with open_ros_bag(self.path) as reader:
                for topic, _, bag_ns, message in ros_messages(self.path, reader, [*links]):
                    done = (bag_ns - start_ns) / (end_ns - start_ns)
                    progress.bytes_read = round(min(max(done, 0.0), 1.0) * self.size_bytes)
                    found = _data_of(self._topics[topic], message, bag_ns, numbers)
                    if isinstance(found, str):
                        progress.report(f"topic {topic}: {found}")
                        continue
                    arrival_ns, data = found
                    progress.note_stamp(arrival_ns)
                    if data:
                        yield Chunk(links[topic], OCULUS, arrival_ns, data)
                progress.bytes_read = self.size_bytes
        except RecordingError as error:
            progress.report_truncation(str(error).removeprefix(f"{self.path}: "))


def _sonar_topics(path: Path, reader: "AnyReader") -> dict[str, str]:
    """Return the topics of the best kind of sonar data, and that kind."""
    found: dict[str, str] = {}
    for topic, info in reader.topics.items():
        package, _, name = (info.msgtype or "").replace("/msg/", "/").partition("/")
        if package in PACKAGES.get(name, ()):
            found[topic] = name
        elif _may_be_raw(reader, info.msgtype or "") and _is_raw(path, reader, topic):
            found[topic] = RAW
    best = next((kind for kind in KINDS if kind in found.values()), None)
    return {topic: kind for topic, kind in found.items() if kind == best}


def _may_be_raw(reader: "AnyReader", kind: str) -> bool:
    """Return whether a type has bytes in `data` or `ping.data`."""
    _, fields = reader.typestore.fielddefs.get(kind, ((), ()))
    names = {name for name, _ in fields}
    return "data" in names or "ping" in names


def _is_raw(path: Path, reader: "AnyReader", topic: str) -> bool:
    """Return whether the first bytes from the sonar in a topic begin a message of it."""
    for _, _, _, message in ros_messages(path, reader, [topic]):
        if data := _raw(message):
            return data.startswith(OCULUS_HEAD) and len(data) >= HEADER.size
    return False


def _raw(message: Any) -> bytes:  # noqa: ANN401 made at run time
    """Return the bytes of a message from the sonar; none of one to it, or of another kind."""
    data = getattr(getattr(message, "ping", message), "data", None)
    if not isinstance(data, np.ndarray) or data.dtype != np.uint8:
        return b""
    return data.tobytes() if getattr(message, "direction", RECEIVED) == RECEIVED else b""


def _data_of(
    kind: str,
    message: Any,  # noqa: ANN401 made at run time
    bag_ns: int,
    numbers: Iterator[int],
) -> tuple[int, bytes] | str:
    """Return arrival and bytes of a message, or why it defines no ping."""
    header = getattr(message, "header", None)
    stamp_ns = bag_ns if header is None else message_time_ns(header, bag_ns)
    if kind == RAW:
        return stamp_ns, _raw(message)
    try:
        if kind == PING:
            data = _encoded_ping(message)
            return stamp_ns, data
        data, flight_s = _encoded_image(message, next(numbers))
    except (EncodeError, ValueError) as error:
        return str(error)
    # Its stamp is that of the transmission; a sonar sends an image after the last echo.
    return stamp_ns + round(flight_s * NS), data


def _encoded_ping(message: Any) -> bytes:  # noqa: ANN401
    """Encode an oculus_interfaces/Ping.

    Raises:
        ValueError: its sizes contradict each other.
    """
    rows, beams, width = message.n_ranges, message.n_beams, message.sample_size
    head = 4 if message.has_gains else 0
    lines = np.asarray(message.ping_data, np.uint8)
    if width not in (1, 2, 4) or lines.size != rows * message.step:
        raise ValueError(f"{lines.size} bytes of data, not {rows} rows of {message.step}")
    if message.step < head + beams * width or len(message.bearings) != beams:
        raise ValueError(f"rows of {message.step} bytes do not hold {beams} beams")
    lines = lines.reshape(rows, message.step)
    samples = np.ascontiguousarray(lines[:, head : head + beams * width]).view(f"<u{width}")
    gains = np.ascontiguousarray(lines[:, :4]).view("<u4").ravel() if head else None
    return encode_ping(
        ping_id=message.ping_id,
        mode=message.master_mode,
        frequency_hz=message.frequency,
        range_m=message.range,
        gain_percent=message.gain_percent,
        speed_of_sound_mps=message.speed_of_sound_used,
        salinity_ppt=math.nan,
        start_time=0.0,
        range_resolution_m=_resolution(message.range_resolution),
        bearings_cdeg=np.asarray(message.bearings, np.int16),
        image=_fitting(samples),
        gains=gains,
        part_number=0,
        temperature_c=message.temperature,
        pressure_bar=message.pressure,
    )


def _encoded_image(message: Any, number: int) -> tuple[bytes, float]:  # noqa: ANN401
    """Encode a ProjectedSonarImage; return it and the time of flight to its end and back, s.

    The message defines the Z axis as ahead and azimuths as rotations about X, which points up.
    Drivers count azimuths to starboard, as the sonar does, and write the samples row by row.

    Raises:
        ValueError: it does not define a ping.
    """
    beams = np.array([(one.x, one.y, one.z) for one in message.beam_directions]).reshape(-1, 3)
    norms = np.linalg.norm(beams, axis=1)
    if not len(beams) or not np.allclose(norms, 1.0, atol=0.01):
        raise ValueError("its beam_directions are not unit vectors")
    if np.abs(beams[:, 0]).max() > MAX_ELEVATION:
        raise ValueError("its beams do not lie in the plane of Y and Z, with Z ahead")
    bearings = np.arctan2(-beams[:, 1], beams[:, 2])
    ranges = np.asarray(message.ranges, np.float64)
    resolution_m = _spacing(ranges)
    image = _samples(message.image, len(ranges), len(beams))
    if bearings[-1] < bearings[0]:
        bearings, image = bearings[::-1], image[:, ::-1]
    speed_mps = float(message.ping_info.sound_speed)
    range_m = resolution_m * len(ranges)
    data = encode_ping(
        ping_id=number,
        mode=1,
        frequency_hz=float(message.ping_info.frequency),
        range_m=range_m,
        gain_percent=math.nan,
        speed_of_sound_mps=speed_mps,
        salinity_ppt=math.nan,
        start_time=0.0,
        range_resolution_m=resolution_m,
        bearings_cdeg=np.round(np.degrees(bearings) * 100).astype(np.int16),
        image=_fitting(image),
        part_number=0,
    )
    return data, 2 * range_m / (speed_mps if speed_mps > 0 else 1500.0)


def _spacing(ranges: NDArray[np.float64]) -> float:
    """Return the distance of rows whose first is centred half of it ahead."""
    if len(ranges) < MIN_ROWS or not np.isfinite(ranges).all():
        raise ValueError("its ranges are not two or more finite numbers")
    resolution_m = _resolution(float(ranges[-1] - ranges[0]) / (len(ranges) - 1))
    even = ranges[0] + resolution_m * np.arange(len(ranges))
    if np.abs(ranges - even).max() > SPACING_TOLERANCE * resolution_m:
        raise ValueError("its ranges are not evenly spaced")
    if abs(ranges[0] - resolution_m / 2) > resolution_m:
        raise ValueError(f"its ranges begin at {ranges[0]:g} m, not at the sonar")
    return resolution_m


def _resolution(metres: float) -> float:
    if not 0 < metres < math.inf:
        raise ValueError(f"its rows are {metres:g} m apart")
    return metres


def _samples(image: Any, rows: int, beams: int) -> NDArray[Any]:  # noqa: ANN401
    if image.dtype not in SAMPLES:
        raise ValueError(f"samples of dtype {image.dtype}; unsigned 8, 16 and 32 bit can be mapped")
    kind = np.dtype((">" if image.is_bigendian else "<") + SAMPLES[image.dtype])
    data = np.asarray(image.data, np.uint8).tobytes()
    if image.beam_count != beams or len(data) != rows * beams * kind.itemsize:
        raise ValueError(f"{len(data)} bytes of data, not {rows} rows of {beams} beams")
    samples = np.frombuffer(data, kind).reshape(rows, beams)
    return samples.astype(kind.newbyteorder("="))


def _fitting(image: NDArray[Any]) -> NDArray[Any]:
    """Return an image that fits into a message."""
    if image.nbytes + 4 * len(image) > MAX_MESSAGE_SIZE // 2:
        raise ValueError(f"an image of {image.nbytes} bytes is larger than any sonar's")
    return image
