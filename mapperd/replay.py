"""The offline source of the step: a recording becomes a map.

Bytes become pings, pings wait for their poses, each goes through the step; every one that does
not is counted with a reason.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import chain, islice
from statistics import median_low

from mapperd.counters import ReplayCounters
from mapperd.errors import ReplayError
from mapperd.mapping import SonarMap
from mapperd.odometry.bridge import ENCODING_PREFIX
from mapperd.pairing import PoseSource, ping_time_ns
from mapperd.ping_stream import Arrival, PingStream
from mapperd.reject import Reject
from mapperd.stepping import Stepping
from oculus_driver.clock import SonarClock
from oculus_driver.ping import Ping
from oculus_driver.recording import OCULUS, Chunk, Recording

__all__ = ["Replay", "Window", "contents", "first_range_m"]

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

    def limits_ns(self, recording: Recording) -> tuple[int | None, int | None]:
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
    """One recording on its way into one map.

    Args:
        sonar_map: where the pings go.
        poses: fixed, or from the recording's odometry.
        window: which part of the recording.
        clock: seconds, to time the steps with.
    """

    def __init__(
        self,
        sonar_map: SonarMap,
        poses: PoseSource,
        window: Window,
        clock: Callable[[], float],
    ) -> None:
        self._map = sonar_map
        self._poses = poses
        self._window = window
        self._stepping = Stepping(sonar_map, poses, clock)
        self._stream = PingStream(confirm=True)
        self._clocks: dict[int, SonarClock] = {}

    @property
    def counters(self) -> ReplayCounters:
        """What happened."""
        return self._stepping.counters

    def run(self, recording: Recording) -> Iterator[None]:
        """Map the recording; yields after every chunk, so that the caller can show progress.

        Raises:
            ReplayError: a part is asked of a recording without time stamps.
            RecordingError: the recording cannot be read on.
        """
        start_ns, end_ns = self._window.limits_ns(recording)
        late = 0
        for chunk in recording:
            late = late + 1 if self._is_late(chunk, end_ns) else 0
            if late > MAX_LATE_CHUNKS:
                break
            if not late or chunk.encoding == OCULUS:  # a late piece may belong to a ping in time
                self._take(chunk, start_ns, end_ns)
            self._map_settled(None if late else chunk.arrival_ns)
            yield
        else:  # read to its end, so what is pending will not be completed
            self._offer(self._stream.finish(), start_ns, end_ns)
        self._map_settled(None, final=True)
        self._stream.count(self.counters)

    def _is_late(self, chunk: Chunk, end_ns: int | None) -> bool:
        """Whether a chunk came so long after the end that its odometry encloses no ping."""
        if end_ns is None or chunk.arrival_ns is None:
            return False
        settings = self._map.config.time_sync
        grace_ns = round((settings.max_gap_sec + settings.max_odom_age_sec) * 1e9)
        return chunk.arrival_ns >= end_ns + grace_ns

    def _take(self, chunk: Chunk, start_ns: int | None, end_ns: int | None) -> None:
        if chunk.encoding.startswith(ENCODING_PREFIX):
            self._poses.add_odometry(
                chunk.link,
                chunk.data,
                chunk.arrival_ns,
                encoding=chunk.encoding,
                gap_before=chunk.gap_before,
            )
        elif chunk.encoding == OCULUS:
            arrivals = self._stream.feed(
                chunk.link, chunk.data, chunk.arrival_ns, gap_before=chunk.gap_before
            )
            self._offer(arrivals, start_ns, end_ns)

    def _offer(self, arrivals: Iterable[Arrival], start_ns: int | None, end_ns: int | None) -> None:
        """Let the pings of the window wait for their poses."""
        for arrival in arrivals:
            if not _within(arrival.t_ns, start_ns, end_ns):
                self.counters.pings_outside += 1
            else:
                self._stepping.offer(arrival.ping, self._time_ns(arrival.ping))

    def _time_ns(self, ping: Ping | Reject) -> int | None:
        """By the sonar's own clock, as in live mapping."""
        if isinstance(ping, Reject):
            return None
        if ping.source_id not in self._clocks:
            latency_ns = round(self._map.config.device.latency_sec * 1e9)
            self._clocks[ping.source_id] = SonarClock(latency_ns=latency_ns)
        return ping_time_ns(ping, self._clocks[ping.source_id])

    def _map_settled(self, now_ns: int | None, *, final: bool = False) -> None:
        for ping, pose in self._poses.settled(now_ns, final=final):
            self._stepping.step(ping, pose)


def _within(t_ns: int | None, start_ns: int | None, end_ns: int | None) -> bool:
    if start_ns is None:
        return True
    return t_ns is not None and t_ns >= start_ns and (end_ns is None or t_ns < end_ns)


def contents(recording: Recording) -> tuple[bool, bool]:
    """Whether a recording holds sonar data, and odometry; reads until it has found both."""
    sonar = odometry = False
    for chunk in recording:
        sonar = sonar or chunk.encoding == OCULUS
        odometry = odometry or chunk.encoding.startswith(ENCODING_PREFIX)
        if sonar and odometry:
            break
    return sonar, odometry


def first_range_m(recording: Recording) -> float:
    """How far the sonar looks: the shortest range of the first pings; 0 without a ping."""
    return min((ping.max_range_m for ping in islice(_pings(recording), FIRST_PINGS)), default=0.0)


def _pings(recording: Recording) -> Iterator[Ping]:
    stream = PingStream(confirm=True)
    chunks = (chunk for chunk in recording if chunk.encoding == OCULUS)
    arrivals = chain.from_iterable(
        stream.feed(chunk.link, chunk.data, chunk.arrival_ns, gap_before=chunk.gap_before)
        for chunk in chunks
    )
    for arrival in chain(arrivals, stream.finish()):
        if isinstance(arrival.ping, Ping):
            yield arrival.ping


def _first_sonar_ns(recording: Recording) -> int | None:
    """Earliest of the sonar's first stamps that is not astray; None where it has none."""
    sonar = (chunk.arrival_ns for chunk in recording if chunk.encoding == OCULUS)
    stamps = list(islice((stamp for stamp in sonar if stamp is not None), FIRST_CHUNKS))
    if not stamps:
        return None
    middle = median_low(stamps)
    return min(stamp for stamp in stamps if abs(stamp - middle) <= FIRST_SPREAD_NS)
