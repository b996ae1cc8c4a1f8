"""When the next message, and the next attempt, is due; times are given, nothing asks a clock."""

import math
from collections.abc import Callable

__all__ = ["BackOff", "Pace"]

EARLY = 0.1
"""Of a period: who asks at about the same rate would else miss every second one."""


class Pace:
    """At most so often on average; two are at least half a period apart.

    Args:
        period_s: between two; may be set anew.
    """

    def __init__(self, period_s: float) -> None:
        self.period_s = period_s
        self._next_s = -math.inf

    def due(self, now_s: float) -> bool:
        """Whether it is time; if so, the next one is due a period later."""
        if not -self.period_s <= self._next_s - now_s <= 1.5 * self.period_s:
            self._next_s = now_s  # after a pause nothing is made up for; or the period has shrunk
        if now_s < self._next_s - EARLY * self.period_s:
            return False
        self._next_s = max(self._next_s + self.period_s, now_s + self.period_s / 2)
        return True


class BackOff:
    """Pauses between attempts: random, so that a fleet does not come back at once.

    Each is between the shortest and three times the one before, 30 s at most; a connection that
    held for so long begins anew.

    Args:
        chance: gives random numbers from 0 to 1.
    """

    LEAST_S = 1.0
    MOST_S = 30.0

    def __init__(self, chance: Callable[[], float]) -> None:
        self._chance = chance
        self._last_s = self.LEAST_S

    def after(self, connected_s: float) -> float:
        """The pause after a connection that lasted so long, or that never came about.

        Args:
            connected_s: 0 where there was none.
        """
        if connected_s >= self.MOST_S:
            self._last_s = self.LEAST_S
        most_s = min(self.MOST_S, 3 * self._last_s)
        self._last_s = self.LEAST_S + self._chance() * (most_s - self.LEAST_S)
        return self._last_s
