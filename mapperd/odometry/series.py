"""Recent values of one quantity of the vehicle, and its value at a time."""

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
    "InterpolationLimits",
    "Interpolator",
    "Sample",
    "Series",
    "SeriesState",
    "enclosing",
    "is_settled",
    "value_at",
    "velocity_samples",
]

MAX_SAMPLES = 8192
"""Maximum number of samples: 20 s at 400 Hz; the oldest are dropped."""

V = TypeVar("V")


@dataclass(frozen=True, slots=True)
class Sample(Generic[V]):
    """A value at one time.

    Attributes:
        t_ns: host time.
        value: value of the quantity.
        segment: samples of different segments are separated by a jump of the estimate, not by
            motion.
    """

    t_ns: int
    value: V
    segment: int


class SeriesState(NamedTuple):
    """State of a `Series` of n samples.

    Attributes:
        t_ns, segment: int64 (n,).
        columns: values of each field, in order: (n, ...) if all are numbers or arrays of one
            shape, otherwise a list of n.
    """

    t_ns: NDArray[np.int64]
    segment: NDArray[np.int64]
    columns: list[Any]


class Series(Generic[V]):
    """Samples, oldest first.

    Args:
        max_samples: maximum number of samples.
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
        """Return all samples; values are arrays or records of a few fields."""
        samples = self._samples
        return SeriesState(
            np.array([one.t_ns for one in samples], dtype=np.int64),
            np.array([one.segment for one in samples], dtype=np.int64),
            [_column(column) for column in _columns([one.value for one in samples])],
        )

    def restore(self, state: SeriesState, make: Callable[..., V]) -> None:
        """Restore the samples of a state.

        Args:
            state: state of a series of the same values.
            make: makes a value from its fields.
        """
        rows = zip(
            state.t_ns.tolist(), state.segment.tolist(), *map(_values, state.columns), strict=True
        )
        self._samples = deque(
            (Sample(t_ns, make(*parts), segment) for t_ns, segment, *parts in rows),
            maxlen=self._samples.maxlen,
        )

    def problem(self, t_ns: int) -> Reject | None:
        """Return why a sample of that time is refused, or None."""
        if self._samples and t_ns <= self._samples[-1].t_ns:
            late_s = (self._samples[-1].t_ns - t_ns) / 1e9
            return Reject("back_in_time", f"{late_s:g} s before the newest record, or equal to it")
        return None

    def add(self, t_ns: int, value: V, segment: int) -> None:
        """Add a sample that is newer than all before it (see `problem`)."""
        self._samples.append(Sample(t_ns, value, segment))

    def clear(self) -> None:
        """Remove all samples."""
        self._samples.clear()

    def around(self, t_ns: int) -> "tuple[Sample[V] | None, Sample[V] | None]":
        """Return the last sample at or before a time, and the first after it."""
        samples = self._samples
        if not samples:
            return None, None
        after = self._place(t_ns)
        return (
            samples[after - 1] if after > 0 else None,
            samples[after] if after < len(samples) else None,
        )

    def next_to(self, sample: "Sample[V]", step: int) -> "Sample[V] | None":
        """Return the next (1) or previous (-1) sample of one, or None."""
        place = self._place(sample.t_ns) - 1 + step
        return self._samples[place] if 0 <= place < len(self._samples) else None

    def _place(self, t_ns: int) -> int:
        """Return the index of the first sample after a time; search near the newest first."""
        samples = self._samples
        if samples[-1].t_ns <= t_ns:
            return len(samples)
        return bisect_right(samples, t_ns, key=lambda sample: sample.t_ns)


def _columns(values: list[Any]) -> list[list[Any]]:
    """Return the values of each field, in order; arrays give one column."""
    if not values or isinstance(values[0], np.ndarray):
        return [values] if values else []
    return [list(map(attrgetter(field.name), values)) for field in fields(values[0])]


def _column(values: list[Any]) -> Any:  # noqa: ANN401 an array or a list
    """Return one array if the values are alike; keep its order, which affects rounding."""
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
    """Return copies of the rows of a column."""
    if not isinstance(column, np.ndarray):
        return list(column)
    return column.tolist() if column.ndim == 1 else [row.copy() for row in column]


VELOCITY_WINDOW_NS = 100_000_000
"""Interval on both sides of a time from which velocity is computed.

A shorter one takes noise for motion, a longer one cuts turns. 1 cm of noise gives 7 cm/s, which
moves a sample by 1 mm in 20 ms.
"""


class Interpolator(Generic[V]):
    """Interpolation and extrapolation of a quantity.

    Attributes:
        interpolate: interpolates from the value at 0 to that at 1; the fraction may lie outside.
        extrapolate: extrapolates a value by its own rate for some seconds, also backwards; None
            without a rate.
    """

    def __init__(
        self, interpolate: Callable[[V, V, float], V], extrapolate: Callable[[V, float], V | None]
    ) -> None:
        self.interpolate = interpolate
        self.extrapolate = extrapolate


@dataclass(frozen=True, slots=True)
class InterpolationLimits:
    """Limits of interpolation and extrapolation.

    Attributes:
        policy: `time_sync.policy`.
        max_gap_ns: maximum interval between samples that is interpolated.
        max_reach_ns: maximum time of extrapolation from a sample.
    """

    policy: str
    max_gap_ns: int
    max_reach_ns: int

    @classmethod
    def of(cls, settings: TimeSyncConfig) -> "InterpolationLimits":
        """Return the limits of the settings."""
        return cls(
            settings.policy,
            round(settings.max_gap_sec * 1e9),
            round(settings.max_stamp_diff_sec * 1e9),
        )


def value_at(
    series: Series[V], t_ns: int, limits: InterpolationLimits, interpolator: Interpolator[V]
) -> "Sample[V] | Reject":
    """Return the quantity at a time.

    interpolate: blend the two enclosing samples if they are of one segment and at most `max_gap`
    apart. Otherwise extrapolate the nearest sample if it is at most `max_reach` away: by its own
    rate, by the motion next to it for no longer than that was observed, or constant.
    nearest and latest: that sample, if it is at most `max_reach` away.
    """
    before, after = series.around(t_ns)
    if limits.policy == "interpolate":
        if before is not None and before.t_ns == t_ns:
            return before
        if (pair := enclosing(before, after, limits)) is not None:
            return _blended(*pair, t_ns, interpolator)
    near = _nearest(before, after, t_ns) if limits.policy != "latest" else series.newest
    if near is None:
        return Reject("no_odometry", "no odometry so far")
    if abs(near.t_ns - t_ns) > limits.max_reach_ns:
        return _too_far(before, after, t_ns)
    return (
        near
        if limits.policy != "interpolate"
        else _carried(series, near, t_ns, limits, interpolator)
    )


def enclosing(
    before: "Sample[V] | None", after: "Sample[V] | None", limits: InterpolationLimits
) -> "tuple[Sample[V], Sample[V]] | None":
    """Return both samples if there is motion between them."""
    if before is None or after is None or before.segment != after.segment:
        return None
    return (before, after) if after.t_ns - before.t_ns <= limits.max_gap_ns else None


def is_settled(series: Series[V], t_ns: int, limits: InterpolationLimits) -> bool:
    """Whether later samples cannot improve the quantity at a time."""
    before, after = series.around(t_ns)
    if before is not None and before.t_ns == t_ns:
        return True
    newest = series.newest
    if after is None or newest is None:
        return False
    if limits.policy != "interpolate" or enclosing(before, after, limits) is not None:
        return True
    # After a gap, one record does not determine the motion before it.
    back_ns = after.t_ns - t_ns
    return back_ns > limits.max_reach_ns or newest.t_ns - after.t_ns >= back_ns


def velocity_samples(
    series: Series[V], t_ns: int, limits: InterpolationLimits
) -> "tuple[Sample[V], Sample[V]] | None":
    """Return the samples that determine the velocity at a time, or None.

    They are up to `VELOCITY_WINDOW_NS` away on both sides; if records are rarer, or one jumps, the
    two enclosing samples.
    """
    _, first = series.around(t_ns - VELOCITY_WINDOW_NS - 1)
    last, _ = series.around(t_ns + VELOCITY_WINDOW_NS)
    if (
        first is not None
        and last is not None
        and first.segment == last.segment
        and last.t_ns - first.t_ns >= VELOCITY_WINDOW_NS // 2
    ):
        return first, last
    return enclosing(*series.around(t_ns), limits)


def _carried(
    series: Series[V],
    near: "Sample[V]",
    t_ns: int,
    limits: InterpolationLimits,
    interpolator: Interpolator[V],
) -> "Sample[V]":
    carried = interpolator.extrapolate(near.value, (t_ns - near.t_ns) / 1e9)
    if carried is not None:
        return Sample(t_ns, carried, near.segment)
    pair = _beside(series, near, limits, later=near.t_ns > t_ns)
    # Extrapolating farther than their distance would magnify noise.
    if pair is None or abs(t_ns - near.t_ns) > pair[1].t_ns - pair[0].t_ns:
        return Sample(t_ns, near.value, near.segment)
    return _blended(*pair, t_ns, interpolator)


def _beside(
    series: Series[V], near: "Sample[V]", limits: InterpolationLimits, *, later: bool
) -> "tuple[Sample[V], Sample[V]] | None":
    """Return a sample and one up to `VELOCITY_WINDOW_NS` away, or the next one."""
    if later:
        other, _ = series.around(near.t_ns + VELOCITY_WINDOW_NS)
    else:
        _, other = series.around(near.t_ns - VELOCITY_WINDOW_NS - 1)
    if other is None or other.segment != near.segment or other.t_ns == near.t_ns:
        other = series.next_to(near, 1 if later else -1)
    return enclosing(near, other, limits) if later else enclosing(other, near, limits)


def _blended(
    a: "Sample[V]", b: "Sample[V]", t_ns: int, interpolator: Interpolator[V]
) -> "Sample[V]":
    fraction = (t_ns - a.t_ns) / (b.t_ns - a.t_ns)
    return Sample(t_ns, interpolator.interpolate(a.value, b.value, fraction), a.segment)


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
