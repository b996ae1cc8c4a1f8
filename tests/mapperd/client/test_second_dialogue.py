"""What is said and heard on a second line, and what a daemon may not say there."""

from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapperd.client import EndedError, Interest, StreamError
from mapperd.client.protocol import Dialogue, Wishes
from mapperd.client.second_line import SecondDialogue
from mapperd.client.state import Knowledge
from mapperd.wire.auth import proof_of
from mapperd.wire.blocks import CELLS, UNKNOWN, encode_blocks
from mapperd.wire.framing import framed, server_inbox
from mapperd.wire.messages import (
    Ack,
    Answer,
    Blocks,
    Bye,
    Event,
    Fan,
    FromServer,
    Greeting,
    Hello,
    Localization,
    Path,
    Pose,
    Reset,
    Robots,
    Settings,
    Status,
    Welcome,
)
from tests.mapperd.client.test_hostile_server import POSE
from tests.support.stream_server import FACTS, TOKEN, Served, a_block

FIRST = Welcome(
    version=1, server="", vehicle="", session="s", map=FACTS, revision=0, resumed=False, ticket="t"
)
SECOND = msgspec.structs.replace(FIRST, resumed=True, ticket="")


def a_first(*wants: Any, **more: Any) -> tuple[Dialogue, Knowledge]:
    """Connected, and welcome."""
    wishes = Wishes(wants or ("map", "status"), Interest(level=1), 5000, "me")
    knowledge = Knowledge(wishes.interest, lambda _: None)
    dialogue = Dialogue(wishes, knowledge, None, lambda _: None)
    dialogue.receive(framed(Greeting()) + framed(msgspec.structs.replace(FIRST, **more)))
    dialogue.outgoing()
    return dialogue, knowledge


def a_second(
    knowledge: Knowledge | None = None, welcome: Welcome | None = SECOND
) -> tuple[SecondDialogue, Knowledge]:
    knowledge = knowledge or a_first()[1]
    dialogue = SecondDialogue("me", knowledge, TOKEN)
    dialogue.receive(framed(Greeting()))
    if welcome is not None:
        dialogue.receive(framed(welcome))
        dialogue.outgoing()
    return dialogue, knowledge


def body(*keys: int, empty: bool = False) -> bytes:
    served = Served()
    for key in keys:
        served.put((key, 0, 0), np.full(CELLS, UNKNOWN, np.int8) if empty else a_block(1))
    return encode_blocks(served.since(0))


def blocks(order: int, data: bytes, **more: Any) -> Blocks:
    return Blocks(revision=order, stamp_ns=1, body=data, order=order, **more)


def test_hello_shows_the_ticket_and_leaves_all_else_to_the_first() -> None:
    dialogue, _ = a_second(welcome=None)
    (hello,) = server_inbox().feed(dialogue.outgoing())
    assert hello == Hello(version=1, name="me", beside="t")


def test_proof_is_of_its_own_challenge() -> None:
    _, knowledge = a_first()
    dialogue = SecondDialogue("me", knowledge, TOKEN)
    dialogue.receive(framed(Greeting(challenge="another")))
    (hello,) = server_inbox().feed(dialogue.outgoing())
    assert isinstance(hello, Hello)
    assert hello.proof == proof_of(TOKEN, "another")
    with pytest.raises(EndedError) as caught:
        SecondDialogue("me", knowledge, None).receive(framed(Greeting(challenge="another")))
    assert (caught.value.reason, caught.value.is_final) == ("needs_token", True)


def test_its_own_bytes_are_acknowledged_and_the_firsts_are_gone_on_from() -> None:
    first, knowledge = a_first()
    used = knowledge.used
    dialogue = SecondDialogue("me", knowledge, None)
    said = framed(Greeting()) + framed(SECOND) + framed(blocks(3, body(1)))
    dialogue.receive(framed(Greeting()))
    dialogue.outgoing()
    assert dialogue.outgoing() == b""  # nothing is acknowledged before the welcome
    dialogue.receive(said[len(framed(Greeting())) :] + framed(Status(stamp_ns=1))[:5])
    assert server_inbox().feed(dialogue.outgoing()) == [Ack(bytes=len(said))]
    assert dialogue.outgoing() == b""
    assert knowledge.used == used
    first.receive(framed(Status(stamp_ns=1)))
    assert knowledge.used == used + len(framed(Status(stamp_ns=1)))


def test_blocks_are_taken_and_status_is_not() -> None:
    dialogue, knowledge = a_second()
    dialogue.receive(framed(blocks(3, body(1, 2), complete=3)))
    dialogue.receive(framed(Status(stamp_ns=1, link={"left": 9})))
    assert knowledge.mirror is not None
    assert sorted(knowledge.mirror.keys()[:, 0].tolist()) == [1, 2]
    assert knowledge.is_complete
    assert knowledge.newest_of(Status) is None


def test_what_the_first_forgot_since_the_hello_is_not_brought_back() -> None:
    first, knowledge = a_first()
    first.receive(framed(blocks(1, body(1))))
    dialogue, _ = a_second(knowledge, welcome=None)
    first.receive(framed(blocks(3, body(1, empty=True))))
    dialogue.receive(framed(SECOND) + framed(blocks(2, body(1))))
    assert len(knowledge.mirror or ()) == 0


@pytest.mark.parametrize(
    "more",
    [
        {"session": "another"},
        {"resumed": False},
        {"version": 2},
    ],
    ids=str,
)
def test_welcome_of_another_connection_is_refused(more: dict[str, Any]) -> None:
    dialogue, _ = a_second(welcome=None)
    with pytest.raises(StreamError) as caught:
        dialogue.receive(framed(msgspec.structs.replace(SECOND, **more)))
    assert not isinstance(caught.value, EndedError)
    assert caught.value.reason == ("bad_version" if "version" in more else "bad_order")
    assert not dialogue.is_welcome


def test_map_may_have_been_reset_and_the_first_does_not_say_so_yet() -> None:
    first, knowledge = a_first()
    other = msgspec.structs.replace(FACTS, id="another")
    dialogue, _ = a_second(knowledge, msgspec.structs.replace(SECOND, map=other))
    assert dialogue.is_welcome
    assert knowledge.mirror is not None
    assert knowledge.mirror.facts.id == FACTS.id
    first.receive(framed(Reset(map=other, revision=1, order=1)))
    assert knowledge.mirror.facts.id == "another"


@pytest.mark.parametrize(
    "message",
    [
        Greeting(),
        SECOND,
        Reset(map=FACTS, revision=1, order=1),
        Pose(**POSE),
        Path(first=0, points=b""),
        Fan(bearings_rad=(-1.0, 1.0), vertical_aperture_rad=0.2, min_range_m=0, max_range_m=1),
        Robots(seen=[]),
        Localization(report={}),
        Event(event={"number": 1}),
        Settings(facts={}),
        Answer(id=1),
    ],
    ids=lambda message: type(message).__name__,
)
def test_anything_else_is_refused(message: FromServer) -> None:
    dialogue, knowledge = a_second()
    with pytest.raises(StreamError) as caught:
        dialogue.receive(framed(message))
    assert not isinstance(caught.value, EndedError)
    assert caught.value.reason == "bad_order"
    assert (len(knowledge.path), knowledge.settings, knowledge.newest) == (0, {}, {})


@pytest.mark.parametrize("early", [blocks(1, b""), Status(stamp_ns=1), SECOND])
def test_news_before_greeting_and_welcome_are_refused(early: FromServer) -> None:
    _, knowledge = a_first()
    with pytest.raises(StreamError, match=r"before a welcome|out of turn"):
        SecondDialogue("me", knowledge, None).receive(framed(early))


@pytest.mark.parametrize(
    "bad", [blocks(1, b"nothing"), blocks(1, b"", complete=2)], ids=["body", "complete"]
)
def test_blocks_are_checked_as_those_of_the_first(bad: Blocks) -> None:
    dialogue, _ = a_second()
    with pytest.raises(StreamError):
        dialogue.receive(framed(bad))


def test_good_bye_has_its_reason() -> None:
    dialogue, _ = a_second(welcome=None)
    with pytest.raises(EndedError) as caught:
        dialogue.receive(framed(Bye(reason="no_such_connection")))
    assert caught.value.reason == "no_such_connection"


def test_nothing_comes_after_its_end() -> None:
    dialogue, knowledge = a_second()
    dialogue.end()
    assert not dialogue.is_welcome
    with pytest.raises(EndedError):
        knowledge.take_beside(blocks(1, body(1)))


@pytest.mark.parametrize(
    ("wants", "ticket", "link", "is_wanted"),
    [
        (("map",), "t", {"second_line": True}, True),
        (("map",), "t", {"second_line": False}, False),
        (("map",), "t", {"second_line": 1}, False),
        (("map",), "t", {"second_line": "yes"}, False),
        (("map",), "t", {}, False),
        (("map",), "", {"second_line": True}, False),
        (("pose",), "t", {"second_line": True}, False),
    ],
)
def test_second_line_is_wanted_where_it_is_advised(
    *, wants: tuple[Any, ...], ticket: str, link: dict[str, Any], is_wanted: bool
) -> None:
    first, _ = a_first(*wants, ticket=ticket)
    assert not first.wants_second
    first.receive(framed(Status(stamp_ns=1, link=link)))
    assert first.wants_second == is_wanted
    first.end()
    first.begin()
    first.receive(framed(Greeting()) + framed(FIRST))
    assert not first.wants_second  # before this connection's daemon says so


GOOD = [
    framed(message)
    for message in (
        blocks(3, body(1, 2), complete=3),
        blocks(2, body(1, empty=True)),
        Status(stamp_ns=5, link={"left": 3}),
    )
]


@given(
    st.lists(st.sampled_from(GOOD), min_size=1, max_size=5),
    st.lists(st.tuples(st.integers(0), st.integers(0, 255)), max_size=4),
    st.binary(max_size=40),
)
@settings(max_examples=200, deadline=None, derandomize=True)
def test_spoiled_bytes_are_taken_or_refused(
    said: list[bytes], spoiled: list[tuple[int, int]], more: bytes
) -> None:
    dialogue, knowledge = a_second()
    stream = bytearray(b"".join(said))
    for at, value in spoiled:
        stream[at % len(stream)] = value
    try:
        dialogue.receive(bytes(stream))
        dialogue.receive(more)
    except StreamError:
        pass
    else:
        assert len(dialogue.outgoing()) < 100
    assert knowledge.mirror is not None
    knowledge.mirror.digest()
