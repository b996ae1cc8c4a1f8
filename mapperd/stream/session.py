"""One client of the map stream: what it may be told next, and what it says. No bytes move here.

greeted ─ hello ─▶ admitted ─ the map is ready ─▶ served

Nothing is queued for a client: of each kind it is told the newest when there is room, so that one
that is slow skips what nobody needs any more, and costs no more than one that is not.
"""

from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import msgspec
import numpy as np

from mapperd.control.admission import Newcomer, doubt
from mapperd.control.limits import TokenBucket
from mapperd.control.messages import plain
from mapperd.control.token import FailureLimiter
from mapperd.events import EventLog
from mapperd.stream.feed import Feed, Newest
from mapperd.stream.framing import StreamError, framed, server_inbox
from mapperd.stream.messages import (
    VERSION,
    WANTS,
    Ack,
    Answer,
    Ask,
    Bye,
    Change,
    FromClient,
    Greeting,
    Hello,
    Interest,
    MapFacts,
    Path,
    Resume,
    Settings,
    Welcome,
)
from mapperd.stream.pacer import Pacer
from mapperd.stream.pictures import IMAGE_SIZES
from mapperd.stream.source_protocol import MapView
from mapperd.version import version

__all__ = ["Beginning", "Common", "Session", "Wish"]

ASKS = 8
"""That may wait for their answers."""

ANSWERS = 32
MESSAGES_PER_S, MESSAGES_AT_ONCE = 2000.0, 20_000
QUIET_S = 60.0
BEAT_S = 1.0
FIRST_RATE = 64_000
"""Bytes a second, until more is known."""

SHARES = {
    "pose": 0.2,
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

ENDING = frozenset({"fan", "events", "settings", "path", "robots"})
"""Kinds that have an end: they have no such share while the map lacks nothing."""

FIRST_IMAGES = (60_000, 16_000, 5_000)
"""Bytes that pictures may have, until one has been seen."""

PIECE, EVENT = 4_000, 300
"""Bytes of a message, about."""

POINT = 12
MAP_SHARE = 0.9
"""Of the window: a pose never waits for the map to be acknowledged."""

LEAST_MAP = 600


@dataclass(frozen=True, slots=True)
class Common:
    """What all clients share.

    Attributes:
        feed: messages.
        events: what happened.
        failures: of proofs, by address.
        vehicle: its name.
        bytes_per_s: of one client, at most; 0 has no limit.
    """

    feed: Feed
    events: EventLog
    failures: FailureLimiter
    vehicle: str
    bytes_per_s: int = 0


@dataclass(frozen=True, slots=True)
class Wish:
    """A part of the map that is to be told; None is no map."""

    interest: Interest | None
    resume: Resume | None = None


@dataclass(frozen=True, slots=True)
class Beginning:
    """The map when a client begins to be told of it, as `Welcome` says it."""

    facts: MapFacts
    revision: int
    session: str


class _Beat(msgspec.Struct, tag_field="t", tag="status"):
    stamp_ns: int
    status: msgspec.Raw
    link: dict[str, Any]


_ENCODER = msgspec.msgpack.Encoder()
_EMPTY = msgspec.Raw(b"\x80")


class Session:
    """One client, from the greeting to the bye; whoever calls says what time it is.

    Args:
        common: shared with others.
        newcomer: who it is.
        may_change: it may ask for what changes something.

    Attributes:
        state: as above.
        name: that the client gives itself.
        wants: kinds of messages.
        wish: what is to become of its view of the map; None once that is done.
        view: of the map.
        left: blocks that it still lacks.
        asks: requests that wait.
        pacer: of what is under way.
        skipped: messages that were never told, by kind.
    """

    def __init__(self, common: Common, newcomer: Newcomer, *, may_change: bool) -> None:
        self.state: Literal["greeted", "admitted", "served"] = "greeted"
        self.name = ""
        self.wants: frozenset[str] = frozenset()
        self.wish: Wish | None = None
        self.view: MapView | None = None
        self.left = 0
        self.asks: deque[msgspec.Raw] = deque()
        self.pacer = Pacer(common.bytes_per_s)
        self.skipped: Counter[str] = Counter()
        self.may_change = may_change
        self._common = common
        self._newcomer = newcomer
        self._inbox = server_inbox()
        self._messages = TokenBucket(MESSAGES_PER_S, MESSAGES_AT_ONCE)
        self._words: deque[bytes] = deque()
        self._told: dict[str, int] = {}
        self._next_s: dict[str, float] = {}
        self._beat_s = 0.0
        self._settings_told = self._events_told = 0
        self._path: tuple[int, int] = (-1, 0)
        self._path_is_old = False
        self._resume: Resume | None = None
        self._interest = Interest()

    def greeting(self, now_s: float) -> bytes:
        """The first bytes."""
        return self._sent(framed(Greeting(challenge=self._newcomer.challenge)), now_s)

    def bye(self, reason: str, message: str) -> bytes:
        """The last bytes."""
        return framed(Bye(reason=reason, message=message))

    def take(self, data: bytes, now_s: float) -> None:
        """Bytes that the client sent.

        Raises:
            StreamError: it may not say that; it is to be let go.
        """
        for message in self._inbox.feed(data):
            if self._messages.take(now_s) > 0:
                raise StreamError("more messages than anybody needs", "too_many_messages")
            self._heard(message, now_s)

    def look(self, now_s: float) -> None:
        """Whether it still listens.

        Raises:
            StreamError: it does not.
        """
        if self.pacer.quiet_s(now_s) > QUIET_S:
            raise StreamError(f"nothing was acknowledged for {QUIET_S:g} s", "no_acks")

    def viewed(self, view: MapView | None, beginning: Beginning, now_s: float) -> None:
        """Its wish for a view of the map has been met."""
        self.view = view
        self.left = 0 if view is None else view.left
        if self.state == "admitted":
            self._welcome(beginning, now_s)

    def answer(self, number: int | None, result: object, error: object = None) -> None:
        """What became of a request."""
        said = msgspec.to_builtins(result, enc_hook=plain)
        fault = msgspec.to_builtins(error, enc_hook=plain)
        self._words.append(framed(Answer(id=number, result=said, error=fault)))

    @property
    def answers(self) -> int:
        """That it has not been sent yet."""
        return len(self._words)

    def next(self, now_s: float, now_ns: int) -> bytes:
        """All that is to be sent now, but for the map; most urgent first."""
        if self.state != "served":
            return b""
        return b"".join(self._sent(piece, now_s) for piece in self._pieces(now_s, now_ns))

    def map_room(self, now_s: float) -> int:
        """Bytes of the map that may be sent now; 0 is none."""
        if self.state != "served" or self.view is None:
            return 0
        pacer = self.pacer
        free = int(pacer.window * MAP_SHARE) - pacer.in_flight
        room = min(free, int(pacer.room(now_s) * MAP_SHARE))
        return room if room >= LEAST_MAP else 0

    def mapped(self, frame: bytes, left: int, now_s: float) -> bytes:
        """Of the map, as it is to be sent; and blocks that are left."""
        self.left = left
        return self._sent(frame, now_s)

    def coarseness(self) -> int:
        """Of the pictures that the link has room for: one a second."""
        most = SHARES["image"] * self._rate()
        for coarse in range(len(IMAGE_SIZES) - 1):
            size = len(self._common.feed.image(coarse).frame) or FIRST_IMAGES[coarse]
            if size <= most:
                return coarse
        return len(IMAGE_SIZES) - 1

    def link(self) -> dict[str, Any]:
        """How the connection goes, in plain values."""
        pacer = self.pacer
        return {
            "bytes": pacer.sent,
            "bytes_per_s": round(pacer.rate or 0.0),
            "round_trip_s": round(pacer.round_trip_s or 0.0, 4),
            "in_flight": pacer.in_flight,
            "left": self.left,
            "skipped": dict(self.skipped),
        }

    def _heard(self, message: FromClient, now_s: float) -> None:
        if isinstance(message, Hello):
            self._hello(message, now_s)
            return
        if self.state == "greeted":
            raise StreamError("the first message is hello", "no_hello")
        match message:
            case Ack(bytes=acked):
                if not self.pacer.note_ack(acked, now_s):
                    raise StreamError("an acknowledgement of what was not sent", "bad_ack")
            case Change():
                self._change(message)
            case Ask(ask=ask):
                self.asks.append(msgspec.Raw(bytes(ask)))
                if len(self.asks) > ASKS or len(self._words) > ANSWERS:
                    raise StreamError("too many requests at once", "too_many_asks")

    def _hello(self, hello: Hello, now_s: float) -> None:
        if self.state != "greeted":
            raise StreamError("hello is said once", "hello_twice")
        if hello.version != VERSION:
            said = f"version {hello.version} is not spoken; allowed: {VERSION}"
            raise StreamError(said, "bad_version")
        fault = doubt(self._newcomer, hello.proof, self._common.failures, now_s)
        if fault is not None:
            raise StreamError(fault.message, fault.reason)
        self.state, self.name = "admitted", hello.name
        self.wants = frozenset(hello.wants)
        self._resume = hello.resume
        self._limit(hello.bytes_per_s)
        self._interest = _checked(hello.interest)
        self.wish = Wish(self._interest if "map" in self.wants else None, hello.resume)
        last = self._common.events.last
        since = hello.events_since
        self._events_told = last if since is None else min(since, last)

    def _welcome(self, beginning: Beginning, now_s: float) -> None:
        resume, view = self._resume, self.view
        same = resume is not None and resume.session == beginning.session
        resumed = same if view is None else view.resumed
        if resume is not None and resumed:
            self._path = (resume.path_version, resume.path) if same else (-1, 0)
            self._path_is_old = not same and resume.path > 0
        welcome = Welcome(
            version=VERSION,
            server=version(),
            vehicle=self._common.vehicle,
            session=beginning.session,
            map=beginning.facts,
            revision=beginning.revision,
            resumed=resumed,
            reason="" if view is None else view.reason,
            may_change=self.may_change,
        )
        self._words.appendleft(framed(welcome))
        self.state, self._beat_s = "served", now_s

    def _change(self, change: Change) -> None:
        had = "map" in self.wants
        if change.bytes_per_s is not None:
            self._limit(change.bytes_per_s)
        if change.interest is not None:
            self._interest = _checked(change.interest)
        if change.wants is not None:
            new = frozenset(change.wants)
            for kind in new - self.wants:
                self._told.pop(kind, None)  # what it was told long ago may be forgotten
            if "settings" in new - self.wants:
                self._settings_told = 0
            self.wants = new
        wants = "map" in self.wants
        if wants != had or (wants and change.interest is not None):
            self.wish = Wish(self._interest if wants else None)

    def _limit(self, bytes_per_s: int) -> None:
        limits = [limit for limit in (bytes_per_s, self._common.bytes_per_s) if limit]
        self.pacer.bytes_per_s = min(limits, default=0)

    def _pieces(self, now_s: float, now_ns: int) -> Iterator[bytes]:
        while self._words:  # nobody may ask so much that it hurts: see `asks`
            yield self._words.popleft()
        if now_s - self._beat_s >= BEAT_S:
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
                    frame = self._newest(kind, self._common.feed.image(self.coarseness()), now_s)
                case _:
                    frame = self._newest(kind, self._common.feed.newest(kind), now_s)
            if not frame:
                return
            self._took(kind, len(frame), now_s)
            yield frame

    def _may(self, kind: str, size: int, now_s: float) -> bool:
        """Whether a message has room, and its kind has not had its share of a busy link."""
        pacer = self.pacer
        if now_s < self._next_s.get(kind, 0.0):
            idle = pacer.in_flight <= pacer.window // 2 and size <= pacer.window
            if self.left or not (idle or kind in ENDING):
                return False
        return pacer.fits(size, now_s)

    def _took(self, kind: str, size: int, now_s: float) -> None:
        self._next_s[kind] = now_s + size / (SHARES[kind] * self._rate())

    def _newest(self, kind: str, newest: Newest, now_s: float) -> bytes:
        told = self._told.get(kind, 0)
        if newest.number == told or not self._may(kind, len(newest.frame), now_s):
            return b""
        if told:
            self.skipped[kind] += max(0, newest.number - told - 1)
        self._told[kind] = newest.number
        return newest.frame

    def _event(self, now_s: float) -> bytes:
        events = self._common.events
        if events.last <= self._events_told or not self._may("events", EVENT, now_s):
            return b""
        found, lost = events.since(self._events_told)
        if not found:
            return b""
        self._events_told = found[0].number
        return self._common.feed.event(found[0], lost)

    def _setting(self, now_s: float) -> bytes:
        log = self._common.feed.settings
        if log.last <= self._settings_told or not self._may("settings", PIECE, now_s):
            return b""
        self._settings_told, facts = log.since(self._settings_told, PIECE)
        return framed(Settings(facts=facts))

    def _path_piece(self, now_s: float) -> bytes:
        path, (told_version, told) = self._common.feed.path, self._path
        if told_version == path.version and told >= len(path):
            return b""
        if not self._may("path", PIECE // 2, now_s):
            return b""
        most = max(self.pacer.room(now_s), PIECE) // 2 // POINT
        new_version, first, points = path.since(told_version, told, most)
        self._path = (new_version, first + len(points))
        if not len(points) and not self._path_is_old:
            return b""
        self._path_is_old = False
        body = np.asarray(points, "<f4").tobytes()
        return framed(Path(first=first, points=body, version=new_version))

    def _beat(self, now_s: float, now_ns: int) -> bytes:
        self._beat_s = now_s
        status = self._common.feed.status if "status" in self.wants else _EMPTY
        size = len(bytes(status))
        if status is not _EMPTY and self._may("status", size, now_s):
            self._took("status", size, now_s)
        else:
            status = _EMPTY
        body = _ENCODER.encode(_Beat(now_ns, status, self.link()))
        return len(body).to_bytes(4, "big") + body

    def _rate(self) -> float:
        rate = max(self.pacer.rate or FIRST_RATE, 1.0)
        limit = self.pacer.bytes_per_s
        return min(rate, limit) if limit else rate

    def _sent(self, frame: bytes, now_s: float) -> bytes:
        self.pacer.note_sent(len(frame), now_s)
        return frame


WANTS_IN_ORDER = tuple(kind for kind in SHARES if kind != "status")
assert {*WANTS_IN_ORDER, "map", "status"} == {*WANTS}  # noqa: S101 a kind that nobody would be told


def _checked(interest: Interest) -> Interest:
    """The interest, if it is one.

    Raises:
        StreamError: its numbers are none.
    """
    box = interest.box
    numbers = [interest.radius_m, *(() if box is None else (*box.low_m, *box.high_m))]
    if not np.isfinite(numbers).all():
        raise StreamError("an interest with numbers that are none", "bad_interest")
    if box is not None and any(a > b for a, b in zip(box.low_m, box.high_m, strict=True)):
        raise StreamError("a box that ends before it begins", "bad_interest")
    return interest
