"""Bytes a second that one client may be sent, over however many connections."""

__all__ = ["Budget"]

BURST_S, LEAST_BURST = 0.2, 2048


class Budget:
    """Fills up as time passes, which whoever calls says in seconds that never go back.

    Args:
        bytes_per_s: never more, in the long run; 0 has no limit.

    Attributes:
        bytes_per_s: as given; may be changed.
    """

    def __init__(self, bytes_per_s: int = 0) -> None:
        self.bytes_per_s = bytes_per_s
        self._left = float(LEAST_BURST)
        self._filled_s: float | None = None

    @property
    def burst(self) -> float:
        """Bytes that it holds at most."""
        return max(BURST_S * self.bytes_per_s, LEAST_BURST)

    def left(self, now_s: float) -> float:
        """Bytes that may be sent now, if there is a limit; less than 0 are owed."""
        passed_s = 0.0 if self._filled_s is None else max(0.0, now_s - self._filled_s)
        self._filled_s = now_s
        self._left = min(self.burst, self._left + passed_s * self.bytes_per_s)
        return self._left

    def spend(self, size: int, now_s: float) -> None:
        """So many were sent."""
        self._left = self.left(now_s) - (size if self.bytes_per_s else 0)
