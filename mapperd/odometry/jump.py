"""A record that does not follow from the one before: one is a fault, two that agree are a jump."""

from collections.abc import Callable
from typing import Generic, TypeVar

__all__ = ["JumpWatch"]

V = TypeVar("V")


class JumpWatch(Generic[V]):
    """Tells motion, faults and jumps apart.

    Args:
        excess: how far two values are apart beyond what so many seconds of motion explain, as a
            multiple of the allowed jump: above 1 is too far.
    """

    def __init__(self, excess: Callable[[V, V, float], float]) -> None:
        self._excess = excess
        self._last: tuple[int, V] | None = None
        self._suspect: tuple[int, V] | None = None

    def check(self, t_ns: int, value: V) -> bool | None:
        """Judge a value that is newer than all before it.

        Returns:
            False where it follows from the last one, True where a jump is confirmed by it, and
            None where it stands alone and is not to be used.
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

    def moved(self, t_ns: int, value: V) -> None:
        """Take a jump that is known to be one."""
        self._last, self._suspect = (t_ns, value), None

    def _follows(self, before: tuple[int, V], t_ns: int, value: V) -> bool:
        return self._excess(before[1], value, (t_ns - before[0]) / 1e9) <= 1.0
