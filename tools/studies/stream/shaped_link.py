"""A bad link, as a rule: what becomes of each packet that is put into it."""

import random
from dataclasses import dataclass

__all__ = ["LinkShape", "ShapedLink"]


@dataclass(frozen=True, slots=True)
class LinkShape:
    """One direction of a link.

    Attributes:
        bits_per_s: that go through.
        delay_s: of every packet, after its turn.
        loss: share of packets that vanish.
        queue_bytes: that wait for their turn; what comes on top vanishes too.
    """

    bits_per_s: float = 256e3
    delay_s: float = 0.3
    loss: float = 0.05
    queue_bytes: int = 64 << 10


class ShapedLink:
    """Decides, for packets in the order of their times, when they come out.

    Args:
        shape: of the link.
        dice: seeds the losses.

    Attributes:
        lost, overflowed: packets that vanished by chance, and for want of room.
        bytes: that came through.
    """

    def __init__(self, shape: LinkShape, dice: int) -> None:
        self.lost = self.overflowed = self.bytes = 0
        self._shape = shape
        self._random = random.Random(dice)  # noqa: S311 no secret
        self._free_s = 0.0

    def arrives_s(self, now_s: float, size: int) -> float | None:
        """When a packet that comes now is at the other end; None for never."""
        shape = self._shape
        waiting_s = max(self._free_s - now_s, 0.0)
        if waiting_s * shape.bits_per_s / 8 + size > shape.queue_bytes:
            self.overflowed += 1
            return None
        self._free_s = now_s + waiting_s + size * 8 / shape.bits_per_s
        if self._random.random() < shape.loss:
            self.lost += 1
            return None
        self.bytes += size
        return self._free_s + shape.delay_s
