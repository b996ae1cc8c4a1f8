"""Replay of recordings: a recording becomes a map.

Bytes become pings, pings wait for their poses, each goes through the step; every one that does
not is counted with a reason.
"""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
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
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.decoder import PingStream, PosedPing, SessionDecoder, Work
from mapperd.pipeline.executor import PingExecutor
from mapperd.pipeline.persistence import MemoryPersistence
from mapperd.pipeline.pose_lookup import FixedPose, OdometryPoses, PoseLookup
from mapperd.pipeline.step import StepRunner
from mapperd.session.recordings import RecordedSession
from mapperd.session_log import Remarks, Session, remarks_in, without_skipped
from oculus_driver.ping import Ping
from oculus_driver.recording import OCULUS, Chunk

__all__ = [
    "Replay",
    "Run",
    "Window",
    "as_asked",
    "as_recorded",
    "contents",
    "first_range_m",
    "not_empty",
]

MAX_LATE_CHUNKS = 1000
"""So many chunks in a row after the chosen part are its end; fewer are stamps gone astray."""

FIRST_CHUNKS = 101
"""Sonar chunks whose stamps are asked when the recording begins."""

FIRST_SPREAD_NS = 3600 * 10**9
"""A stamp further than this from the middle one of those is astray."""

FIRST_PINGS = 10
"""Pings that are asked how far the sonar looks."""


@dataclass(frozen=True, slots=True)
class Window:
    """The part of a recording to map, in the recording's own time.

    Attributes:
        start_s: seconds after the sonar's first stamp.
        duration_s: seconds from there; None is to the end.
    """

    start_s: float = 0.0
    duration_s: float | None = None

    def limits_ns(self, recording: Iterable[Chunk]) -> tuple[int | None, int | None]:
        """First nanosecond and the one after the last; (None, None) for the whole recording.

        Raises:
            ReplayError: a part is asked of a recording without time stamps.
        """
        if self.start_s == 0 and self.duration_s is None:
            return None, None
        first_ns = _first_sonar_ns(recording)
        if first_ns is None:
            raise ReplayError(
                "its sonar data have no time stamps, so --start and --duration mean nothing in it"
            )
        start_ns = first_ns + round(self.start_s * 1e9)
        end_ns = None if self.duration_s is None else start_ns + round(self.duration_s * 1e9)
        return start_ns, end_ns


class Replay:
    """One session of recordings on its way into one map.

    Args:
        sonar_map: where the pings go.
        poses: fixed, or from the recording's odometry.
        window: which part of the recording.
        clock: seconds, to time the steps with.
        confirm: the recording does not say where bytes are missing, so that each ping is held
            back until what follows confirms it.
        remarks: to map a session of the daemon as it was mapped, with all that was decided.
        counters: to go on with.
        onboard: localizes; None where that is off.

    Attributes:
        on_settled: called with each ping before anything is done with it.
    """

    def __init__(
        self,
        sonar_map: SonarMap,
        poses: PoseLookup,
        window: Window,
        clock: Callable[[], float],
        *,
        confirm: bool = True,
        remarks: Remarks | None = None,
        counters: PipelineCounters | None = None,
        onboard: LocalizationStage | None = None,
    ) -> None:
        self.on_settled: Callable[[PosedPing], None] = lambda _: None
        self._config = sonar_map.config
        self._poses = poses
        self._window = window
        self._confirm = confirm
        self._as_recorded = remarks is not None
        self._integration = PingExecutor(
            StepRunner(sonar_map, clock, counters), MemoryPersistence(sonar_map), remarks, onboard
        )

    @property
    def integration(self) -> PingExecutor:
        """What carries the work out."""
        return self._integration

    @property
    def counters(self) -> PipelineCounters:
        """What happened."""
        return self._integration.stepping.counters

    def run(self, recording: Iterable[Chunk]) -> Iterator[None]:
        """Map the recording; yields after every chunk, so that the caller can show progress.

        Raises:
            ReplayError: a part is asked of a recording without time stamps.
            RecordingError: the recording cannot be read on.
            CheckpointError: a known map that it names is not there any more.
        """
        start_ns, end_ns = self._window.limits_ns(recording)
        engine = self._engine(start_ns, end_ns)
        late = 0
        for chunk in without_skipped(recording) if self._as_recorded else recording:
            late = late + 1 if self._is_late(chunk, end_ns) else 0
            if late > MAX_LATE_CHUNKS:
                break
            self._do(engine.feed(chunk, late=late > 0))
            yield
        self._do(engine.end(cut=late > MAX_LATE_CHUNKS))

    def _engine(self, start_ns: int | None, end_ns: int | None) -> SessionDecoder:
        return SessionDecoder(
            self._config,
            self._poses,
            self.counters,
            confirm=self._confirm,
            obey=self._as_recorded,
            within=partial(_within, start_ns=start_ns, end_ns=end_ns),
        )

    def _is_late(self, chunk: Chunk, end_ns: int | None) -> bool:
        """Whether a chunk came so long after the end that its odometry encloses no ping."""
        if end_ns is None or chunk.arrival_ns is None:
            return False
        settings = self._config.time_sync
        grace_ns = round((settings.max_gap_sec + settings.max_odom_age_sec) * 1e9)
        return chunk.arrival_ns >= end_ns + grace_ns

    def _do(self, work: Iterable[Work]) -> None:
        for each in work:
            if isinstance(each, PosedPing):
                self.on_settled(each)
            self._integration.do(each)


def _within(t_ns: int | None, start_ns: int | None, end_ns: int | None) -> bool:
    if start_ns is None:
        return True
    return t_ns is not None and t_ns >= start_ns and (end_ns is None or t_ns < end_ns)


def contents(recording: Iterable[Chunk]) -> tuple[bool, bool]:
    """Whether a recording holds sonar data, and odometry; reads until it has found both."""
    sonar = odometry = False
    for chunk in recording:
        sonar = sonar or chunk.encoding == OCULUS
        odometry = odometry or chunk.encoding.startswith(ENCODING_PREFIX)
        if sonar and odometry:
            break
    return sonar, odometry


def first_range_m(recording: Iterable[Chunk]) -> float:
    """How far the sonar looks: the shortest range of the first pings; 0 without a ping."""
    return min((ping.max_range_m for ping in islice(_pings(recording), FIRST_PINGS)), default=0.0)


def _pings(recording: Iterable[Chunk]) -> Iterator[Ping]:
    stream = PingStream(confirm=True)
    chunks = (chunk for chunk in recording if chunk.encoding == OCULUS)
    arrivals = chain.from_iterable(
        stream.feed(chunk.link, chunk.data, chunk.arrival_ns, gap_before=chunk.gap_before)
        for chunk in chunks
    )
    for arrival in chain(arrivals, stream.finish()):
        if isinstance(arrival.ping, Ping):
            yield arrival.ping


def _first_sonar_ns(recording: Iterable[Chunk]) -> int | None:
    """Earliest of the sonar's first stamps that is not astray; None where it has none."""
    sonar = (chunk.arrival_ns for chunk in recording if chunk.encoding == OCULUS)
    stamps = list(islice((stamp for stamp in sonar if stamp is not None), FIRST_CHUNKS))
    if not stamps:
        return None
    middle = median_low(stamps)
    return min(stamp for stamp in stamps if abs(stamp - middle) <= FIRST_SPREAD_NS)


class Run:
    """A session that is to be mapped: what with, and what was decided in it.

    Args:
        session: its recordings.
        config: the settings at its beginning.
        pose: of a vehicle that stood still; None takes the odometry.
        remarks: what was decided, to be decided again; None decides anew.
        localizing: None where that is off.

    Attributes:
        session, config, remarks: as given.
        poses: of its pings.
        onboard: localizes.
    """

    def __init__(
        self,
        session: RecordedSession,
        config: Config,
        pose: Pose | None,
        remarks: Remarks | None,
        localizing: LocalizationSession | None = None,
    ) -> None:
        self.session = session
        self.config = config
        self.poses = OdometryPoses(config) if pose is None else FixedPose(pose)
        self.remarks = remarks
        self.onboard = None if localizing is None else localizing.onboard

    def replay(
        self, sonar_map: SonarMap, window: Window, counters: PipelineCounters | None = None
    ) -> Replay:
        """The session on its way into a map, which takes the session's settings now."""
        sonar_map.reconfigure(self.config)
        return Replay(
            sonar_map,
            self.poses,
            window,
            time.perf_counter,
            confirm=self.session.session is None,
            remarks=self.remarks,
            counters=counters,
            onboard=self.onboard,
        )


def not_empty(sessions: Sequence[RecordedSession]) -> Sequence[RecordedSession]:
    """Those with anything in them: who was killed before the first piece leaves one without."""
    return [session for session in sessions if any(True for _ in session)] or sessions


def as_asked(session: RecordedSession, pose: Pose | None, config: Config) -> Run:
    """With settings of today.

    Raises:
        ConfigError: localization cannot begin with them.
    """
    return Run(session, config, pose, None, begun(config))


def as_recorded(session: RecordedSession) -> Run:
    """As it was mapped.

    Raises:
        ReplayError: nobody knows how that was.
        ConfigError: its settings are none of this version.
    """
    beginning = session.beginning()
    if beginning is None:
        raise ReplayError(
            f"{session.paths[0].name} does not begin a session of the daemon, so nobody knows how "
            "it was mapped; begin with the session's first file, or leave out --as-recorded"
        )
    config = config_of(beginning.settings, f"settings in {session.paths[0].name}")
    localizing = begun_again(config, beginning)
    return Run(session, config, _pose_of(beginning), remarks_in(session), localizing)


def _pose_of(beginning: Session) -> Pose | None:
    if beginning.pose is None:
        return None
    return Pose(np.array(beginning.pose[:3]), np.array(beginning.pose[3:]))
