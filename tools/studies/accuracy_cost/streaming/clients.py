"""What a client holds of the map, as the daemon's own blocks have it."""

import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mapperd.client.mirror import MapMirror
from mapperd.wire.blocks import UNKNOWN, decode_blocks
from mapperd.wire.framing import client_inbox
from mapperd.wire.messages import BLOCK_EDGE, Blocks, Interest, MapFacts
from studies.accuracy_cost.streaming.told import PLAIN
from studies.accuracy_cost.streaming.truth import EDGE, stream_keys

__all__ = ["Client", "PlainClient", "StreamClient"]

Floats = NDArray[np.float32]


class Client(Protocol):
    """Reads messages."""

    def take(self, message: bytes) -> NDArray[np.int32]:
        """Read one; returns the keys (N, 3) of the blocks of the stream that it was about."""

    def probabilities(self, keys: NDArray[np.int32]) -> Floats:
        """(M, 4096) of the map's own blocks, x fastest; NaN where nothing is known."""


class StreamClient:
    """Of the map stream.

    Args:
        facts: of the map.
        interest: that is told.
    """

    def __init__(self, facts: MapFacts, interest: Interest) -> None:
        self._inbox = client_inbox()
        self._mirror = MapMirror(facts, interest)
        self._interest = interest
        self._values = _values(facts, interest)

    def take(self, message: bytes) -> NDArray[np.int32]:
        """As of `Client`."""
        (said,) = self._inbox.feed(message)
        if not isinstance(said, Blocks) or not said.body:
            return np.zeros((0, 3), np.int32)
        blocks = decode_blocks(said.body, counts=self._interest.detail == "counts")
        self._mirror.put(blocks, said.stamp_ns)
        return blocks.keys

    def probabilities(self, keys: NDArray[np.int32]) -> Floats:
        """As of `Client`: a cell is all of its voxels."""
        level = self._interest.level
        of = stream_keys(keys, level)
        cells = self._mirror.cells_of(of.reshape(-1, 3)).reshape(-1, *(BLOCK_EDGE,) * 3)
        if level == 0:
            whole = cells.reshape(-1, 2, 2, 2, 8, 8, 8).transpose(0, 1, 4, 2, 5, 3, 6)
            return self._of(whole.reshape(len(keys), -1))
        size = 2**level
        edge = EDGE // size
        first = (keys & (2 ** (level - 1) - 1)) * edge
        at = first[:, :, None] + np.arange(edge)
        row = np.arange(len(keys))[:, None, None, None]
        part = cells[row, at[:, 2, :, None, None], at[:, 1, None, :, None], at[:, 0, None, None, :]]
        for axis in (1, 2, 3):
            part = part.repeat(size, axis=axis)
        return self._of(part.reshape(len(keys), -1))

    def _of(self, cells: NDArray[np.int8]) -> Floats:
        return np.asarray(self._values[cells.astype(np.intp) + 128])


class PlainClient:
    """Of plain floats."""

    def __init__(self) -> None:
        self._held: dict[bytes, Floats] = {}

    def take(self, message: bytes) -> NDArray[np.int32]:
        """As of `Client`."""
        name, rows = message[:12], np.frombuffer(message, PLAIN, offset=12)
        if name not in self._held:
            self._held[name] = np.full(EDGE**3, math.nan, np.float32)
        self._held[name][rows["cell"]] = rows["p"]
        key = np.frombuffer(name, np.int32).reshape(1, 3)
        return stream_keys(key, 0).reshape(-1, 3).astype(np.int32)

    def probabilities(self, keys: NDArray[np.int32]) -> Floats:
        """As of `Client`."""
        nothing = np.full(EDGE**3, math.nan, np.float32)
        return np.stack([self._held.get(key.tobytes(), nothing) for key in keys])


def _values(facts: MapFacts, interest: Interest) -> Floats:
    """(256,) probabilities of told values from -128 on; a class is a step beyond its threshold."""
    told = np.arange(-128, 128)
    log_odds = told * facts.log_odds_step
    if interest.detail == "classes":
        low = facts.free_log_odds - facts.log_odds_step
        high = facts.occupied_log_odds + facts.log_odds_step
        middle = (facts.free_log_odds + facts.occupied_log_odds) / 2
        log_odds = np.choose(np.clip(told, -1, 1) + 1, [low, middle, high])
    values = (1 / (1 + np.exp(-log_odds))).astype(np.float32)
    values[told == UNKNOWN] = math.nan
    return np.asarray(values)
