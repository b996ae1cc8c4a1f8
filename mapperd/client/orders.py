"""Which of the messages about the map are newer, where two lines bring them."""

from dataclasses import dataclass

from mapperd.wire.framing import StreamError

__all__ = ["MOST_FORGOTTEN", "Orders"]

MOST_FORGOTTEN = 1 << 16
"""Blocks that are not there any more, and whose orders are remembered."""


@dataclass(slots=True)
class Orders:
    """How far the lines of one connection have come.

    Attributes:
        first: the highest order on the first line, on which none goes down.
        second: the highest order on all its second lines.
        floor: what a second line brings of this or a lower order is of before the last reset.
        is_beside: there is a second line, which may bring something older than what is here.
    """

    first: int = 0
    second: int = 0
    floor: int = -1
    is_beside: bool = False

    @property
    def newest(self) -> int:
        """The highest order of any message."""
        return max(self.first, self.second)

    def reset(self, order: int) -> None:
        """The first line says that all blocks up to an order are forgotten.

        Raises:
            StreamError: of what comes after it something was told before it, and would be lost.
        """
        if order < self.second:
            raise StreamError("a reset that its own blocks overtook", "bad_order")
        self.floor = order
