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
from mapperd.pairing import PoseSource
from mapperd.ping_stream import Arrival, PingStream
from mapperd.reject import Reject
from mapperd.step import Mapped, process_ping
from oculus_driver.ping import Ping
from oculus_driver.recording import OCULUS, ODOMETRY_NATIVE, Chunk, Recording

__all__ = ["Replay", "Window", "encodings", "first_range_m"]

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

    Attributes:
        counters: what happened.
    """

    def __init__(
        self,
        sonar_map: SonarMap,
        poses: PoseSource,
        window: Window,
        clock: Callable[[], float],
    ) -> None:
        self.counters = ReplayCounters()
        self._map = sonar_map
        self._poses = poses
        self._window = window
        self._clock = clock
        self._stream = PingStream(confirm=True)
        self._frame_skip = sonar_map.config.processing.frame_skip
        self._offered = 0

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
        if chunk.encoding == ODOMETRY_NATIVE:
            self._poses.add_odometry(chunk.data, chunk.arrival_ns)
        elif chunk.encoding == OCULUS:
            arrivals = self._stream.feed(
                chunk.link, chunk.data, chunk.arrival_ns, gap_before=chunk.gap_before
            )
            self._offer(arrivals, start_ns, end_ns)

    def _offer(self, arrivals: Iterable[Arrival], start_ns: int | None, end_ns: int | None) -> None:
        """Count the pings of the window and let every Nth of them wait for its pose."""
        for arrival in arrivals:
            if not _within(arrival.t_ns, start_ns, end_ns):
                self.counters.pings_outside += 1
                continue
            self.counters.pings_total += 1
            if isinstance(arrival.ping, Reject):
                self.counters.drop(arrival.ping.reason, arrival.ping.detail)
                continue
            self._offered += 1
            if (self._offered - 1) % self._frame_skip:
                self.counters.drop("frame_skip", f"every {self._frame_skip}th ping is mapped")
            else:
                self._poses.add_ping(arrival.ping)

    def _map_settled(self, now_ns: int | None, *, final: bool = False) -> None:
        for ping, pose in self._poses.settled(now_ns, final=final):
            if isinstance(pose, Reject):
                self.counters.drop(pose.reason, pose.detail)
                continue
            began_s = self._clock()
            result = process_ping(ping, pose, self._map)
            self.counters.step_s.append(self._clock() - began_s)
            if isinstance(result, Mapped):
                self.counters.pings_mapped += 1
            else:
                self.counters.drop(result.reason, result.detail)


def _within(t_ns: int | None, start_ns: int | None, end_ns: int | None) -> bool:
    if start_ns is None:
        return True
    return t_ns is not None and t_ns >= start_ns and (end_ns is None or t_ns < end_ns)


def encodings(recording: Recording, until: set[str]) -> set[str]:
    """The kinds of data in a recording; reads no further than until all of `until` are found."""
    found: set[str] = set()
    for chunk in recording:
        found.add(chunk.encoding)
        if until <= found:
            break
    return found


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
