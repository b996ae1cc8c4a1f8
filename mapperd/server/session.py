"""One client of the map stream: its state, its messages, and how it resumes after a break.

greeted ─ hello ─▶ admitted ─ the map is ready ─▶ served

No messages are queued for a client: when there is room, it gets the newest message of each kind. A
slow client skips outdated messages and costs no more than a fast one.
"""

import hmac
import secrets
from collections import Counter, deque
from dataclasses import dataclass, field
from typing import Any, Literal

import msgspec
import numpy as np

from mapperd import __version__
from mapperd.events import EventLog
from mapperd.server.map_source import MapView, Source
from mapperd.server.outbox import ClientOutbox
from mapperd.server.pacer import Pacer
from mapperd.server.priority_queue import SendRoom, SendSchedule
from mapperd.server.state_feed import StateFeed
from mapperd.wire.auth import FailureLimiter, TokenBucket, is_proof
from mapperd.wire.framing import StreamError, framed, server_inbox
from mapperd.wire.messages import (
    VERSION,
    AckMessage,
    AnswerMessage,
    AskMessage,
    ByeMessage,
    ChangeMessage,
    FromClient,
    GreetingMessage,
    HelloMessage,
    Interest,
    MapInfo,
    Resume,
    WelcomeMessage,
)
from mapperd.wire.requests import Fault, plain_map

__all__ = [
    "ClientSession",
    "MapStart",
    "MessageEnds",
    "Newcomer",
    "ResumeCache",
    "ResumeState",
    "SessionContext",
    "ViewRequest",
    "checked",
    "is_ticket",
]

PARKED_S = 120.0
MAX_ENDS = 4096


class MessageEnds:
    """Where on a connection messages about the map end, until they are acknowledged."""

    def __init__(self) -> None:
        self._settled = self._from = 0
        self._ends: deque[tuple[int, int]] = deque(maxlen=MAX_ENDS)

    def begin(self, number: int, sent: int) -> None:
        """Begin with a view whose last message has this number, at a byte of the connection."""
        self._settled, self._from = number, sent
        self._ends.clear()

    def note(self, number: int, sent: int) -> None:
        """Note that a message ends at this byte."""
        self._ends.append((sent, number))

    def settled(self, acked: int) -> int:
        """Return the number of the last message that was acknowledged completely."""
        while self._ends and self._ends[0][0] <= acked:
            self._settled = self._ends.popleft()[1]
        return self._settled

    def number_at(self, used: int) -> int | None:
        """Return the last message within the first `used` bytes; None if it is unknown."""
        if used < self._from:
            return None
        return max((number for end, number in self._ends if end <= used), default=self._settled)


@dataclass(frozen=True, slots=True)
class ResumeState:
    """State of a connection when it broke, from which the client may resume.

    Attributes:
        ticket: of the connection.
        acked, sent: bytes of the connection.
        ends: of its messages about the map.
        before: what the client resumed from. A client that has not received the welcome sends the
            same again.
    """

    ticket: str
    acked: int
    sent: int
    ends: MessageEnds
    before: Resume | None = None

    def number_at(self, resume: Resume) -> int | None:
        """Return the last message that the client has; None if its claim is impossible."""
        if is_ticket(resume.ticket, self.ticket):
            return self.ends.number_at(resume.bytes) if self._may_have(resume.bytes) else None
        return self.ends.number_at(0)

    def is_of(self, resume: Resume) -> bool:
        """Return whether the client that sends `resume` had this connection."""
        if is_ticket(resume.ticket, self.ticket):
            return True
        before = self.before
        if before is None or self.acked:
            return False
        return is_ticket(resume.ticket, before.ticket) and before.bytes == resume.bytes

    def _may_have(self, used: int) -> bool:
        return self.acked <= used <= self.sent


@dataclass(slots=True)
class _Parked:
    view: MapView
    resume_state: ResumeState
    since_s: float


@dataclass(slots=True)
class ResumeCache:
    """Views of lost clients, kept for two minutes; used in the map's worker thread only.

    Args:
        most: number of views; one more drops the oldest.

    Attributes:
        counters: `parked`, `parked_resumed`, `parked_dropped`.
    """

    most: int
    counters: Counter[str] = field(
        default_factory=lambda: Counter(parked=0, parked_resumed=0, parked_dropped=0)
    )
    _parked: list[_Parked] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self._parked)

    def park(self, view: MapView, resume_state: ResumeState, now_s: float) -> None:
        """Keep the view of a lost client; it continues to collect changes."""
        self.counters["parked"] += 1
        self._parked.append(_Parked(view, resume_state, now_s))
        while len(self._parked) > self.most:
            self._drop(self._parked[0])

    def expire(self, now_s: float) -> None:
        """Drop the views of clients that did not return in time."""
        while self._parked and now_s - self._parked[0].since_s > PARKED_S:
            self._drop(self._parked[0])

    def take(self, resume: Resume, interest: Interest, source: Source) -> MapView | None:
        """Return the view of a client that returns, and remove it; None if it cannot resume."""
        found = [one for one in self._parked if one.resume_state.is_of(resume)]
        if not found:
            return None
        one = found[0]
        number = one.resume_state.number_at(resume)
        held = (resume.level, resume.detail, resume.radius_m, resume.box)
        is_same = (
            resume.map == source.info().id
            and resume.session == source.session
            and held == (interest.level, interest.detail, interest.radius_m, interest.box)
        )
        if number is None or not is_same or not one.view.resume(interest, number):
            self._drop(one)
            return None
        self._parked.remove(one)
        self.counters["parked_resumed"] += 1
        return one.view

    def _drop(self, one: _Parked) -> None:
        self._parked.remove(one)
        self.counters["parked_dropped"] += 1
        one.view.close()


def is_ticket(shown: str, ticket: str) -> bool:
    """Return whether `shown` is the ticket, in constant time."""
    return bool(shown) and hmac.compare_digest(shown.encode(), ticket.encode())


@dataclass(frozen=True, slots=True)
class Newcomer:
    """A client that has connected and has not sent its hello yet.

    Attributes:
        peer: address of the client.
        challenge: of its greeting.
        token: of the listener; None if file permissions decide or everybody is admitted.
    """

    peer: str
    challenge: str
    token: bytes | None

    def check(self, proof: str, failures: FailureLimiter, now_s: float) -> None:
        """Check that the client knows the token.

        Raises:
            StreamError: the proof is wrong (`wrong_token`), or the client has to wait
                (`locked_out`).
        """
        if self.token is None:
            return
        wait_s = failures.wait_s(self.peer, now_s)
        if wait_s > 0:  # even with the right proof: otherwise guessing would continue
            raise StreamError(f"too many wrong tokens; wait {wait_s:.0f} s", "locked_out")
        if not is_proof(proof, self.token, self.challenge):
            failures.failed(self.peer, now_s)
            text = "wrong token; use a copy of the file that server.token_file of the daemon names"
            raise StreamError(text, "wrong_token")


@dataclass(frozen=True, slots=True)
class ViewRequest:
    """The view of the map that a client requests; no interest closes its view."""

    interest: Interest | None
    resume: Resume | None = None


@dataclass(frozen=True, slots=True)
class MapStart:
    """The map when a client's view begins, as in `WelcomeMessage`."""

    info: MapInfo
    revision: int
    session: str


def checked(interest: Interest) -> Interest:
    """Return the interest if its numbers are valid.

    Raises:
        StreamError: `bad_interest`.
    """
    box = interest.box
    numbers = [interest.radius_m, *(() if box is None else (*box.low_m, *box.high_m))]
    if not np.isfinite(numbers).all():
        raise StreamError("an interest with numbers that are not finite", "bad_interest")
    if box is not None and any(a > b for a, b in zip(box.low_m, box.high_m, strict=True)):
        raise StreamError("a box whose low corner is above its high corner", "bad_interest")
    return interest


ASKS = 8
"""Requests of a client that may wait."""

ANSWERS = 32
MESSAGES_PER_S, MESSAGES_AT_ONCE = 2000.0, 20_000
CHANGES_PER_S, CHANGES_AT_ONCE = 4.0, 8
"""Changes of interest; of more frequent ones, the newest is applied later."""

QUIET_S = 60.0


@dataclass(frozen=True, slots=True)
class SessionContext:
    """What all sessions share.

    Attributes:
        feed: messages about the daemon's state.
        events: event log of the daemon.
        failures: wrong proofs by address.
        vehicle: name of the vehicle.
        bytes_per_s: limit of each client; 0 has no limit.
    """

    feed: StateFeed
    events: EventLog
    failures: FailureLimiter
    vehicle: str
    bytes_per_s: int = 0


class ClientSession:
    """One client, from the greeting to the bye. Callers pass the time in seconds.

    Args:
        common: what all sessions share.
        newcomer: the client.
        may_change: the client may make requests that change something.

    Attributes:
        state: see the module's docstring.
        name: of the client, as in its hello.
        view_request: requested view of the map; None when it is fulfilled.
        view: the client's view of the map.
        asks: requests that wait.
        pacer: limits of the connection.
        outbox: messages without the map.
        ticket: resumes this session after a break.
    """

    def __init__(self, common: SessionContext, newcomer: Newcomer, *, may_change: bool) -> None:
        self.state: Literal["greeted", "admitted", "served"] = "greeted"
        self.name = ""
        self.view_request: ViewRequest | None = None
        self.view: MapView | None = None
        self.asks: deque[msgspec.Raw] = deque()
        self.pacer = Pacer(common.bytes_per_s)
        self._turns = SendSchedule(self.pacer)
        self.outbox = ClientOutbox(common.feed, common.events, self.pacer)
        self.may_change = may_change
        self.ticket = secrets.token_hex(16)
        self._ends = MessageEnds()
        self._is_resumed = False
        self._common = common
        self._newcomer = newcomer
        self._inbox = server_inbox()
        self._messages = TokenBucket(MESSAGES_PER_S, MESSAGES_AT_ONCE)
        self._changes = TokenBucket(CHANGES_PER_S, CHANGES_AT_ONCE)
        self._interest_changed = False
        self._answers: deque[bytes] = deque()
        self._resume: Resume | None = None
        self._interest = Interest()

    @property
    def wants(self) -> frozenset[str]:
        """Kinds of messages that the client wants."""
        return self.outbox.wants

    @property
    def left(self) -> int:
        """Blocks of the map that are still to be sent."""
        return self.outbox.left

    @left.setter
    def left(self, blocks: int) -> None:
        self.outbox.left = blocks

    def greeting(self, now_s: float) -> bytes:
        """Return the first message."""
        return self._sent(framed(GreetingMessage(challenge=self._newcomer.challenge)), now_s)

    def bye(self, reason: str, message: str) -> bytes:
        """Return the last message."""
        return framed(ByeMessage(reason=reason, message=message))

    def take(self, data: bytes, now_s: float) -> None:
        """Process bytes of the client.

        Raises:
            StreamError: the client broke the protocol; close the connection.
        """
        for message in self._inbox.feed(data):
            if self._messages.take(now_s) > 0:
                raise StreamError("too many messages", "too_many_messages")
            self._heard(message, now_s)

    def look(self, now_s: float) -> None:
        """Apply a delayed change of interest, and check that the client still acknowledges.

        Raises:
            StreamError: it does not (`no_acks`).
        """
        self._apply_interest(now_s)
        if self.pacer.quiet_s(now_s) > QUIET_S:
            raise StreamError(f"no acknowledgement for {QUIET_S:g} s", "no_acks")

    def view_ready(self, view: MapView | None, map_start: MapStart) -> None:
        """Set the view that the client requested; welcome the client if it is new."""
        self.view = view
        self.left = 0 if view is None else view.left
        if self.state == "admitted":
            self._welcome(map_start)

    def took(self, view: MapView, *, is_resumed: bool) -> None:
        """Number the messages of a new view, or of one that is resumed."""
        self._ends.begin(view.number, 0)
        self._is_resumed = is_resumed

    def resume_state(self) -> ResumeState:
        """Return the state from which the client may resume."""
        before = self._resume if self._is_resumed else None
        return ResumeState(self.ticket, self.pacer.acked, self.pacer.sent, self._ends, before)

    def is_known_by(self, ticket: str) -> bool:
        """Return whether a connection with this ticket replaces this one."""
        came_with = "" if self._resume is None or self.pacer.acked else self._resume.ticket
        return is_ticket(ticket, self.ticket) or is_ticket(ticket, came_with)

    @property
    def settled(self) -> int:
        """Number of the last message about the map that the client acknowledged."""
        return self._ends.settled(self.pacer.acked)

    def answer(self, number: int | None, result: dict[str, Any] | Fault) -> None:
        """Add the answer to a request by its id: the result or a fault."""
        if isinstance(result, Fault):
            message = AnswerMessage(id=number, error=plain_map(result))
        else:
            message = AnswerMessage(id=number, result=plain_map(result))
        self._answers.append(framed(message))

    @property
    def answers(self) -> int:
        """Answers that have not been sent yet."""
        return len(self._answers)

    def next(self, now_s: float, now_ns: int) -> bytes:
        """Return the bytes to send now, without the map, most urgent first."""
        if self.state != "served":
            return b""
        answers, self._answers = self._answers, deque()  # `asks` limits how many there are
        data = b"".join(self._sent(answer, now_s) for answer in answers)
        pieces = self.outbox.pieces(now_s, now_ns)
        return data + b"".join(self._sent(piece, now_s) for piece in pieces)

    def map_rooms(self, now_s: float) -> SendRoom:
        """Return how many bytes of the map may be sent now."""
        if self.state != "served" or self.view is None or self.outbox.waits:
            return SendRoom()
        return self._turns.rooms(now_s)

    def nothing_near(self) -> None:
        """End the pass: there was room for near blocks and none to send."""
        self._turns.end_pass()

    def mapped(
        self, frame: bytes, number: int, left: int, now_s: float, near_left: int | None = None
    ) -> bytes:
        """Note a message about the map, and return its bytes.

        Args:
            frame: the message.
            number: of the message.
            left: blocks that are still to be sent.
            now_s: now.
            near_left: blocks that are left of a pass, if the message is about near blocks.
        """
        self.left = left
        if near_left is None:
            self._turns.sent_far()
        else:
            self._turns.sent_near(len(frame), near_left, now_s)
        sent = self._sent(frame, now_s)
        self._ends.note(number, self.pacer.sent)
        return sent

    def sent_reset(self, frame: bytes, view: MapView, now_s: float) -> bytes:
        """Note a reset, after which the numbering of the view begins; return its bytes."""
        data = self._sent(frame, now_s)
        self._ends.begin(view.number, self.pacer.sent)
        return data

    def _heard(self, message: FromClient, now_s: float) -> None:
        if isinstance(message, HelloMessage):
            self._hello(message, now_s)
            return
        if self.state == "greeted":
            raise StreamError("the first message must be hello", "no_hello")
        match message:
            case AckMessage(bytes=acked):
                if not self.pacer.note_ack(acked, now_s):
                    raise StreamError("an acknowledgement of bytes that were not sent", "bad_ack")
            case ChangeMessage():
                self._change(message)
                self._apply_interest(now_s)
            case AskMessage(ask=ask):
                self.asks.append(msgspec.Raw(bytes(ask)))
                if len(self.asks) > ASKS or len(self._answers) > ANSWERS:
                    raise StreamError("too many requests at once", "too_many_asks")

    def _hello(self, hello: HelloMessage, now_s: float) -> None:
        if self.state != "greeted":
            raise StreamError("hello may be sent once", "hello_twice")
        if hello.version != VERSION:
            text = f"version {hello.version} is not supported; allowed: {VERSION}"
            raise StreamError(text, "bad_version")
        self._newcomer.check(hello.proof, self._common.failures, now_s)
        if hello.beside:
            raise StreamError("a client has one connection", "no_such_connection")
        self.state, self.name = "admitted", hello.name
        self.outbox.want(hello.wants)
        self._resume = hello.resume
        self._limit(hello.bytes_per_s)
        self._interest = checked(hello.interest)
        self.view_request = ViewRequest(
            self._interest if "map" in self.wants else None, hello.resume
        )
        self.outbox.begin(hello.events_since)

    def _welcome(self, map_start: MapStart) -> None:
        resume, view = self._resume, self.view
        same = resume is not None and resume.session == map_start.session
        resumed = same if view is None else view.resumed
        if resume is not None and resumed:
            self.outbox.resume(resume, same=same)
        welcome = WelcomeMessage(
            version=VERSION,
            server=__version__,
            vehicle=self._common.vehicle,
            session=map_start.session,
            map=map_start.info,
            revision=map_start.revision,
            resumed=resumed,
            reason="" if view is None else view.reason,
            may_change=self.may_change,
            ticket=self.ticket,
        )
        self._answers.appendleft(framed(welcome))
        self.state = "served"

    def _change(self, change: ChangeMessage) -> None:
        had = "map" in self.wants
        if change.bytes_per_s is not None:
            self._limit(change.bytes_per_s)
        if change.interest is not None:
            self._interest = checked(change.interest)
        if change.wants is not None:
            self.outbox.want(change.wants)
        wants = "map" in self.wants
        if wants != had or (wants and change.interest is not None):
            self._interest_changed = True

    def _apply_interest(self, now_s: float) -> None:
        """Apply a changed interest, unless the client changes it too often."""
        if self._interest_changed and not self._changes.wait_s(now_s):
            self._changes.take(now_s)
            self._interest_changed = False
            self.view_request = ViewRequest(self._interest if "map" in self.wants else None)

    def _limit(self, bytes_per_s: int) -> None:
        limits = [limit for limit in (bytes_per_s, self._common.bytes_per_s) if limit]
        self.pacer.budget.bytes_per_s = min(limits, default=0)

    def _sent(self, frame: bytes, now_s: float) -> bytes:
        self.pacer.note_sent(len(frame), now_s)
        return frame
