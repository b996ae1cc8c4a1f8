"""When a client gets which part of the map.

On a full link each packet waits behind others, and the same blocks are sent again and again as they
change. So blocks near the vehicle are sent in passes, each block once, with a rest between two
passes. Far blocks are sent in the rests, and only as many as delay no pass.
"""

from dataclasses import dataclass

from mapperd.server.pacer import Pacer

__all__ = ["Rooms", "Turns"]

DUTY, LONGEST_REST_S = 0.6, 0.6
"""Share of the time that passes keep the link busy, and the longest rest after a pass."""

IDLE, ASIDE_S = 0.4, 0.15
"""Share of what the link delivers in a round trip and a moment: no more may be in flight when a
message of far blocks is sent in between."""

QUIET_S = 2.0
"""Time after the last pass until far blocks have the link for themselves."""

EACH = 8
"""Near messages in a row, after which a far one may follow, however much is left."""

SHARE = 0.9
"""Share of the window for the map: a pose never waits for the map to be acknowledged."""

MIN = 600
"""Smallest message in bytes: blocks take less room the more of them are in one."""


@dataclass(frozen=True, slots=True)
class Rooms:
    """Bytes of the map that may be sent now; 0 is nothing."""

    near: int = 0
    far: int = 0

    def __bool__(self) -> bool:
        return bool(self.near or self.far)


class Turns:
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

    def rooms(self, now_s: float) -> Rooms:
        """What may be sent now."""
        pacer = self._pacer
        room = int(min(pacer.max_in_flight * SHARE - pacer.in_flight, pacer.room(now_s) * SHARE))
        if room < max(MIN, SHARE * pacer.least()):
            return Rooms()
        near = room if now_s >= self._rests_until_s else 0
        if self._near_s is None or now_s - self._near_s > QUIET_S:
            return Rooms(near, room)
        rate = pacer.allowed_rate
        wire = rate * (ASIDE_S + (pacer.round_trip_s or 0.0))
        is_idle = pacer.in_flight <= IDLE * wire or self._messages >= EACH
        return Rooms(near, room if is_idle else 0)

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
        """End the pass: nothing is left of it, sent or not, as the vehicle may have moved on."""
        if self._began_s is not None:
            rest_s = min(self._bytes / (DUTY * self._pacer.allowed_rate), LONGEST_REST_S)
            self._rests_until_s = self._began_s + rest_s
            self._began_s, self._bytes, self._messages = None, 0, 0

    def sent_far(self) -> None:
        """Note a message of far blocks."""
        self._messages = 0
