"""What one client is sent next of each kind, but for the map, and how much of it."""

from collections import Counter
from collections.abc import Collection, Iterator
from typing import Any

import msgspec

from mapperd.events import EventLog
from mapperd.server.pacer import Pacer
from mapperd.server.state_feed import Newest, StateFeed
from mapperd.server.state_messages import IMAGE_SIZES
from mapperd.wire.blocks import path_message
from mapperd.wire.framing import framed
from mapperd.wire.messages import WANTS, Resume, SettingsMessage

__all__ = ["ClientOutbox"]

BEAT_S = 1.0
SHARES = {
    "pose": 0.08,
    "fan": 0.05,
    "events": 0.1,
    "settings": 0.1,
    "path": 0.1,
    "robots": 0.05,
    "localization": 0.1,
    "returns": 0.1,
    "image": 0.15,
    "status": 0.05,
}
"""Of what a busy link delivers, for each kind at most: the rest is the map's."""

LATE_S = 0.1
"""A kind whose turn came between two rounds loses nothing of its share."""

ENDING = frozenset({"fan", "events", "settings", "path", "robots"})
"""Kinds that have an end: they have no such share while the map lacks nothing."""

FIRST_IMAGES = (60_000, 16_000, 5_000)
"""Bytes that pictures may have, until one has been seen."""

PIECE, EVENT = 4_000, 300
"""Bytes of a message, about."""

POINT = 24


class _Beat(msgspec.Struct, tag_field="t", tag="status"):
    stamp_ns: int
    status: msgspec.Raw
    link: dict[str, Any]


_ENCODER = msgspec.msgpack.Encoder()
_EMPTY = msgspec.Raw(b"\x80")


class ClientOutbox:
    """Of one client: which it has had, and which are due.

    Args:
        feed: messages.
        events: what happened.
        pacer: of what is under way.

    Attributes:
        wants: kinds of messages.
        left: blocks of the map that the client still lacks.
        skipped: messages that were never sent, by kind.
        waits: something is due and lacks room, which the map is not to take.
    """

    def __init__(self, feed: StateFeed, events: EventLog, pacer: Pacer) -> None:
        self.wants: frozenset[str] = frozenset()
        self.left = 0
        self.skipped: Counter[str] = Counter()
        self.waits = False
        self._feed = feed
        self._events = events
        self._pacer = pacer
        self._sent_numbers: dict[str, int] = {}
        self._next_s: dict[str, float] = {}
        self._beat_s = 0.0
        self._owes_status = False
        self._settings_sent = self._events_sent = 0
        self._path: tuple[int, int] = (-1, 0)
        self._path_is_old = False

    def begin(self, events_since: int | None) -> None:
        """Events are sent after this one; of None, those to come."""
        last = self._events.last
        self._events_sent = last if events_since is None else min(events_since, last)

    def go_on(self, resume: Resume, *, same: bool) -> None:
        """The client holds a path; of this session or not."""
        self._path = (resume.path_version, resume.path) if same else (-1, 0)
        self._path_is_old = not same and resume.path > 0

    def want(self, wants: Collection[str]) -> None:
        """Other kinds from now on."""
        for kind in {*wants} - self.wants:
            self._sent_numbers.pop(kind, None)  # what it was sent long ago may be forgotten
            if kind == "settings":
                self._settings_sent = 0
        self.wants = frozenset(wants)

    def coarseness(self) -> int:
        """Of the pictures that the link has room for: one a second."""
        most = SHARES["image"] * self._rate()
        for coarse in range(len(IMAGE_SIZES) - 1):
            size = len(self._feed.image(coarse).frame) or FIRST_IMAGES[coarse]
            if size <= most:
                return coarse
        return len(IMAGE_SIZES) - 1

    def link(self) -> dict[str, Any]:
        """How the connection goes, in plain values."""
        pacer = self._pacer
        return {
            "bytes": pacer.sent,
            "bytes_per_s": round(pacer.rate or 0.0),
            "round_trip_s": round(pacer.round_trip_s or 0.0, 4),
            "in_flight": pacer.in_flight,
            "left": self.left,
            "skipped": dict(self.skipped),
        }

    def pieces(self, now_s: float, now_ns: int) -> Iterator[bytes]:
        """What is due and has room, most urgent first; each is sent before the next is taken."""
        self.waits = False
        if now_s - self._beat_s >= BEAT_S or self._status_fits(now_s):
            yield self._beat(now_s, now_ns)
        for kind in WANTS_IN_ORDER:
            if kind in self.wants:
                yield from self._of(kind, now_s)

    def _of(self, kind: str, now_s: float) -> Iterator[bytes]:
        """What is due of a kind and has room."""
        while True:
            match kind:
                case "events":
                    frame = self._event(now_s)
                case "settings":
                    frame = self._setting(now_s)
                case "path":
                    frame = self._path_piece(now_s)
                case "image":
                    frame = self._newest(kind, self._feed.image(self.coarseness()), now_s)
                case _:
                    frame = self._newest(kind, self._feed.newest(kind), now_s)
            if not frame:
                return
            self._took(kind, len(frame), now_s)
            yield frame

    def _may(self, kind: str, size: int, now_s: float) -> bool:
        """Whether a message has room, and its kind has not had its share of a busy link."""
        pacer = self._pacer
        has_room = not self.left and (kind in ENDING or pacer.is_idle_for(size))
        if now_s < self._next_s.get(kind, 0.0) and not has_room:
            return False
        fits = pacer.fits(size, now_s)
        self.waits |= not fits
        return fits

    def _took(self, kind: str, size: int, now_s: float) -> None:
        due_s = max(self._next_s.get(kind, 0.0), now_s - LATE_S)
        self._next_s[kind] = min(due_s, now_s) + size / (SHARES[kind] * self._rate())

    def _newest(self, kind: str, newest: Newest, now_s: float) -> bytes:
        sent = self._sent_numbers.get(kind, 0)
        is_old = newest.number <= sent if kind == "image" else newest.number == sent
        if is_old or not self._may(kind, len(newest.frame), now_s):
            return b""
        if sent:
            self.skipped[kind] += max(0, newest.number - sent - 1)
        self._sent_numbers[kind] = newest.number
        return newest.frame

    def _event(self, now_s: float) -> bytes:
        events = self._events
        if events.last <= self._events_sent or not self._may("events", EVENT, now_s):
            return b""
        found, lost = events.since(self._events_sent)
        if not found:
            return b""
        self._events_sent = found[0].number
        return self._feed.event(found[0], lost)

    def _setting(self, now_s: float) -> bytes:
        log = self._feed.settings
        if log.last <= self._settings_sent or not self._may("settings", PIECE, now_s):
            return b""
        self._settings_sent, facts = log.since(self._settings_sent, PIECE)
        return framed(SettingsMessage(facts=facts))

    def _path_piece(self, now_s: float) -> bytes:
        path, (sent_version, sent) = self._feed.path, self._path
        if sent_version == path.version and sent >= len(path):
            return b""
        if not self._may("path", PIECE // 2, now_s):
            return b""
        most = max(self._pacer.room(now_s), PIECE) // 2 // POINT
        new_version, first, points = path.since(sent_version, sent, most)
        self._path = (new_version, first + len(points))
        if not len(points) and not self._path_is_old:
            return b""
        self._path_is_old = False
        return framed(path_message(first, points, new_version))

    def _beat(self, now_s: float, now_ns: int) -> bytes:
        self._beat_s = now_s
        status: msgspec.Raw = _EMPTY
        self._owes_status = "status" in self.wants
        if self._status_fits(now_s):
            status, self._owes_status = self._feed.status, False
            self._took("status", len(bytes(status)), now_s)
        body = _ENCODER.encode(_Beat(now_ns, status, self.link()))
        return len(body).to_bytes(4, "big") + body

    def _status_fits(self, now_s: float) -> bool:
        """Whether a beat had no room for it, and there is some now."""
        return self._owes_status and self._may("status", len(bytes(self._feed.status)), now_s)

    def _rate(self) -> float:
        return max(self._pacer.allowed_rate, 1.0)


WANTS_IN_ORDER = tuple(kind for kind in SHARES if kind != "status")
assert {*WANTS_IN_ORDER, "map", "status"} == {*WANTS}  # noqa: S101 a kind that nobody would be sent
