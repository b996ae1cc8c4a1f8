"""One quantity of the vehicle over the recent past, and its value at a moment."""

from bisect import bisect_right
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, fields
from operator import attrgetter
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from mapperd.config.odometry import TimeSyncConfig
from mapperd.errors import Reject

__all__ = [
    "MAX_SAMPLES",
    "Course",
    "Reach",
    "Sample",
    "Series",
    "SeriesState",
    "enclosing",
    "is_settled",
    "stretch",
    "value_at",
]

MAX_SAMPLES = 8192
"""Bound of the memory: 20 s at 400 Hz; the oldest go first."""

V = TypeVar("V")


@dataclass(frozen=True, slots=True)
class Sample(Generic[V]):
    """A value at a moment.

    Attributes:
        t_ns: host time.
        value: whatever the series is of.
        segment: two samples of different segments have no motion between them: the estimate
            jumped there, the vehicle did not.
    """

    t_ns: int
    value: V
    segment: int


class SeriesState(NamedTuple):
    """State of a `Series` of n samples.

    Attributes:
        t_ns, segment: int64 (n,).
        columns: values of each field of the samples' values, in their order: (n, ...) where all
            are arrays of one shape or numbers, else a list of n.
    """

    t_ns: NDArray[np.int64]
    segment: NDArray[np.int64]
    columns: list[Any]


class Series(Generic[V]):
    """Samples, oldest first.

    Args:
        max_samples: bound of the memory.
    """

    def __init__(self, max_samples: int = MAX_SAMPLES) -> None:
        self._samples: deque[Sample[V]] = deque(maxlen=max_samples)

    def __len__(self) -> int:
        return len(self._samples)

    @property
    def newest(self) -> Sample[V] | None:
        """The newest sample, or None."""
        return self._samples[-1] if self._samples else None

    def state(self) -> SeriesState:
        """All samples; their values are arrays, or records of a few fields."""
        samples = self._samples
        return SeriesState(
            np.array([one.t_ns for one in samples], dtype=np.int64),
            np.array([one.segment for one in samples], dtype=np.int64),
            [_column(column) for column in _columns([one.value for one in samples])],
        )

    def restore(self, state: SeriesState, make: Callable[..., V]) -> None:
        """Hold the samples of which `state` was taken.

        Args:
            state: of a series of the same values.
            make: a value of its fields.
        """
        rows = zip(
            state.t_ns.tolist(), state.segment.tolist(), *map(_values, state.columns), strict=True
        )
        self._samples = deque(
            (Sample(t_ns, make(*parts), segment) for t_ns, segment, *parts in rows),
            maxlen=self._samples.maxlen,
        )

    def problem(self, t_ns: int) -> Reject | None:
        """Why a sample of that time could not be taken."""
        if self._samples and t_ns <= self._samples[-1].t_ns:
            late_s = (self._samples[-1].t_ns - t_ns) / 1e9
            return Reject("back_in_time", f"{late_s:g} s before the newest record, or equal to it")
        return None

    def add(self, t_ns: int, value: V, segment: int) -> None:
        """Add a sample that is newer than all before it (see `problem`)."""
        self._samples.append(Sample(t_ns, value, segment))

    def clear(self) -> None:
        """Forget all samples."""
        self._samples.clear()

    def around(self, t_ns: int) -> "tuple[Sample[V] | None, Sample[V] | None]":
        """The last sample at or before a moment, and the first after it."""
        samples = self._samples
        if not samples:
            return None, None
        after = self._place(t_ns)
        return (
            samples[after - 1] if after > 0 else None,
            samples[after] if after < len(samples) else None,
        )

    def next_to(self, sample: "Sample[V]", step: int) -> "Sample[V] | None":
        """The sample `step` places (-1 or 1) from one of this series, where there is one."""
        place = self._place(sample.t_ns) - 1 + step
        return self._samples[place] if 0 <= place < len(self._samples) else None

    def _place(self, t_ns: int) -> int:
        """Index of the first sample after a moment; asked near the new end, so look there first."""
        samples = self._samples
        if samples[-1].t_ns <= t_ns:
            return len(samples)
        return bisect_right(samples, t_ns, key=lambda sample: sample.t_ns)


def _columns(values: list[Any]) -> list[list[Any]]:
    """The values of each field, in the order of the fields; of arrays there is one column."""
    if not values or isinstance(values[0], np.ndarray):
        return [values] if values else []
    return [list(map(attrgetter(field.name), values)) for field in fields(values[0])]


def _column(values: list[Any]) -> Any:  # noqa: ANN401 an array or a list
    """As one array, where the values are alike; products round by the order of an array."""
    kinds = set(map(type, values))
    if kinds == {np.ndarray}:
        forms = {(one.shape, one.dtype, one.strides) for one in values}
        shapes = {(shape, dtype) for shape, dtype, _ in forms}
        ordered = all(len(shape) == 1 or steps[0] >= steps[-1] for shape, _, steps in forms)
        if len(shapes) == 1 and ordered and values[0].ndim:
            return np.concatenate(values).reshape(len(values), *values[0].shape)
        return values
    return np.array(values) if kinds <= {float, np.float64} or kinds == {bool} else values


def _values(column: Any) -> list[Any]:  # noqa: ANN401 an array or a list
    """The rows of a column, each with memory of its own."""
    if not isinstance(column, np.ndarray):
        return list(column)
    return column.tolist() if column.ndim == 1 else [row.copy() for row in column]


STRETCH_NS = 100_000_000
"""To either side of a moment: over less, noise would be taken for motion, over more, turns are cut.

Of 1 cm of noise it leaves 7 cm/s, which moves a sample by 1 mm in 20 ms.
"""


class Course(Generic[V]):
    """How a quantity goes from one moment to another.

    Attributes:
        blend: from the value at 0 to that at 1, at a fraction that may lie beyond either.
        carry: a value so many seconds on (or back) by its own rate of change; None where it has
            none.
    """

    def __init__(
        self, blend: Callable[[V, V, float], V], carry: Callable[[V, float], V | None]
    ) -> None:
        self.blend = blend
        self.carry = carry


@dataclass(frozen=True, slots=True)
class Reach:
    """How far records are believed.

    Attributes:
        policy: `time_sync.policy`.
        max_gap_ns: two samples further apart than this are not interpolated between.
        max_reach_ns: how far beyond a sample its motion may be carried on.
    """

    policy: str
    max_gap_ns: int
    max_reach_ns: int

    @classmethod
    def of(cls, settings: TimeSyncConfig) -> "Reach":
        """The limits as they are set."""
        return cls(
            settings.policy,
            round(settings.max_gap_sec * 1e9),
            round(settings.max_stamp_diff_sec * 1e9),
        )


def value_at(series: Series[V], t_ns: int, reach: Reach, course: Course[V]) -> "Sample[V] | Reject":
    """The quantity at a moment.

    interpolate: enclosed by two samples of one segment at most `max_gap` apart, blended; else
    from the nearest sample, if it is at most `max_reach` away, carried on by its own rate, or by
    the motion beside it for no longer than that was seen, or held.
    nearest and latest: that sample, if it is at most `max_reach` away.
    """
    before, after = series.around(t_ns)
    if reach.policy == "interpolate":
        if before is not None and before.t_ns == t_ns:
            return before
        if (pair := enclosing(before, after, reach)) is not None:
            return _blended(*pair, t_ns, course)
    near = _nearest(before, after, t_ns) if reach.policy != "latest" else series.newest
    if near is None:
        return Reject("no_odometry", "no odometry so far")
    if abs(near.t_ns - t_ns) > reach.max_reach_ns:
        return _too_far(before, after, t_ns)
    return near if reach.policy != "interpolate" else _carried(series, near, t_ns, reach, course)


def enclosing(
    before: "Sample[V] | None", after: "Sample[V] | None", reach: Reach
) -> "tuple[Sample[V], Sample[V]] | None":
    """Both samples, where there is a motion between them."""
    if before is None or after is None or before.segment != after.segment:
        return None
    return (before, after) if after.t_ns - before.t_ns <= reach.max_gap_ns else None


def is_settled(series: Series[V], t_ns: int, reach: Reach) -> bool:
    """Whether no later sample can make the quantity at a moment better."""
    before, after = series.around(t_ns)
    if before is not None and before.t_ns == t_ns:
        return True
    newest = series.newest
    if after is None or newest is None:
        return False
    if reach.policy != "interpolate" or enclosing(before, after, reach) is not None:
        return True
    # After a gap, one record does not determine the motion before it.
    back_ns = after.t_ns - t_ns
    return back_ns > reach.max_reach_ns or newest.t_ns - after.t_ns >= back_ns


def stretch(series: Series[V], t_ns: int, reach: Reach) -> "tuple[Sample[V], Sample[V]] | None":
    """Samples around a moment that determine its velocity, or None.

    As far as `STRETCH_NS` to either side; where records are rarer, or one of them jumps, the two
    that enclose the moment.
    """
    _, first = series.around(t_ns - STRETCH_NS - 1)
    last, _ = series.around(t_ns + STRETCH_NS)
    if (
        first is not None
        and last is not None
        and first.segment == last.segment
        and last.t_ns - first.t_ns >= STRETCH_NS // 2
    ):
        return first, last
    return enclosing(*series.around(t_ns), reach)


def _carried(
    series: Series[V], near: "Sample[V]", t_ns: int, reach: Reach, course: Course[V]
) -> "Sample[V]":
    carried = course.carry(near.value, (t_ns - near.t_ns) / 1e9)
    if carried is not None:
        return Sample(t_ns, carried, near.segment)
    pair = _beside(series, near, reach, later=near.t_ns > t_ns)
    # Farther than the two are apart would magnify their noise.
    if pair is None or abs(t_ns - near.t_ns) > pair[1].t_ns - pair[0].t_ns:
        return Sample(t_ns, near.value, near.segment)
    return _blended(*pair, t_ns, course)


def _beside(
    series: Series[V], near: "Sample[V]", reach: Reach, *, later: bool
) -> "tuple[Sample[V], Sample[V]] | None":
    """A sample and one up to `STRETCH_NS` from it, or its neighbour where records are rarer."""
    if later:
        other, _ = series.around(near.t_ns + STRETCH_NS)
    else:
        _, other = series.around(near.t_ns - STRETCH_NS - 1)
    if other is None or other.segment != near.segment or other.t_ns == near.t_ns:
        other = series.next_to(near, 1 if later else -1)
    return enclosing(near, other, reach) if later else enclosing(other, near, reach)


def _blended(a: "Sample[V]", b: "Sample[V]", t_ns: int, course: Course[V]) -> "Sample[V]":
    fraction = (t_ns - a.t_ns) / (b.t_ns - a.t_ns)
    return Sample(t_ns, course.blend(a.value, b.value, fraction), a.segment)


def _nearest(
    before: "Sample[V] | None", after: "Sample[V] | None", t_ns: int
) -> "Sample[V] | None":
    if before is None or after is None:
        return before or after
    return before if t_ns - before.t_ns <= after.t_ns - t_ns else after


def _too_far(before: "Sample[V] | None", after: "Sample[V] | None", t_ns: int) -> Reject:
    if before is None and after is not None:
        return Reject(
            "before_odometry", f"{(after.t_ns - t_ns) / 1e9:.3f} s before the oldest record"
        )
    if before is not None and after is None:
        return Reject(
            "after_odometry", f"{(t_ns - before.t_ns) / 1e9:.3f} s after the newest record"
        )
    assert before is not None  # noqa: S101 - who calls has found a sample
    assert after is not None  # noqa: S101
    gap_s = (after.t_ns - before.t_ns) / 1e9
    return Reject("odometry_gap", f"in a gap of {gap_s:.3f} s, or across a reset")
