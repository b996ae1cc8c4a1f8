"""One quantity of the vehicle over the recent past, in order of time."""

from bisect import bisect_right
from collections import deque
from dataclasses import dataclass
from typing import Generic, TypeVar

from mapperd.reject import Reject

__all__ = ["MAX_SAMPLES", "Sample", "Series"]

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
        """The newest sample; None while there is none."""
        return self._samples[-1] if self._samples else None

    def problem(self, t_ns: int) -> Reject | None:
        """Why a sample of that time could not be taken."""
        if self._samples and t_ns <= self._samples[-1].t_ns:
            late_s = (self._samples[-1].t_ns - t_ns) / 1e9
            return Reject("back_in_time", f"{late_s:g} s before the newest record, or equal to it")
        return None

    def add(self, t_ns: int, value: V, segment: int) -> None:
        """Take a sample that is newer than all before it (`problem` says whether it is)."""
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
