"""Injected faults of a virtual sonar, reproducible by seed."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Final

import numpy as np

_MAX_FLIPS: Final = 8
_MAX_GARBAGE: Final = 4096


@dataclass(frozen=True, slots=True)
class Faults:
    """Types and frequencies of faults. Shares are of all pings, 0 to 1; the default is no fault.

    Attributes:
        cut: share of pings cut in the middle; the connection ends, too.
        flip: share of pings with one to eight flipped bits.
        stall: share of pings preceded by a pause of `stall_s`.
        stall_s: duration of a stall, seconds.
        lose: share of pings that are not sent; their ids are skipped.
        garbage: share of pings preceded by up to 4096 bytes of noise.
        restart: share of pings preceded by a restart: the connection ends, ids and device time
            start again.
        restart_ids: share of pings at which only ids and device time start again.
        reorder_statuses: share of statuses sent after the next one, which is sent twice.
        refuse_second: reject a second client at once instead of letting it wait.
        silent_after_s: stop sending to a client without a fire message for so long; None: never.
        ignored_fire_version: version of fire messages to ignore; None: none.
        piece_bytes: maximum size of a single write; None: whole messages.
        seed: of the random numbers.
    """

    cut: float = 0.0
    flip: float = 0.0
    stall: float = 0.0
    stall_s: float = 2.0
    lose: float = 0.0
    garbage: float = 0.0
    restart: float = 0.0
    restart_ids: float = 0.0
    reorder_statuses: float = 0.0
    refuse_second: bool = False
    silent_after_s: float | None = None
    ignored_fire_version: int | None = None
    piece_bytes: int | None = None
    seed: int = 0


SHARES: Final = tuple(
    item.name for item in fields(Faults) if item.type == "float" and item.name != "stall_s"
)
"""Names of the faults given as shares."""


@dataclass(frozen=True, slots=True)
class FaultedPing:
    """What is sent for one ping.

    Attributes:
        noise: bytes sent in front of it.
        data: the bytes of the ping; empty if it is lost.
        damaged: whether `data` is not the complete, unchanged ping.
        cut: whether the connection ends.
    """

    noise: bytes = field(default=b"", repr=False)
    data: bytes = field(default=b"", repr=False)
    damaged: bool = False
    cut: bool = False


class FaultInjector:
    """Selects the faults of each ping and status."""

    def __init__(self, faults: Faults) -> None:
        self._faults = faults
        self._rng = np.random.default_rng(faults.seed)

    def before_ping(self) -> str | None:
        """Return the event before the next ping: restart, restart_ids, stall or None."""
        for name in ("restart", "restart_ids", "stall"):
            if self._happens(getattr(self._faults, name)):
                return name
        return None

    def apply(self, data: bytes) -> FaultedPing:
        """Return what is sent for a ping of these bytes."""
        noise = b""
        if self._happens(self._faults.garbage):
            noise = self._rng.bytes(int(self._rng.integers(1, _MAX_GARBAGE + 1)))
        if self._happens(self._faults.lose):
            return FaultedPing(noise=noise, damaged=True)
        if self._happens(self._faults.cut):
            end = int(self._rng.integers(0, len(data)))
            return FaultedPing(noise=noise, data=data[:end], damaged=True, cut=True)
        if self._happens(self._faults.flip):
            return FaultedPing(noise=noise, data=self._flipped(data), damaged=True)
        return FaultedPing(noise=noise, data=data)

    def delays_status(self) -> bool:
        """Return whether the next status is delayed until after the one after it."""
        return self._happens(self._faults.reorder_statuses)

    def _happens(self, share: float) -> bool:
        return share > 0.0 and float(self._rng.random()) < share

    def _flipped(self, data: bytes) -> bytes:
        changed = bytearray(data)
        count = int(self._rng.integers(1, _MAX_FLIPS + 1))
        for bit in self._rng.choice(8 * len(data), size=count, replace=False):
            changed[int(bit) // 8] ^= 1 << (int(bit) % 8)
        return bytes(changed)
