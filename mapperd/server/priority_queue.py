"""The order in which blocks of the map are sent, and when: near the vehicle first, in passes.

On a full link each packet waits behind others, and blocks right before the sonar change all the
time. So blocks near the vehicle are sent in passes: each block once, longest wait first, with a
rest between two passes. A block that changes during a pass belongs to the next one, and is sent
with the last message of this one if there is room. Far blocks are sent in the rests, by distance,
and only as many as delay no pass.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mapperd.server.map_index import distances_m
from mapperd.server.pacer import Pacer
from mapperd.wire.messages import Vector

__all__ = ["BlockQueue", "Part", "SendRoom", "SendSchedule"]

FRONT = 16384
"""Blocks that are sorted at a time: sorting all blocks of a large map would delay each message."""

NEAR_M = 13.0
"""Radius of the near map: the 10 m a pilot steers by, and what a vehicle reaches in seconds."""

WAITING, IN_FRONT = 2, 4
"""Bits of a block's flags."""

Numbers = NDArray[np.int64]
Part = Literal["near", "far", "any"]
KeysOf = Callable[[Numbers], NDArray[np.int32]]


class BlockQueue:
    """A priority queue of numbered blocks.

    It holds one byte of flags per block, and sorts only a front of the blocks that wait.

    Args:
        keys_of: returns the keys (N, 3) of block numbers (N,).
        block_m: edge of a block.

    Attributes:
        flags: uint8 per block; the queue uses `WAITING` and `IN_FRONT`, its owner the other bits.
        near_left: near blocks that are left of this pass after the ones returned last. At 0, the
            next request for near blocks begins a new pass.
    """

    def __init__(self, keys_of: KeysOf, block_m: float) -> None:
        self.flags = np.zeros(0, np.uint8)
        self.near_left = 0
        self._keys_of = keys_of
        self._block_m = block_m
        self._waiting = 0
        self._front = np.zeros(0, np.int64)
        self._front_keys = np.zeros((0, 3), np.int32)
        self._front_turns = np.zeros(0, np.float64)
        self._turn = self._pass = 0.0
        self._added_at: int | None = None
        self._reach_m = np.inf
        self._ordered_at = np.zeros(3)

    def __len__(self) -> int:
        return self._waiting

    def make_room(self, blocks: int) -> None:
        """Grow to this number of blocks."""
        if blocks > len(self.flags):
            more = np.zeros(max(blocks, len(self.flags) + len(self.flags) // 2), np.uint8)
            more[: len(self.flags)] = self.flags
            self.flags = more

    def add(self, numbers: Numbers, at: int) -> None:
        """Add blocks; blocks that wait already stay where they are.

        Args:
            numbers: of the blocks.
            at: time of the look that found them; blocks of one look have equal priority.
        """
        if at != self._added_at:
            self._added_at = at
            self._turn += 1
        new = numbers[self.flags[numbers] & WAITING == 0]
        self.flags[new] |= WAITING
        self._waiting += len(new)
        if len(self._front) + len(new) <= 2 * FRONT:
            self._put_in_front(new)
        else:
            self._reach_m = -np.inf  # some of these may be nearer than all of the front

    def remove(self, numbers: Numbers) -> None:
        """Remove blocks of the front: they were sent or are no longer needed."""
        self.flags[numbers] &= np.uint8(~(WAITING | IN_FRONT) & 0xFF)
        self._waiting -= len(numbers)
        kept = self.flags[self._front] & IN_FRONT != 0
        self._front, self._front_keys = self._front[kept], self._front_keys[kept]
        self._front_turns = self._front_turns[kept]

    def nearest(self, most: int, position_m: Vector | None, part: Part = "any") -> Numbers:
        """Return up to `most` blocks, most urgent first, and keep them in the queue."""
        position = np.zeros(3) if position_m is None else np.asarray(position_m, float)
        order, far_m = self._order(most, position, part)
        if len(self._front) < self._waiting:
            moved_m = float(np.linalg.norm(position - self._ordered_at))
            # If the front reaches beyond the near radius, it holds all near blocks already.
            short = len(order) < most and (part != "near" or self._reach_m - moved_m < NEAR_M)
            if short or far_m > self._reach_m - moved_m:
                self._choose_front(position)
                order, _ = self._order(most, position, part)
        return self._front[order]

    def _order(
        self, most: int, position: NDArray[np.float64], part: Part
    ) -> tuple[NDArray[np.intp], float]:
        """Return the most urgent blocks of the front, and the distance of the farthest of them."""
        away_m = distances_m(self._front_keys, self._block_m, tuple(position))
        near = away_m <= NEAR_M
        rank = np.where(near, self._front_turns + away_m / (2 * NEAR_M), away_m)
        near_count = int(np.count_nonzero(near))
        room = {"near": 0, "far": most, "any": max(most - near_count, 0)}[part]
        far_count = min(len(near) - near_count, room)
        near_most = 0 if part == "far" else min(most - far_count, near_count)
        if part != "far":
            of_pass = int(np.count_nonzero(near & (self._front_turns <= self._pass)))
            if not of_pass:
                self._pass, of_pass = self._turn, near_count
            self.near_left = max(of_pass - near_most, 0)
        order = np.concatenate(
            [
                _least(rank, np.flatnonzero(near), near_most),
                _least(rank, np.flatnonzero(~near), far_count),
            ]
        )
        return order, float(away_m[order].max(initial=0.0))

    def _choose_front(self, position: NDArray[np.float64]) -> None:
        """Choose the nearest of all waiting blocks as the front."""
        self.flags[self._front] &= np.uint8(~IN_FRONT & 0xFF)
        self._reach_m = np.inf
        front, away_m = np.zeros(0, np.int64), np.zeros(0)
        for begin in range(0, len(self.flags), FRONT):
            some = begin + np.flatnonzero(self.flags[begin : begin + FRONT] & WAITING)
            some_m = distances_m(self._keys_of(some), self._block_m, tuple(position))
            front, away_m = np.concatenate([front, some]), np.concatenate([away_m, some_m])
            if len(front) > FRONT:
                order = np.argpartition(away_m, FRONT)
                self._reach_m = min(self._reach_m, float(away_m[order[FRONT]]))
                front, away_m = front[order[:FRONT]], away_m[order[:FRONT]]
        self._front_turns = self._turns_of(front)
        self._front, self._front_keys = front, self._keys_of(front)
        self.flags[front] |= IN_FRONT
        self._ordered_at = position

    def _turns_of(self, numbers: Numbers) -> NDArray[np.float64]:
        """Return the turns since which blocks wait; blocks new to the front wait from now on."""
        turns = np.full(len(numbers), self._turn)
        _, here, before = np.intersect1d(
            numbers, self._front, assume_unique=True, return_indices=True
        )
        turns[here] = self._front_turns[before]
        return turns

    def _put_in_front(self, numbers: Numbers) -> None:
        self.flags[numbers] |= IN_FRONT
        self._front = np.concatenate([self._front, numbers])
        self._front_keys = np.concatenate([self._front_keys, self._keys_of(numbers)])
        turns = np.full(len(numbers), self._turn)
        self._front_turns = np.concatenate([self._front_turns, turns])


def _least(rank: NDArray[np.float64], of: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    """Return the `most` of the indices `of` with the lowest ranks, sorted by rank."""
    if len(of) > most > 0:
        of = of[np.argpartition(rank[of], most - 1)[:most]]
    chosen: NDArray[np.intp] = of[np.argsort(rank[of], kind="stable")][:most]
    return chosen


DUTY, MAX_REST_S = 0.6, 0.6
"""Share of the time that passes keep the link busy, and the longest rest after a pass."""

IDLE, ASIDE_S = 0.4, 0.15
"""Share of what the link delivers in a round trip plus `ASIDE_S`: a message of far blocks is sent
between near ones only if less is in flight."""

QUIET_S = 2.0
"""Time after the last pass until far blocks may use the whole link."""

EACH = 8
"""Near messages in a row, after which a far one may follow even if near blocks are left."""

SHARE = 0.9
"""Share of the window for the map, so that a pose never waits for an acknowledgement of the map."""

MIN = 600
"""Smallest message in bytes: blocks take less room the more of them are in one."""


@dataclass(frozen=True, slots=True)
class SendRoom:
    """Bytes of near and far blocks that may be sent now."""

    near: int = 0
    far: int = 0

    def __bool__(self) -> bool:
        return bool(self.near or self.far)


class SendSchedule:
    """Passes and rests of one client. Callers pass the time in seconds.

    Args:
        pacer: of its connection.
    """

    def __init__(self, pacer: Pacer) -> None:
        self._pacer = pacer
        self._began_s: float | None = None
        self._bytes = self._messages = 0
        self._rests_until_s = 0.0
        self._near_s: float | None = None

    def rooms(self, now_s: float) -> SendRoom:
        """Return the bytes that may be sent now."""
        pacer = self._pacer
        room = int(min(pacer.max_in_flight * SHARE - pacer.in_flight, pacer.room(now_s) * SHARE))
        if room < max(MIN, SHARE * pacer.least()):
            return SendRoom()
        near = room if now_s >= self._rests_until_s else 0
        if self._near_s is None or now_s - self._near_s > QUIET_S:
            return SendRoom(near, room)
        rate = pacer.allowed_rate
        wire = rate * (ASIDE_S + (pacer.round_trip_s or 0.0))
        is_idle = pacer.in_flight <= IDLE * wire or self._messages >= EACH
        return SendRoom(near, room if is_idle else 0)

    def sent_near(self, size: int, left: int, now_s: float) -> None:
        """Note a message of near blocks: its bytes, and the blocks that are left of the pass."""
        self._near_s = now_s
        if self._began_s is None:
            self._began_s = now_s
        self._bytes += size
        self._messages += 1
        if not left:
            self.end_pass()

    def end_pass(self) -> None:
        """End the pass: no near blocks are left, or the vehicle has moved away from them."""
        if self._began_s is not None:
            rest_s = min(self._bytes / (DUTY * self._pacer.allowed_rate), MAX_REST_S)
            self._rests_until_s = self._began_s + rest_s
            self._began_s, self._bytes, self._messages = None, 0, 0

    def sent_far(self) -> None:
        """Note a message of far blocks."""
        self._messages = 0
