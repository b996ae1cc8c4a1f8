"""One quantity from its owner: checks of values, and jumps."""

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from mapperd.errors import Reject
from mapperd.geometry.frames import quaternion_product
from mapperd.odometry.series import Series, SeriesState

__all__ = ["AUTO", "Anchor", "JumpDetector", "Owner", "Track", "TrackState", "yaw_between"]

V = TypeVar("V")


class JumpDetector(Generic[V]):
    """Distinguishes motion, faults and jumps.

    Args:
        excess: returns how far two values are apart beyond the motion in some seconds, as a
            multiple of the allowed jump; above 1 is too far.
    """

    def __init__(self, excess: Callable[[V, V, float], float]) -> None:
        self._excess = excess
        self._last: tuple[int, V] | None = None
        self._suspect: tuple[int, V] | None = None

    def check(self, t_ns: int, value: V) -> bool | None:
        """Judge a value that is newer than all before it.

        Returns:
            False if it follows from the last one, True if it confirms a jump, None if it is an
            outlier and must not be used.
        """
        last, suspect = self._last, self._suspect
        if last is None or self._follows(last, t_ns, value):
            self._last, self._suspect = (t_ns, value), None
            return False
        if suspect is not None and self._follows(suspect, t_ns, value):
            self._last, self._suspect = (t_ns, value), None
            return True
        self._suspect = (t_ns, value)
        return None

    def state(self) -> "tuple[tuple[int, V] | None, tuple[int, V] | None]":
        """Return the last value and the suspected one, each with its time."""
        return self._last, self._suspect

    def restore(self, last: tuple[int, V] | None, suspect: tuple[int, V] | None) -> None:
        """Restore a state that `state` returned."""
        self._last, self._suspect = last, suspect

    def moved(self, t_ns: int, value: V) -> None:
        """Accept a known jump."""
        self._last, self._suspect = (t_ns, value), None

    def _follows(self, before: tuple[int, V], t_ns: int, value: V) -> bool:
        return self._excess(before[1], value, (t_ns - before[0]) / 1e9) <= 1.0


Floats = NDArray[np.float64]
Owner = tuple[str, str]
"""Name of the source, and of the sender on it."""

AUTO = ""
"""Configured owner that means the first source to provide the quantity."""

TAKE_OVER_NS = 2_000_000_000
"""Silence of a sender after which another one on the same source replaces it."""

RESTART_NS = 1_000_000_000
RESTART_RECORDS = 10
"""Consecutive ordered records, all well before the newest one, that restart the series: the host's
clock was set back, or a stamp far ahead was accepted. Without this, nothing would be accepted any
more."""


class TrackState(NamedTuple):
    """State of a `Track`.

    Attributes:
        series, segment, owner, taken, rejects: as in `Track`.
        reset_count: count of the last value; None before the first.
        taken_over: another sender has just become the owner.
        behind: number of consecutive records before the newest value, and the last one's time.
        last, suspect: time and value that jumps are judged against.
    """

    series: SeriesState
    segment: int
    owner: Owner | None
    taken: int
    rejects: dict[str, int]
    reset_count: int | None
    taken_over: bool
    behind: tuple[int, int]
    last: tuple[int, Floats] | None
    suspect: tuple[int, Floats] | None


class Track(Generic[V]):
    """A series with an owner.

    Args:
        owner: configured name of the source, or `AUTO`.
        excess: see `mapperd.odometry.track.JumpDetector`; None for a quantity that may jump.

    Attributes:
        series: accepted values.
        segment: increases at each jump of the quantity.
        owner: source and sender that provide it; None before the first.
        taken: number of used records.
        rejects: number of the owner's rejected records, by reason.
    """

    def __init__(
        self, owner: str, excess: Callable[[Floats, Floats, float], float] | None = None
    ) -> None:
        self._named = owner
        self._watch = None if excess is None else JumpDetector(excess)
        self._reset_count: int | None = None
        self._taken_over = False
        self._behind: tuple[int, int] = (0, 0)  # records, time of the last of them
        self.series: Series[V] = Series()
        self.segment = 0
        self.owner: Owner | None = None
        self.taken = 0
        self.rejects: Counter[str] = Counter()

    def state(self) -> TrackState:
        """Return the state for `restore`."""
        return TrackState(
            self.series.state(),
            self.segment,
            self.owner,
            self.taken,
            dict(self.rejects),
            self._reset_count,
            self._taken_over,
            self._behind,
            *((None, None) if self._watch is None else self._watch.state()),
        )

    def restore(self, state: TrackState, make: Callable[..., V]) -> None:
        """Continue as the track of which `state` was taken; `make` as of `Series.restore`."""
        self.series.restore(state.series, make)
        self.segment, self.owner, self.taken = state.segment, state.owner, state.taken
        self.rejects = Counter(state.rejects)
        self._reset_count, self._taken_over = state.reset_count, state.taken_over
        self._behind = state.behind
        if self._watch is not None:
            self._watch.restore(state.last, state.suspect)

    def owned_by(self, who: Owner, t_ns: int) -> bool:
        """Return whether a source may provide this quantity; the first that may becomes the owner.

        Another sender on the owner's source takes over after a silence, as when a bridge restarts
        under another name.
        """
        if self.owner is None and self.open_to(who):
            self.owner = who
        elif self.owner is not None and self.owner != who and self.owner[0] == who[0]:
            newest = self.series.newest
            if newest is None or t_ns - newest.t_ns > TAKE_OVER_NS:
                self.owner, self._taken_over = who, True
        return self.owner == who

    def open_to(self, who: Owner) -> bool:
        """Return whether the settings let a source provide this quantity."""
        return self._named in (AUTO, who[0])

    def judge(self, t_ns: int, raw: Floats, reset_count: int) -> Reject | bool:
        """Judge a value.

        Args:
            t_ns: host time.
            raw: value in the source's frame, before any anchor.
            reset_count: the source's count.

        Returns:
            A reject, otherwise whether the value starts a new segment.
        """
        if (problem := self.series.problem(t_ns)) is not None:
            if not self._restarts(t_ns):
                return problem
            self.series.clear()
            if self._watch is not None:
                self._watch.moved(t_ns, raw)
            self._reset_count = reset_count
            return True
        self._behind = (0, 0)
        jumped: bool | None = self._taken_over
        if self._watch is not None:
            if self._taken_over or self._reset_count not in (None, reset_count):
                self._watch.moved(t_ns, raw)
                jumped = True
            else:
                jumped = self._watch.check(t_ns, raw)
        if jumped is None:
            return Reject("jump", "it does not follow from the record before")
        self._reset_count, self._taken_over = reset_count, False
        return jumped

    def _restarts(self, t_ns: int) -> bool:
        newest, (records, last_ns) = self.series.newest, self._behind
        if newest is None or newest.t_ns - t_ns < RESTART_NS:
            return False
        self._behind = (records + 1 if t_ns > last_ns else 1, t_ns)
        return self._behind[0] >= RESTART_RECORDS

    def take(self, t_ns: int, value: V, *, jumped: bool) -> None:
        """Add an accepted value."""
        self.segment += jumped
        self.taken += 1
        self.series.add(t_ns, value, self.segment)

    def counted(self, result: Reject | None) -> Reject | None:
        """Count the outcome of the owner's value and return it."""
        if result is not None:
            self.rejects[result.reason] += 1
        return result

    def status(self) -> dict[str, Any]:
        """Status for people: owner, counts, time of the newest value."""
        newest = self.series.newest
        return {
            "owner": None if self.owner is None else self.owner[0],
            "sender": None if self.owner is None else self.owner[1],
            "taken": self.taken,
            "rejected": dict(self.rejects),
            "segment": self.segment,
            "newest_ns": None if newest is None else newest.t_ns,
        }


@dataclass(frozen=True, slots=True, eq=False)
class Anchor:
    """A rotation about the vertical and a shift, from the source's world to the map.

    Attributes:
        yaw_rad: heading of the source's world in the map.
        shift_m: (3,) its origin in the map.
    """

    yaw_rad: float
    shift_m: Floats

    @classmethod
    def none(cls) -> "Anchor":
        """The source's world is the map."""
        return cls(0.0, np.zeros(3))

    @classmethod
    def joining(cls, source_m: Floats, map_m: Floats, yaw_rad: float) -> "Anchor":
        """Return the anchor with this heading that maps one position to another."""
        turn_only = cls(yaw_rad, np.zeros(3))
        return cls(yaw_rad, map_m - turn_only.place(source_m))

    def place(self, source_m: Floats) -> Floats:
        """Return a position (3,) in the map."""
        return self.direction(source_m) + self.shift_m

    def direction(self, source: Floats) -> Floats:
        """Return a vector (3,) in map axes."""
        if self.yaw_rad == 0.0:
            return source
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        x, y, z = source
        return np.array([c * x - s * y, s * x + c * y, z])

    def attitude(self, source_q_base: Floats) -> Floats:
        """Return an orientation (4,) in the map."""
        if self.yaw_rad == 0.0:
            return source_q_base
        half = self.yaw_rad / 2.0
        return quaternion_product((math.cos(half), 0.0, 0.0, math.sin(half)), source_q_base)


def yaw_between(source_q_base: Floats, map_q_base: Floats) -> float:
    """Return the rotation about the vertical that best aligns one attitude with another, rad.

    The twist about z of map_q_base · source_q_base⁻¹.
    """
    conjugate = source_q_base * np.array([1.0, -1.0, -1.0, -1.0])
    w, _, _, z = quaternion_product(map_q_base, conjugate)
    return 2.0 * math.atan2(z, w)
