"""The blocks that one client lacks, and those in flight to it."""

from collections import deque
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd.errors import StoreError
from mapperd.server.encoder import BlockEncoder, Body
from mapperd.server.map_index import BlockIndex, vector_of, within
from mapperd.server.priority_queue import BlockQueue, Part
from mapperd.wire.framing import framed
from mapperd.wire.messages import (
    MAX_BLOCKS,
    BlocksMessage,
    Interest,
    MapInfo,
    ResetMessage,
    Vector,
)

__all__ = ["BlockSource", "InFlight", "Subscription"]

MAX_BLOCKS_IN_FLIGHT, MAX_MESSAGES = 1 << 17, 4096
"""Limits of what is remembered: half a MiB a client. A client with more in flight cannot resume."""

Numbers = NDArray[np.int64]


class InFlight:
    """One client's messages about the map that are in flight, numbered from 1 on.

    Attributes:
        number: of the last message.
    """

    def __init__(self) -> None:
        self.number = 0
        self._forgotten = 0
        self._messages: deque[tuple[int, NDArray[np.uint32]]] = deque()
        self._blocks = 0

    @property
    def memory_bytes(self) -> int:
        """Memory of the messages."""
        return 4 * self._blocks

    def note(self, numbers: Numbers) -> None:
        """Note the next message, with these blocks."""
        self.number += 1
        self._messages.append((self.number, numbers.astype(np.uint32)))
        self._blocks += len(numbers)
        while self._blocks > MAX_BLOCKS_IN_FLIGHT or len(self._messages) > MAX_MESSAGES:
            self._forget()

    def note_reset(self) -> None:
        """Note a reset as the next message; a client cannot resume before it."""
        self.number += 1
        self.settle(self.number)

    def settle(self, number: int) -> None:
        """Forget the messages up to this one: the client has used them."""
        self._forgotten = max(self._forgotten, number)
        while self._messages and self._messages[0][0] <= number:
            self._forget()

    def beyond(self, number: int) -> Numbers | None:
        """Return the blocks of later messages; None if these were forgotten."""
        if not self._forgotten <= number <= self.number:
            return None
        later = [blocks for at, blocks in self._messages if at > number]
        return np.unique(np.concatenate([np.zeros(0, np.uint32), *later])).astype(np.int64)

    def _forget(self) -> None:
        number, blocks = self._messages.popleft()
        self._forgotten = max(self._forgotten, number)
        self._blocks -= len(blocks)


HELD = 1
"""Bit of a block's flags: the client may hold the block."""

REFRESH = 0.02
"""The radius is applied again when the vehicle has moved by this part of it."""

QUIET_NS = 1_000_000_000
"""Shortest time between two messages without blocks, which report that the map is complete."""


class BlockSource(Protocol):
    """Source of a subscription's blocks."""

    encoder: BlockEncoder
    now_ns: int
    trouble: str | None

    def view_of(self, interest: Interest) -> BlockIndex:
        """Return the index of blocks for the level and detail of an interest."""

    def info(self) -> MapInfo:
        """Return what clients must know about the map."""


class Subscription:
    """One client's interest, and the blocks that were sent; used in the source's thread only.

    Args:
        source: of the map.
        interest: of the client.
        known_up_to: revision up to which the client holds the interest; None if it holds nothing.
        reason: why the client cannot resume.

    Attributes:
        interest: of the client.
        resumed: the client may keep what it holds.
        reason: why it may not; "" if it may, or if it did not try to resume.
    """

    def __init__(
        self,
        source: BlockSource,
        interest: Interest,
        known_up_to: int | None,
        reason: str,
    ) -> None:
        self.interest = interest
        self.resumed = known_up_to is not None
        self.reason = reason
        self._source = source
        self._reset = self._closed = False
        self._in_flight = InFlight()
        self._body = 0
        self._begin(known_up_to)

    def _begin(self, known_up_to: int | None) -> None:
        self._known_up_to = known_up_to
        self._view = self._source.view_of(self.interest)
        self._view.listeners.add(self)
        self._queue = BlockQueue(self._view.keys, self._view.block_m)
        self._complete: int | None = None
        self._sent_ns = 0
        self._drawn_at: Vector | None = None
        self._drawn = False
        if len(self._view):
            self.changed(np.arange(len(self._view), dtype=np.int64))

    def close(self) -> None:
        """Stop listening for changes; dropping the subscription does the same."""
        self._view.listeners.discard(self)
        self._closed = True

    def restart(self) -> None:
        """Send a reset and all blocks again."""
        self._view.listeners.discard(self)
        self._begin(None)
        self._reset = True

    def change(self, interest: Interest) -> None:
        """Change the interest and restart."""
        self.interest = interest
        self.restart()

    @property
    def number(self) -> int:
        """Number of the last message."""
        return self._in_flight.number

    def settle(self, number: int) -> None:
        """Note that the client has used the messages up to this one."""
        self._in_flight.settle(number)

    def resume(self, interest: Interest, number: int) -> bool:
        """Resume after a message: the blocks of later ones are sent again.

        Returns:
            whether the client may keep what it holds.
        """
        numbers = self._in_flight.beyond(number)
        if self._reset or self._closed or interest != self.interest or numbers is None:
            return False
        # The client may hold earlier versions of these blocks: empty ones are sent again as well.
        self._queue.flags[numbers] |= HELD
        self._queue.add(numbers, self._source.now_ns)
        self._in_flight.settle(self._in_flight.number)
        self._complete = None
        self.resumed, self.reason = True, ""
        return True

    @property
    def left(self) -> int:
        """Blocks that are still to be sent or indexed."""
        return len(self._queue) + self._view.left

    @property
    def memory_bytes(self) -> int:
        """Memory of the block flags and of the messages in flight."""
        return int(self._queue.flags.nbytes) + self._in_flight.memory_bytes

    def changed(self, numbers: Numbers) -> None:
        """Add changed blocks to the queue."""
        self._queue.make_room(len(self._view))
        flags = self._queue.flags
        if self._known_up_to is not None:
            flags[numbers] |= HELD
            numbers = numbers[self._view.revisions[numbers] > self._known_up_to]
        held = flags[numbers] & HELD != 0
        numbers = numbers[held | (self._view.digests[numbers] != 0)]
        # `_draw` handles blocks outside of the radius: it knows where the vehicle is.
        inside = self._inside(numbers, self._drawn_at)
        self._queue.add(numbers[inside], self._source.now_ns)

    @property
    def near_left(self) -> int:
        """Near blocks that are left of this pass after the last message."""
        return self._queue.near_left

    def next(
        self, position_m: ArrayLike | None, most_bytes: int, part: Part = "any"
    ) -> bytes | None:
        """Return the next message as bytes of the wire.

        Args:
            position_m: (3,) of the vehicle, map frame; None if unknown.
            most_bytes: approximate limit; a message has at least one block.
            part: part of the map to send.

        Returns:
            a `BlocksMessage` or a `ResetMessage`; None if there is nothing to send.
        """
        message = self.next_message(position_m, most_bytes, part)
        if isinstance(message, BlocksMessage):
            return self._source.encoder.framed(message)
        return None if message is None else framed(message)

    def next_message(
        self, position_m: ArrayLike | None, most_bytes: int, part: Part = "any"
    ) -> BlocksMessage | ResetMessage | None:
        """Return what `next` returns, not encoded."""
        if self._reset:
            return self._reset_now()
        self._draw(vector_of(position_m))
        try:
            return self._next(most_bytes, part)
        except StoreError as error:
            self._source.trouble = str(error)
            return None

    def _reset_now(self) -> ResetMessage:
        self._reset = False
        self._in_flight.note_reset()
        return ResetMessage(
            map=self._source.info(), revision=self._view.looked, interest=self.interest
        )

    def _next(self, most_bytes: int, part: Part) -> BlocksMessage | None:
        encoder, detail = self._source.encoder, self.interest.detail
        most = min(encoder.blocks_in(most_bytes, self._view.level, detail), MAX_BLOCKS)
        while True:
            numbers, wanted = self._chosen(most, part)
            if not len(numbers):
                return None if len(self._queue) else self._quiet()
            body = encoder.body(self._view, detail, numbers, wanted, self._body)
            if 2 * len(body.data) <= 3 * most_bytes or len(numbers) == 1:
                break
            most = max(min(most, len(numbers)) // 2, 1)
        self._queue.remove(numbers)
        self._queue.flags[numbers] &= np.uint8(~HELD & 0xFF)
        self._queue.flags[numbers[wanted]] |= HELD
        return self._message(body, numbers)

    def _chosen(self, most: int, part: Part) -> tuple[Numbers, NDArray[np.bool_]]:
        """Return the nearest waiting blocks, and which of them are sent with their content."""
        while True:
            numbers = self._queue.nearest(most, self._drawn_at, part)
            wanted = self._inside(numbers, self._drawn_at)
            pointless = ~wanted & (self._queue.flags[numbers] & HELD == 0)
            if not pointless.any():
                return numbers, wanted
            self._queue.remove(numbers[pointless])

    def _quiet(self) -> BlocksMessage | None:
        """Report from time to time that the map is complete although it changed elsewhere."""
        settled, now_ns = self._view.settled, self._source.now_ns
        if settled is None or settled == self._complete or self._view.left:
            return None
        if not self._is_drawn:
            return None
        if self._complete is not None and now_ns - self._sent_ns < QUIET_NS:
            return None
        nothing = np.zeros(0, np.int64)
        encoder = self._source.encoder
        body = encoder.body(self._view, self.interest.detail, nothing, nothing != 0, self._body)
        return self._message(body, nothing)

    def _message(self, body: Body, numbers: Numbers) -> BlocksMessage:
        self._in_flight.note(numbers)
        self._body = body.number
        is_all = not len(self._queue) and not self._view.left and self._is_drawn
        complete = self._view.settled if is_all else None
        self._complete, self._sent_ns = complete, self._source.now_ns
        return self._source.encoder.message(body, self.left, complete)

    @property
    def _is_drawn(self) -> bool:
        return self.interest.radius_m == 0 or self._drawn_at is not None

    def _draw(self, position_m: Vector | None) -> None:
        """Find the blocks that enter and leave the interest as the vehicle moves."""
        if self.interest.radius_m == 0 and self._drawn:
            self._drawn_at = position_m
            return
        if self._drawn and not self._moved(position_m):
            return
        self._drawn, self._drawn_at = True, position_m
        self._queue.make_room(len(self._view))
        numbers = np.arange(len(self._view), dtype=np.int64)
        held = self._queue.flags[numbers] & HELD != 0
        lacking = ~held & (self._view.digests[numbers] != 0)
        inside = self._inside(numbers, position_m)
        self._queue.add(numbers[np.where(inside, lacking, held)], self._source.now_ns)

    def _moved(self, position_m: Vector | None) -> bool:
        if position_m is None or self._drawn_at is None:
            return position_m is not self._drawn_at
        moved_m = np.linalg.norm(np.subtract(position_m, self._drawn_at))
        return bool(moved_m > REFRESH * self.interest.radius_m)

    def _inside(self, numbers: Numbers, position_m: Vector | None) -> NDArray[np.bool_]:
        if self.interest.radius_m == 0 and self.interest.box is None:
            return np.ones(len(numbers), bool)
        held = self._queue.flags[numbers] & HELD != 0
        keys = self._view.keys(numbers)
        return within(keys, self._view.block_m, self.interest, position_m, held)
