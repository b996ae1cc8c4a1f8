"""Dead reckoning: the displacement by velocity over ground and attitude."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapperd.odometry.series import Sample, Series, SeriesState

__all__ = ["DeadReckoning", "DeadReckoningState", "ReckonedDisplacement"]

Floats = NDArray[np.float64]

MAX_WAITING = 1024
"""Maximum number of velocities that wait for an attitude at their time."""


@dataclass(frozen=True, slots=True, eq=False)
class ReckonedDisplacement:
    """Displacement since the start of dead reckoning.

    Attributes:
        displacement_m: (3,) displacement, map axes.
        velocity_mps: (3,) at its end, map axes.
        variance_m2: accumulated variance of each axis.
    """

    displacement_m: Floats
    velocity_mps: Floats
    variance_m2: float


class DeadReckoningState(NamedTuple):
    """State of a `DeadReckoning`.

    Attributes:
        waiting: time, velocity, whether in map axes, and noise, of waiting velocities.
        segment: segment of the newest displacement.
        displacements: since the start of dead reckoning.
        without_attitude: as in `DeadReckoning`.
    """

    waiting: list[tuple[int, Floats | None, bool, float | None]]
    segment: int
    displacements: SeriesState
    without_attitude: int


class DeadReckoning:
    """Integrates velocities with known attitude by the trapezoid rule.

    Args:
        max_gap_ns: maximum interval between velocities that is integrated.
        noise: growth of the standard deviation, m per square root of a second.

    Attributes:
        max_gap_ns, noise: may be changed.
        displacements: since the start of dead reckoning.
    """

    def __init__(self, max_gap_ns: int, noise: float) -> None:
        self.max_gap_ns = max_gap_ns
        self.noise = noise
        self._waiting: deque[tuple[int, Floats | None, bool, float | None]] = deque()
        self._segment = 0
        self.displacements: Series[ReckonedDisplacement] = Series()
        self.without_attitude = 0
        """Number of velocities without an attitude at their time."""

    def add(
        self, t_ns: int, velocity_mps: Floats | None, *, in_map: bool, noise: float | None = None
    ) -> None:
        """Add a velocity; None reports its loss, which interrupts dead reckoning.

        Args:
            t_ns: host time, later than all before.
            velocity_mps: (3,).
            in_map: the velocity is in map axes, otherwise in base axes.
            noise: standard deviation that the source states, m/s.
        """
        if len(self._waiting) >= MAX_WAITING:
            self._waiting.popleft()
            self.without_attitude += 1
        self._waiting.append((t_ns, velocity_mps, in_map, noise))

    def state(self) -> DeadReckoningState:
        """Return the state for `restore`."""
        return DeadReckoningState(
            list(self._waiting), self._segment, self.displacements.state(), self.without_attitude
        )

    def restore(self, state: DeadReckoningState) -> None:
        """Restore a state that `state` returned."""
        self._waiting, self._segment = deque(state.waiting), state.segment
        self.displacements.restore(state.displacements, ReckonedDisplacement)
        self.without_attitude = state.without_attitude

    def restart(self) -> None:
        """Discard everything, because time was set back."""
        self._waiting.clear()
        self.displacements.clear()
        self._segment += 1

    def advance(
        self, matrix_at: Callable[[int], Floats | None], known_until_ns: int | None
    ) -> None:
        """Integrate velocities up to the newest attitude.

        Args:
            matrix_at: rotation (3, 3), map from base, at a moment; None where unknown.
            known_until_ns: time of the newest attitude; later velocities wait for the next one.
        """
        while self._waiting:
            t_ns, velocity, in_map, noise = self._waiting[0]
            if velocity is None:
                self._segment += 1
            elif in_map:
                self._sum_up(t_ns, velocity, noise)
            else:
                if known_until_ns is None or t_ns > known_until_ns:
                    return
                matrix = matrix_at(t_ns)
                if matrix is None:
                    self._segment += 1
                    self.without_attitude += 1
                else:
                    self._sum_up(t_ns, matrix @ velocity, noise)
            self._waiting.popleft()

    def at(self, t_ns: int) -> "Sample[ReckonedDisplacement] | None":
        """Return the displacement at a time; at most one gap beyond the newest velocity."""
        before, after = self.displacements.around(t_ns)
        if before is None:
            return None
        old, seconds = before.value, (t_ns - before.t_ns) / 1e9
        if after is not None and after.segment == before.segment:
            # Velocity is linear between two reports, so the displacement is a parabola.
            fraction = (t_ns - before.t_ns) / (after.t_ns - before.t_ns)
            new = after.value
            velocity = old.velocity_mps + fraction * (new.velocity_mps - old.velocity_mps)
            variance = old.variance_m2 + fraction * (new.variance_m2 - old.variance_m2)
        elif t_ns - before.t_ns <= self.max_gap_ns:
            velocity = old.velocity_mps
            variance = old.variance_m2 + seconds * self.noise**2
        else:
            return None
        moved_m = old.displacement_m + 0.5 * seconds * (old.velocity_mps + velocity)
        return Sample(t_ns, ReckonedDisplacement(moved_m, velocity, variance), before.segment)

    def _sum_up(self, t_ns: int, velocity_mps: Floats, noise: float | None) -> None:
        last = self.displacements.newest
        if last is not None and t_ns <= last.t_ns:
            return
        if last is None or last.segment != self._segment or t_ns - last.t_ns > self.max_gap_ns:
            self._segment += last is not None and last.segment == self._segment
            zero = np.zeros(3) if last is None else last.value.displacement_m
            variance = 0.0 if last is None else last.value.variance_m2
            first = ReckonedDisplacement(zero, velocity_mps, variance)
            self.displacements.add(t_ns, first, self._segment)
            return
        seconds = (t_ns - last.t_ns) / 1e9
        old = last.value
        moved_m = old.displacement_m + 0.5 * seconds * (old.velocity_mps + velocity_mps)
        # A velocity's error lasts for about a second: its variance grows with the time.
        growth = seconds * (self.noise if noise is None else noise) ** 2
        new = ReckonedDisplacement(moved_m, velocity_mps, old.variance_m2 + growth)
        self.displacements.add(t_ns, new, self._segment)
