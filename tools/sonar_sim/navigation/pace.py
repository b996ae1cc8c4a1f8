"""Messages that come less often than fixes."""

EARLY = 1e-6


class Every:
    """Says when a message is due.

    Args:
        period_s: between two of them.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._due_s: float | None = None

    def due(self, time_s: float) -> bool:
        """Whether it is due now; it then counts as sent."""
        if self._due_s is not None and time_s < self._due_s - EARLY:
            return False
        late = self._due_s is None or time_s > self._due_s + self._period_s
        self._due_s = (time_s if late or self._due_s is None else self._due_s) + self._period_s
        return True
