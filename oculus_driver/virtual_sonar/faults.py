"""How a played sonar misbehaves: decided by dice that fall the same way for the same number."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Final

import numpy as np

_MAX_FLIPS: Final = 8
_MAX_GARBAGE: Final = 4096


@dataclass(frozen=True, slots=True)
class Faults:
    """What goes wrong, and how often. Shares are of pings, 0 to 1; the default is no fault.

    Attributes:
        cut: share of pings that end in the middle, with the connection.
        flip: share of pings in which one to eight bits are flipped.
        stall: share of pings before which nothing is sent for `stall_s`.
        stall_s: seconds of a stall.
        lose: share of pings that are never sent, though their ids count.
        garbage: share of pings before which up to 4096 bytes of noise are sent.
        restart: share of pings before which the sonar restarts: the connection ends, ids and
            device time begin anew.
        restart_ids: share of pings before which only ids and device time begin anew.
        reorder_statuses: share of statuses that are sent after the next one, and that one twice.
        refuse_second: close the connection of a second client at once instead of letting it wait.
        silent_after_s: send nothing more to a client that has not fired for so long; None never.
        ignored_fire_version: version of fire messages that are not understood, None for none.
        piece_bytes: largest piece of a message that is handed to the network at once.
        number: of the dice.
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
    number: int = 0


SHARES: Final = tuple(
    item.name for item in fields(Faults) if item.type == "float" and item.name != "stall_s"
)
"""Names of the faults that are given as shares."""


@dataclass(frozen=True, slots=True)
class FaultedPing:
    """What is done with one ping.

    Attributes:
        noise: bytes sent in front of it.
        data: what is sent of it; empty where it is lost.
        damaged: whether that is not the whole, unchanged ping.
        cut: whether the connection ends with it.
    """

    noise: bytes = field(default=b"", repr=False)
    data: bytes = field(default=b"", repr=False)
    damaged: bool = False
    cut: bool = False


class FaultInjector:
    """Decides what happens to each ping and status."""

    def __init__(self, faults: Faults) -> None:
        self._faults = faults
        self._rng = np.random.default_rng(faults.number)

    def before_ping(self) -> str | None:
        """Return what happens before the next ping: restart, restart_ids, stall or None."""
        for name in ("restart", "restart_ids", "stall"):
            if self._happens(getattr(self._faults, name)):
                return name
        return None

    def apply(self, data: bytes) -> FaultedPing:
        """Return what is sent for a ping that would be these bytes."""
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

    def holds_status(self) -> bool:
        """Tell whether the next status waits for the one after it."""
        return self._happens(self._faults.reorder_statuses)

    def _happens(self, share: float) -> bool:
        return share > 0.0 and float(self._rng.random()) < share

    def _flipped(self, data: bytes) -> bytes:
        changed = bytearray(data)
        count = int(self._rng.integers(1, _MAX_FLIPS + 1))
        for bit in self._rng.choice(8 * len(data), size=count, replace=False):
            changed[int(bit) // 8] ^= 1 << (int(bit) % 8)
        return bytes(changed)
