"""Maps recordings with the same pipeline as the live daemon."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from statistics import median_low

import numpy as np

from mapperd.config.loader import config_of
from mapperd.config.tree import Config
from mapperd.errors import ReplayError
from mapperd.geometry.frames import Pose
from mapperd.localization.session import LocalizationSession, begun, begun_again
from mapperd.localization.stage import LocalizationStage
from mapperd.mapping.sonar_map import SonarMap
from mapperd.odometry.bridge import ENCODING_PREFIX
from mapperd.odometry.odometry_files import (
    OdometryFiles,
    OdometryOptions,
    captured_odometry,
    read_odometry,
)
from mapperd.pipeline.build import build_pipeline
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.decoder import PingStream, PosedPing, Work
from mapperd.pipeline.persistence import MapPersistence
from mapperd.pipeline.pose_lookup import FixedPose, OdometryPoses
from mapperd.session.recordings import RecordedSession
from mapperd.session.ros_recording import ROS_BAG
from mapperd.session_log import Remarks, Session, remarks_in, without_skipped
from oculus_driver.ping import Ping
from oculus_driver.recording import OCULUS, PCAP, PCAPNG, Chunk

__all__ = [
    "Replay",
    "Run",
    "Window",
    "as_asked",
    "as_recorded",
    "contents",
    "first_range_m",
    "not_empty",
    "odometry_of",
    "poses_of",
    "require_overlap",
]

MAX_LATE_CHUNKS = 1000
"""Number of consecutive late chunks that end the chosen part; fewer are wrong stamps."""

FIRST_CHUNKS = 101
"""Number of sonar chunks whose stamps give the beginning of the recording."""

FIRST_SPREAD_NS = 3600 * 10**9
"""A stamp further than this from their median is wrong."""

FIRST_PINGS = 10
"""Number of pings that give the range of the sonar."""


@dataclass(frozen=True, slots=True)
class Window:
    """The part of a recording to map, in the recording's own time.

    Attributes:
        start_s: start in seconds after the sonar's first stamp.
        duration_s: duration in seconds; None maps to the end.
    """

    start_s: float = 0.0
    duration_s: float | None = None

    def limits_ns(self, recording: Iterable[Chunk]) -> tuple[int | None, int | None]:
        """Return the first nanosecond and the one after the last; None where unlimited.

        Raises:
            ReplayError: a part is requested of a recording without time stamps.
        """
        if self.start_s == 0 and self.duration_s is None:
            return None, None
        first_ns = _first_sonar_ns(recording)
        if first_ns is None:
            raise ReplayError(
                "its sonar data have no time stamps: --start and --duration cannot be used"
            )
        start_ns = first_ns + round(self.start_s * 1e9)
        end_ns = None if self.duration_s is None else start_ns + round(self.duration_s * 1e9)
        return start_ns, end_ns


class Replay:
    """Maps one session of recordings.

    Args:
        sonar_map: the map.
        poses: fixed, or from the recording's odometry; fresh.
        window: part of the recording to map.
        clock: seconds, to time the steps.
        confirm: hold each ping back until the next bytes confirm it: for recordings that do not
            mark missing bytes.
        remarks: of a session of the daemon, whose recorded decisions are then repeated.
        counters: to continue; new ones by default.
        localization: corrects the poses; None where it is off.
        persistence: of the map; None keeps it in memory.

    Attributes:
        pipeline: that maps the recording.
        on_posed: called with each ping before its step.
    """

    def __init__(
        self,
        sonar_map: SonarMap,
        poses: FixedPose | OdometryPoses,
        window: Window,
        clock: Callable[[], float] = time.perf_counter,
        *,
        confirm: bool = True,
        remarks: Remarks | None = None,
        counters: PipelineCounters | None = None,
        localization: LocalizationStage | None = None,
        persistence: MapPersistence | None = None,
    ) -> None:
        self.on_posed: Callable[[PosedPing], None] = lambda _: None
        self._config = sonar_map.config
        self._window = window
        self._repeats = remarks is not None
        self._start_ns: int | None = None
        self._end_ns: int | None = None
        self.pipeline = build_pipeline(
            sonar_map,
            poses,
            localization=localization,
            persistence=persistence,
            remarks=remarks,
            confirm=confirm,
            within=self._is_within,
            counters=counters,
            clock=clock,
        )

    @property
    def counters(self) -> PipelineCounters:
        """Counters of the pipeline."""
        return self.pipeline.counters

    def run(self, recording: Iterable[Chunk]) -> Iterator[None]:
        """Map the recording; yield after every chunk, so that the caller can show progress.

        Raises:
            ReplayError: a part is requested of a recording without time stamps.
            RecordingError: the recording cannot be read.
            CheckpointError: a known map named in the recording does not exist any more.
        """
        self._start_ns, self._end_ns = self._window.limits_ns(recording)
        decoder = self.pipeline.decoder
        late = 0
        for chunk in without_skipped(recording) if self._repeats else recording:
            late = late + 1 if self._is_late(chunk) else 0
            if late > MAX_LATE_CHUNKS:
                break
            self._do(decoder.feed(chunk, late=late > 0))
            yield
        self._do(decoder.end(cut=late > MAX_LATE_CHUNKS))

    def _is_within(self, t_ns: int | None) -> bool:
        if self._start_ns is None:
            return True
        return (
            t_ns is not None
            and t_ns >= self._start_ns
            and (self._end_ns is None or t_ns < self._end_ns)
        )

    def _is_late(self, chunk: Chunk) -> bool:
        """Return whether a chunk is so late that its odometry encloses no ping of the window."""
        if self._end_ns is None or chunk.arrival_ns is None:
            return False
        settings = self._config.time_sync
        grace_ns = round((settings.max_gap_sec + settings.max_odom_age_sec) * 1e9)
        return chunk.arrival_ns >= self._end_ns + grace_ns

    def _do(self, works: Iterable[Work]) -> None:
        for work in works:
            if isinstance(work, PosedPing):
                self.on_posed(work)
            self.pipeline.executor.do(work)


def contents(recording: Iterable[Chunk]) -> tuple[bool, bool]:
    """Return whether a recording has sonar data, and odometry; read until both are found."""
    sonar = odometry = False
    for chunk in recording:
        sonar = sonar or chunk.encoding == OCULUS
        odometry = odometry or chunk.encoding.startswith(ENCODING_PREFIX)
        if sonar and odometry:
            break
    return sonar, odometry


def first_range_m(recording: Iterable[Chunk]) -> float:
    """Return the shortest range of the first pings; 0 without pings."""
    return min((ping.max_range_m for ping in islice(_pings(recording), FIRST_PINGS)), default=0.0)


def _pings(recording: Iterable[Chunk]) -> Iterator[Ping]:
    stream = PingStream(confirm=True)
    chunks = (chunk for chunk in recording if chunk.encoding == OCULUS and not chunk.damaged)
    arrivals = chain.from_iterable(
        stream.feed(chunk.link, chunk.data, chunk.arrival_ns, gap_before=chunk.gap_before)
        for chunk in chunks
    )
    for arrival in chain(arrivals, stream.finish()):
        if isinstance(arrival.ping, Ping):
            yield arrival.ping


def _first_sonar_ns(recording: Iterable[Chunk]) -> int | None:
    """Return the earliest plausible stamp of the sonar's first chunks; None without stamps."""
    chunks = (chunk for chunk in recording if chunk.encoding == OCULUS and not chunk.damaged)
    sonar = (chunk.arrival_ns for chunk in chunks)
    stamps = list(islice((stamp for stamp in sonar if stamp is not None), FIRST_CHUNKS))
    if not stamps:
        return None
    median = median_low(stamps)
    return min(stamp for stamp in stamps if abs(stamp - median) <= FIRST_SPREAD_NS)


def odometry_of(
    sessions: Sequence[RecordedSession], options: OdometryOptions | None, config: Config
) -> OdometryFiles | None:
    """Return the odometry that replaces the recorded one; None reads that.

    Captures of the network and ROS bags hold it beside the sonar's data.

    Args:
        sessions: their recordings.
        options: files with the odometry; None looks for it in the recordings.
        config: the sources.

    Raises:
        RecordingError: a file of odometry is malformed, or holds none.
        ConfigError: a format needs a library that is not installed.
    """
    if options is not None:
        return read_odometry(options, config)
    formats = {session.format for session in sessions}
    paths = tuple(path for session in sessions for path in session.paths)
    if formats <= {PCAP, PCAPNG}:
        return captured_odometry(paths, config)
    return read_odometry(OdometryOptions(paths), config) if formats == {ROS_BAG} else None


def poses_of(
    odometry: OdometryFiles | None, config: Config, pose: Pose | None
) -> FixedPose | OdometryPoses:
    """Return where the pings of a session get their poses from.

    Args:
        odometry: of other files; None uses the recorded odometry.
        config: the settings.
        pose: of a vehicle at rest; None uses the odometry.
    """
    if pose is not None:
        return FixedPose(pose)
    return OdometryPoses(config if odometry is None else odometry.settings(config))


def require_overlap(sessions: Sequence[RecordedSession], odometry: OdometryFiles) -> None:
    """Check that odometry of other files overlaps with a session in time.

    Args:
        sessions: their recordings alone.
        odometry: of other files.

    Raises:
        ReplayError: it overlaps with none, or the recordings have no time stamps.
    """
    problems = [_no_overlap(session, odometry) for session in sessions]
    if problems[0] is not None and all(problems):
        raise ReplayError(problems[0])


def _no_overlap(session: RecordedSession, odometry: OdometryFiles) -> str | None:
    first_ns = _first_sonar_ns(session)
    if first_ns is None:
        return "its sonar data have no time stamps: odometry of other files cannot be used"
    offset_s = (first_ns - odometry.first_ns) / 1e9 + odometry.offset_ns / 1e9
    remedy = (
        "check the clocks of both, or move the odometry with --odometry-offset SECONDS "
        f"({offset_s:.1f} lets both begin together)"
    )
    if odometry.last_ns < first_ns:
        apart_s = (first_ns - odometry.last_ns) / 1e9
        return f"{odometry} ends {apart_s:.1f} s before the sonar data begin; {remedy}"
    last_ns = first_ns
    for chunk in session if odometry.first_ns > first_ns else ():
        if chunk.encoding == OCULUS and chunk.arrival_ns is not None and not chunk.damaged:
            last_ns = max(last_ns, chunk.arrival_ns)
        if last_ns >= odometry.first_ns:
            return None
    if odometry.first_ns > last_ns:
        apart_s = (odometry.first_ns - last_ns) / 1e9
        return f"{odometry} begins {apart_s:.1f} s after the sonar data end; {remedy}"
    return None


class Run:
    """A recorded session to map, with its settings, poses and localization; maps once.

    Args:
        session: its recordings.
        config: the settings at its beginning.
        pose: of a vehicle at rest; None uses the odometry.
        remarks: recorded decisions to repeat; None ignores them.
        localization: None where it is off.

    Attributes:
        session, config, remarks, localization: as given.
        poses: of its pings.
    """

    def __init__(
        self,
        session: RecordedSession,
        config: Config,
        pose: Pose | None,
        remarks: Remarks | None,
        localization: LocalizationSession | None = None,
    ) -> None:
        self.session = session
        self.config = config
        self.poses = poses_of(session.odometry, config, pose)
        self.remarks = remarks
        self.localization = localization

    def replay(
        self,
        sonar_map: SonarMap,
        window: Window,
        counters: PipelineCounters | None = None,
        persistence: MapPersistence | None = None,
    ) -> Replay:
        """Return the replay into a map, which takes over the session's settings now."""
        sonar_map.reconfigure(self.config)
        localization = self.localization
        return Replay(
            sonar_map,
            self.poses,
            window,
            confirm=self.session.session is None,
            remarks=self.remarks,
            counters=counters,
            localization=None if localization is None else localization.stage,
            persistence=persistence,
        )


def not_empty(sessions: Sequence[RecordedSession]) -> Sequence[RecordedSession]:
    """Return the sessions with data; a crash before the first piece leaves an empty one."""
    return [session for session in sessions if any(True for _ in session)] or sessions


def as_asked(session: RecordedSession, pose: Pose | None, config: Config) -> Run:
    """Return a run of a session with the given settings.

    Raises:
        ConfigError: localization cannot start with them.
    """
    return Run(session, config, pose, None, begun(config))


def as_recorded(session: RecordedSession) -> Run:
    """Return a run of a session of the daemon that repeats its settings and decisions.

    Raises:
        ReplayError: the beginning of the session is missing.
        ConfigError: this version does not accept its settings, or its known map is missing.
    """
    beginning = session.beginning()
    if beginning is None:
        raise ReplayError(
            f"{session.paths[0].name} is not the first file of a session of the daemon, so its "
            "settings are unknown; start with the session's first file, or omit --as-recorded"
        )
    config = config_of(beginning.settings, f"settings in {session.paths[0].name}")
    localization = begun_again(config, beginning)
    return Run(session, config, _pose_of(beginning), remarks_in(session), localization)


def _pose_of(beginning: Session) -> Pose | None:
    if beginning.pose is None:
        return None
    return Pose(np.array(beginning.pose[:3]), np.array(beginning.pose[3:]))
