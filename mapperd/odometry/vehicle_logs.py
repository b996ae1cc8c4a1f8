"""Logs of a vehicle: ArduPilot's .tlog and .BIN, network captures, and other recordings.

Logs of links (.tlog, captures, recordings) hold the bytes of the vehicle, which the decoder of
their format reads. The log of the autopilot (.BIN) holds poses of its estimator.
"""

import contextlib
import io
import math
import mmap
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from mapperd.config.odometry import OdometrySourceConfig, parse_address
from mapperd.config.tree import Config
from mapperd.errors import ConfigError, missing_extra
from mapperd.geometry.frames import compass_quaternion
from mapperd.geometry.geodesy import Origin
from mapperd.odometry.bridge import ENCODING_PREFIX, encoding_of
from mapperd.odometry.formats import make_decoder
from mapperd.odometry.trajectory_files import FINISHED, pose_chunk
from oculus_driver.errors import RecordingError
from oculus_driver.recording import Chunk, open_recording, read_datagrams

__all__ = ["ArduPilotLog", "CaptureFile", "RecordedOdometry", "TelemetryLog"]

NS = 10**9
MIN_TIME_US, MAX_TIME_US = 10**15, 4 * 10**15
"""Unix time from 2001 to 2096."""

STAMP_BYTES = 8


class TelemetryLog:
    """A .tlog: MAVLink frames that a ground station received, each with its time.

    Args:
        path: of the file.
        offset_ns: added to all times.
        config: its first MAVLink source states the system to follow.

    Attributes:
        path: as given.
        expected: what is read, for people.

    Raises:
        ConfigError: the MAVLink library is not installed.
    """

    kind = "tlog"
    is_finished = False

    def __init__(self, path: Path, offset_ns: int, config: Config) -> None:
        self.path = path
        self._offset_ns = offset_ns
        sources = [source for source in config.odometry.sources if source.format == "mavlink"]
        self._source = sources[0] if sources else OdometrySourceConfig(format="mavlink")
        self._link = self._source.name if sources else "file:mavlink"
        make_decoder(self._source)
        system, component = self._source.mavlink_system_id, self._source.mavlink_component_id
        self.expected = (
            f"navigation messages of MAVLink system {system}, component {component} "
            "(odometry.sources[].mavlink_system_id and mavlink_component_id; 0 accepts all)"
        )

    def chunks(self) -> Iterator[Chunk]:
        """Yield the vehicle's frames with navigation data."""
        from mapperd.odometry.mavlink import navigation_frame  # noqa: PLC0415 an extra

        encoding = encoding_of(self._source)
        with _mapped(self.path) as data:
            for stamp_us, frame in _telemetry(data):
                if navigation_frame(frame, self._source):
                    arrival_ns = stamp_us * 1000 + self._offset_ns
                    yield Chunk(self._link, encoding, arrival_ns, frame)


def _telemetry(data: mmap.mmap) -> Iterator[tuple[int, bytes]]:
    """Yield Unix time in microseconds and bytes of each frame."""
    from mapperd.odometry.mavlink import frame_size  # noqa: PLC0415 an extra

    place, size = 0, len(data)
    while place + STAMP_BYTES < size:
        start = place + STAMP_BYTES
        length = frame_size(data, start)
        if length is None:
            return
        stamp_us = int.from_bytes(data[place:start], "big")
        if not length or start + length > size or not MIN_TIME_US <= stamp_us < MAX_TIME_US:
            place += 1
            continue
        place = start + length
        yield stamp_us, data[start:place]


class ArduPilotLog:
    """A .BIN: the poses of the autopilot's estimator, EKF3, EKF2, or POS and ATT.

    Args:
        path: of the file.
        offset_ns: added to all times.
        config: its origin is the origin of POS; by default the first position.

    Attributes:
        path: as given.
        expected: what is read, for people.
    """

    kind = "ArduPilot log"
    is_finished = True
    expected = "poses (messages XKF1, NKF1, or POS with ATT)"

    def __init__(self, path: Path, offset_ns: int, config: Config) -> None:
        self.path = path
        self._offset_ns = offset_ns
        geo = config.odometry.origin
        self._origin = None if geo is None else Origin.of_degrees(geo.latitude, geo.longitude)

    def chunks(self) -> Iterator[Chunk]:
        """Yield the poses.

        Raises:
            ConfigError: the library is not installed.
            RecordingError: the log cannot be read, or has no GPS time and no offset is given.
        """
        reader = self._reader()
        with contextlib.closing(reader):
            if not getattr(reader.clock, "timebase", 0) and not self._offset_ns:
                raise RecordingError(
                    f"{self.path}: has no GPS time, so its times count from power-on; give the "
                    "Unix time of that with --odometry-offset SECONDS"
                )
            counts = {name: reader.counts[number] for name, number in reader.name_to_id.items()}
            name = next((name for name in ("XKF1", "NKF1") if counts.get(name)), None)
            yield from self._filter(reader, name) if name else self._positions(reader)

    def _filter(self, reader: Any, name: str) -> Iterator[Chunk]:  # noqa: ANN401 pymavlink's
        """Yield the poses of the first core of a filter."""
        core: int | None = None
        for message in self._messages(reader, name):
            number = getattr(message, "C", 0)
            core = number if core is None else core
            if number == core:
                place = (message.PE, message.PN, -message.PD)
                yield pose_chunk(self._stamp_ns(message), place, _attitude(message))

    def _positions(self, reader: Any) -> Iterator[Chunk]:  # noqa: ANN401
        """Yield positions and attitudes separately; they are interpolated."""
        for message in self._messages(reader, "POS", "ATT"):
            stamp_ns = self._stamp_ns(message)
            if message.get_type() == "ATT":
                yield pose_chunk(stamp_ns, None, _attitude(message))
                continue
            latitude, longitude = math.radians(message.Lat), math.radians(message.Lng)
            if self._origin is None:
                self._origin = Origin(latitude, longitude)
            place = self._origin.enu_m(latitude, longitude, message.Alt)
            yield pose_chunk(stamp_ns, place.tolist(), None)

    def _reader(self) -> Any:  # noqa: ANN401
        try:
            from pymavlink.DFReader import DFReader_binary  # noqa: PLC0415 an extra
        except ModuleNotFoundError as error:
            raise ConfigError(f"{self.path}: {missing_extra('pymavlink', 'mavlink')}") from error
        try:
            with _silent():
                return DFReader_binary(str(self.path))
        except Exception as error:  # as the library reports damage
            raise self._damaged(error) from error

    def _messages(self, reader: Any, *names: str) -> Iterator[Any]:  # noqa: ANN401
        while True:
            try:
                with _silent():
                    message = reader.recv_match(type=list(names), strict=True)
            except Exception as error:
                raise self._damaged(error) from error
            if message is None:
                return
            yield message

    def _stamp_ns(self, message: Any) -> int:  # noqa: ANN401
        seconds: float = message._timestamp  # noqa: SLF001 part of its interface
        return round(seconds * NS) + self._offset_ns

    def _damaged(self, error: Exception) -> RecordingError:
        return RecordingError(
            f"{self.path}: cannot be read as an ArduPilot log: {type(error).__name__}: {error}"
        )


def _attitude(message: Any) -> list[float]:  # noqa: ANN401 pymavlink's message
    wxyz: list[float] = compass_quaternion(message.Roll, message.Pitch, message.Yaw).tolist()
    return wxyz


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Discard what the library prints about damage."""
    nowhere = io.StringIO()
    with contextlib.redirect_stdout(nowhere), contextlib.redirect_stderr(nowhere):
        yield


@contextlib.contextmanager
def _mapped(path: Path) -> Iterator[mmap.mmap]:
    try:
        if path.stat().st_size == 0:  # which cannot be mapped into memory
            raise RecordingError(f"{path}: cannot be read: it is empty")
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, prot=mmap.PROT_READ) as data:
            yield data
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from error


class CaptureFile:
    """A network capture: datagrams to the UDP ports of the sources.

    Args:
        path: of the file.
        offset_ns: added to all times.
        config: the sources.

    Attributes:
        path: as given.
        expected: what is read, for people.
    """

    kind = "capture"
    is_finished = False

    def __init__(self, path: Path, offset_ns: int, config: Config) -> None:
        self.path = path
        self._offset_ns = offset_ns
        self._sources: dict[int, OdometrySourceConfig] = {}
        for source in config.odometry.sources:
            link = parse_address(source.link)
            if link.kind == "udp":
                self._sources.setdefault(link.port, source)
        ports = ", ".join(map(str, self._sources)) or "none"
        self.expected = f"datagrams to the UDP ports of odometry.sources ({ports})"

    def chunks(self) -> Iterator[Chunk]:
        """Yield the datagrams that have a time."""
        for datagram in read_datagrams(self.path):
            source = self._sources.get(datagram.port)
            if source is not None and datagram.arrival_ns is not None:
                arrival_ns = datagram.arrival_ns + self._offset_ns
                yield Chunk(source.name, encoding_of(source), arrival_ns, datagram.payload)


class RecordedOdometry:
    """The odometry in another recording.

    Args:
        path: of the file.
        offset_ns: added to all times.

    Attributes:
        path: as given.
        expected: what is read, for people.
        is_finished: whether it says that its poses are finished, as an alignment writes them.
    """

    kind = "recording"
    expected = "odometry"

    def __init__(self, path: Path, offset_ns: int) -> None:
        self.path = path
        self._offset_ns = offset_ns
        with open_recording(path) as recording:
            self.is_finished = FINISHED.items() <= recording.metadata.items()

    def chunks(self) -> Iterator[Chunk]:
        """Yield the odometry that has a time."""
        with open_recording(self.path) as recording:
            for chunk in recording:
                if (
                    chunk.encoding.startswith(ENCODING_PREFIX)
                    and chunk.arrival_ns is not None
                    and not chunk.damaged
                ):
                    yield replace(chunk, arrival_ns=chunk.arrival_ns + self._offset_ns)
