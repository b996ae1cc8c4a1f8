"""What the daemon's map is, by plain numpy, and how old what a client has of it is."""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapperd.wire.blocks import UNKNOWN
from mapperd.wire.messages import Interest, MapInfo
from studies.stream.sent_steps import sent_steps

__all__ = ["EDGE", "UNIT", "Ages", "Blocks", "coded", "distances_m", "stream_keys"]

EDGE = 16
"""Voxels along an edge of the map's own blocks."""

UNIT = 2.0**-24
"""Of the map's own log-odds."""

Key = tuple[int, int, int]
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """The map's own blocks, x fastest.

    Attributes:
        keys: (M, 3).
        units: (M, 4096) log-odds.
        counts: (M, 4096); 0 is unknown.
    """

    keys: NDArray[np.int32]
    units: NDArray[np.int32]
    counts: NDArray[np.uint16]


def coded(blocks: Blocks, info: MapInfo, interest: Interest) -> NDArray[np.int8]:
    """Encode blocks as an interest receives them: (M, E, E, E) z, y, x with E = 16 / 2**level."""
    log_odds = blocks.units * UNIT
    if interest.detail == "classes":
        as_held = log_odds.astype(np.float32)
        occupied, free = as_held > info.occupied_log_odds, as_held < info.free_log_odds
        sent = occupied.astype(np.int8) - free.astype(np.int8)
    else:
        sent = sent_steps(log_odds, info)
    sent = np.where(blocks.counts > 0, sent, np.int8(UNKNOWN))
    size = 2**interest.level
    edge = EDGE // size
    return np.asarray(sent.reshape(-1, edge, size, edge, size, edge, size).max(axis=(2, 4, 6)))


def stream_keys(keys: NDArray[np.int32], level: int) -> NDArray[np.int64]:
    """(M, P, 3) blocks of the stream that a block of the map lies in, or is cut into, z slowest."""
    wide = keys.astype(np.int64)
    if level > 0:
        return np.asarray(wide[:, None] >> (level - 1))
    zyx = np.stack(np.unravel_index(np.arange(8), (2, 2, 2)), axis=-1)
    return np.asarray(2 * wide[:, None] + zyx[None, :, ::-1])


class Ages:
    """Of each block of the stream: when it changed since it was last sent to the client.

    A block that is again what it was is not missed, a message about it under way or not.

    Args:
        info: of the map.
        interest: of the client.
    """

    def __init__(self, info: MapInfo, interest: Interest) -> None:
        self._info, self._interest = info, interest
        self._seen: dict[bytes, tuple[NDArray[np.int32], NDArray[np.int8]]] = {}
        # Of each change: when it was, and the block as sent before it.
        self._missed: dict[Key, deque[tuple[float, bytes]]] = {}

    def changed(self, blocks: Blocks, now_s: float) -> None:
        """Note what differs from what was sent before."""
        names = [key.tobytes() for key in blocks.keys]
        before = [self._seen.get(name) for name in names]
        rows = [
            row
            for row, old in enumerate(before)
            if old is None or not np.array_equal(old[0], blocks.units[row])
        ]
        some = Blocks(blocks.keys[rows], blocks.units[rows], blocks.counts[rows])
        sent = _parts(coded(some, self._info, self._interest), self._interest.level)
        keys = stream_keys(some.keys, self._interest.level)
        for k, row in enumerate(rows):
            old = before[row]
            nothing = np.full_like(sent[k], UNKNOWN)
            held = nothing if old is None else old[1]
            for part in np.flatnonzero((sent[k] != held).any(axis=1)):
                x, y, z = keys[k, part].tolist()
                missed = self._missed.setdefault((x, y, z), deque())
                missed.append((now_s, held[part].tobytes()))
                if missed[0][1] == sent[k, part].tobytes():
                    missed.clear()  # it is again what the client has: there is nothing to send
            self._seen[names[row]] = some.units[k].copy(), sent[k]

    def sent(self, keys: NDArray[np.int32], made_s: float) -> None:
        """The client has blocks (N, 3) as they were then."""
        for x, y, z in keys.tolist():
            missed = self._missed.get((x, y, z))
            while missed and missed[0][0] <= made_s:
                missed.popleft()

    def oldest_s(self, now_s: float, position_m: Floats, near_m: float) -> tuple[float, float]:
        """Age of the oldest block within a radius, and beyond; 0 where nothing is missed."""
        missed = [(key, times[0][0]) for key, times in self._missed.items() if times]
        if not missed:
            return 0.0, 0.0
        keys = np.array([key for key, _ in missed], np.int64)
        age_s = now_s - np.array([since for _, since in missed])
        block_m = self._info.resolution_m * 8 * 2**self._interest.level
        near = distances_m(keys, block_m, position_m) <= near_m
        return float(age_s[near].max(initial=0)), float(age_s[~near].max(initial=0))


def distances_m(keys: NDArray[np.int64], block_m: float, position_m: Floats) -> Floats:
    """(N,) from a point to the nearest point of blocks."""
    low = keys * block_m
    nearest = np.clip(position_m, low, low + block_m)
    return np.asarray(np.linalg.norm(nearest - position_m, axis=1))


def _parts(sent: NDArray[np.int8], level: int) -> NDArray[np.int8]:
    """(M, P, C) of `coded`, cut as `stream_keys` cuts."""
    if level > 0:
        return sent.reshape(len(sent), 1, -1)
    cut = sent.reshape(-1, 2, 8, 2, 8, 2, 8).transpose(0, 1, 3, 5, 2, 4, 6)
    return np.asarray(cut.reshape(len(sent), 8, -1))
