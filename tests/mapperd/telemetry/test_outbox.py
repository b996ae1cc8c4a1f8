from hypothesis import given
from hypothesis import strategies as st

from mapperd.telemetry.broker import Kind, Outbox, QueuedMessage
from tests.mapperd.telemetry.conftest import message

LIMIT = 10


def texts(outbox: Outbox, *kinds: Kind) -> list[str]:
    taken = []
    while (one := outbox.take(*kinds)) is not None:
        taken.append(one.payload.decode())
    return taken


def test_the_oldest_telemetry_goes_first() -> None:
    outbox = Outbox(LIMIT)
    for k in range(6):
        outbox.put(message(Kind.EVENT, k))
        outbox.put(message(Kind.TELEMETRY, k))
    outbox.put(message(Kind.ANSWER, 7))
    assert outbox.dropped == {Kind.TELEMETRY: 3}
    assert texts(outbox, Kind.TELEMETRY) == ["3", "4", "5"]
    assert texts(outbox, Kind.ANSWER, Kind.EVENT) == ["7", "0", "1", "2", "3", "4", "5"]


def test_events_go_before_answers_and_both_only_after_telemetry() -> None:
    outbox = Outbox(LIMIT)
    for k in range(8):
        outbox.put(message(Kind.ANSWER, k))
        outbox.put(message(Kind.EVENT, k))
    assert outbox.dropped == {Kind.EVENT: 6}
    for k in range(4):
        outbox.put(message(Kind.ANSWER, 8 + k))
    assert outbox.dropped == {Kind.EVENT: 8, Kind.ANSWER: 2}
    assert texts(outbox, Kind.ANSWER) == [str(k) for k in range(2, 12)]


def test_of_a_state_only_the_newest_waits() -> None:
    outbox = Outbox(LIMIT)
    for k in range(100):
        outbox.put(message(Kind.STATE, k, topic="ab"[k % 2]))
    assert (len(outbox), outbox.replaced, outbox.dropped) == (2, 98, {})
    assert texts(outbox, Kind.STATE) == ["98", "99"]


def test_what_could_not_be_sent_is_next_unless_it_was_overtaken() -> None:
    outbox = Outbox(LIMIT)
    outbox.put(message(Kind.EVENT, 2))
    outbox.put_back(message(Kind.EVENT, 1))
    outbox.put(message(Kind.STATE, 5, topic="old"))
    outbox.put_back(message(Kind.STATE, 4, topic="old"))
    outbox.put_back(message(Kind.STATE, 3, topic="first"))
    assert texts(outbox, Kind.EVENT, Kind.STATE) == ["1", "2", "3", "5"]


def test_only_what_lasts_outlives_the_connection() -> None:
    outbox = Outbox(LIMIT)
    for kind in Kind:
        outbox.put(message(kind, int(kind)))
    outbox.forget_what_passes()
    assert texts(outbox, *Kind) == ["1", "2"]
    assert outbox.dropped == {Kind.TELEMETRY: 1}


KINDS = st.sampled_from(Kind)
DOINGS = st.lists(st.tuples(st.sampled_from(("put", "back", "take")), KINDS, st.integers(0, 3)))


@given(DOINGS)
def test_it_is_bounded_and_every_message_is_accounted_for(
    doings: list[tuple[str, Kind, int]],
) -> None:
    outbox, put, taken = Outbox(LIMIT), 0, 0
    for doing, kind, topic in doings:
        one = QueuedMessage(str(topic), b"", kind)
        if doing == "put":
            outbox.put(one)
        elif doing == "back":
            outbox.put_back(one)
        put += doing != "take"
        taken += doing == "take" and outbox.take(kind) is not None
        assert len(outbox) <= LIMIT + 4
        assert put == taken + len(outbox) + outbox.dropped.total() + outbox.replaced
