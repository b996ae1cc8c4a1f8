"""Messages for one client, without the map: which are due, and which fit on the link."""

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
"""Largest share of a busy link for each kind; the rest is for the map."""

LATE_S = 0.1
"""Time that a message may be late without reducing the share of its kind."""

ENDING = frozenset({"fan", "events", "settings", "path", "robots"})
"""Kinds with little data: their shares do not apply while the map is complete."""

FIRST_IMAGES = (60_000, 16_000, 5_000)
"""Estimated bytes of an image of each size, until one has been encoded."""

PIECE, EVENT = 4_000, 300
"""Approximate bytes of a message of settings or path, and of an event."""

POINT = 24


class _Beat(msgspec.Struct, tag_field="t", tag="status"):
    stamp_ns: int
    status: msgspec.Raw
    link: dict[str, Any]


_ENCODER = msgspec.msgpack.Encoder()
_EMPTY = msgspec.Raw(b"\x80")


class ClientOutbox:
    """Chooses the messages for one client by what it got, what is new and what has room.

    Args:
        feed: messages about the daemon's state.
        events: event log of the daemon.
        pacer: limits of the connection.

    Attributes:
        wants: kinds of messages that the client wants.
        left: blocks of the map that are still to be sent.
        skipped: messages that were not sent, by kind.
        waits: a message is due and has no room; the map must wait for it.
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
        """Send the events after this one; None sends new ones only."""
        last = self._events.last
        self._events_sent = last if events_since is None else min(events_since, last)

    def resume(self, resume: Resume, *, same: bool) -> None:
        """Continue the path that the client holds, if it is of the same session."""
        self._path = (resume.path_version, resume.path) if same else (-1, 0)
        self._path_is_old = not same and resume.path > 0

    def want(self, wants: Collection[str]) -> None:
        """Set the kinds of messages that the client wants."""
        for kind in {*wants} - self.wants:
            self._sent_numbers.pop(kind, None)  # what the client got long ago may be outdated
            if kind == "settings":
                self._settings_sent = 0
        self.wants = frozenset(wants)

    def coarseness(self) -> int:
        """Return the finest size of which the link has room for one image a second."""
        most = SHARES["image"] * self._rate()
        for coarse in range(len(IMAGE_SIZES) - 1):
            size = len(self._feed.image(coarse).frame) or FIRST_IMAGES[coarse]
            if size <= most:
                return coarse
        return len(IMAGE_SIZES) - 1

    def link(self) -> dict[str, Any]:
        """Return the state of the connection as plain values."""
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
        """Yield the messages that are due and have room, most urgent first.

        Send each before taking the next.
        """
        self.waits = False
        if now_s - self._beat_s >= BEAT_S or self._status_fits(now_s):
            yield self._beat(now_s, now_ns)
        for kind in WANTS_IN_ORDER:
            if kind in self.wants:
                yield from self._of(kind, now_s)

    def _of(self, kind: str, now_s: float) -> Iterator[bytes]:
        """Yield the messages of a kind that are due and have room."""
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
        """Return whether a message has room and its kind has not used up its share."""
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
        """Return whether the status was left out of a heartbeat and has room now."""
        return self._owes_status and self._may("status", len(bytes(self._feed.status)), now_s)

    def _rate(self) -> float:
        return max(self._pacer.allowed_rate, 1.0)


WANTS_IN_ORDER = tuple(kind for kind in SHARES if kind != "status")
assert {*WANTS_IN_ORDER, "map", "status"} == {*WANTS}  # noqa: S101 every kind is sent
