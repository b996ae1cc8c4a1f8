"""Delays between attempts to reach a peer."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

__all__ = ["BackOff", "doubling_steps"]


class BackOff:
    """Delays that grow with each failure, until an attempt succeeds.

    A delay is random between half of its step and the whole step, so that programs that lost the
    same peer do not return at the same time.

    Args:
        steps: delay after the first failure, after the second, and so on; the last one repeats. Any
            unit.
        chance: returns random numbers from 0, the whole step, to 1, half of it; None for whole
            steps.

    Attributes:
        failures: since the last success.
    """

    def __init__(self, steps: Sequence[float], chance: Callable[[], float] | None = None) -> None:
        self.failures = 0
        self._steps = steps
        self._chance = chance

    def failed(self) -> float:
        """Count a failure; return the delay until the next attempt."""
        self.failures += 1
        step = self._steps[min(self.failures, len(self._steps)) - 1]
        return step if self._chance is None else step * (1.0 - 0.5 * self._chance())

    def succeeded(self) -> None:
        """Begin again with the first step."""
        self.failures = 0


def doubling_steps(first: float, longest: float) -> tuple[float, ...]:
    """Steps that double from the first to the longest."""
    steps = [first]
    while steps[-1] < longest:
        steps.append(min(2 * steps[-1], longest))
    return tuple(steps)
