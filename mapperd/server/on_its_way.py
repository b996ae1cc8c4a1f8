"""Blocks in messages that were told and that the client may not have: a break loses them."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

__all__ = ["OnItsWay"]

MOST_BLOCKS, MOST_MESSAGES = 1 << 17, 4096
"""Half a MiB of a line; whoever has more on its way when its link breaks begins anew."""

Numbers = NDArray[np.int64]


class OnItsWay:
    """Of one line of a client: its messages about the map, numbered from 1 on.

    Attributes:
        number: of the last message.
        settled: of the last one that was used, as far as is known.
    """

    def __init__(self) -> None:
        self.number = self.settled = 0
        self._forgotten = 0
        self._messages: deque[tuple[int, NDArray[np.uint32]]] = deque()
        self._blocks = 0

    @property
    def memory_bytes(self) -> int:
        """Of what is remembered."""
        return 4 * self._blocks

    def note(self, numbers: Numbers) -> None:
        """One more message, with these blocks."""
        self.number += 1
        self._messages.append((self.number, numbers.astype(np.uint32)))
        self._blocks += len(numbers)
        while self._blocks > MOST_BLOCKS or len(self._messages) > MOST_MESSAGES:
            self._forget()

    def note_reset(self) -> None:
        """One more message, without which the client has another map: nobody goes on before it."""
        self.number += 1
        self.settle(self.number)

    def settle(self, number: int) -> None:
        """The client has used messages up to this one."""
        self.settled = max(self.settled, number)
        self._forgotten = max(self._forgotten, number)
        while self._messages and self._messages[0][0] <= number:
            self._forget()

    def beyond(self, number: int) -> Numbers | None:
        """The blocks of later messages; None where these are not remembered."""
        if not self._forgotten <= number <= self.number:
            return None
        later = [blocks for at, blocks in self._messages if at > number]
        return np.unique(np.concatenate([np.zeros(0, np.uint32), *later])).astype(np.int64)

    def unsettled(self) -> Numbers | None:
        """The blocks of all that may not be used yet; None where they are not remembered."""
        return self.beyond(self.settled)

    def _forget(self) -> None:
        number, blocks = self._messages.popleft()
        self._forgotten = max(self._forgotten, number)
        self._blocks -= len(blocks)
