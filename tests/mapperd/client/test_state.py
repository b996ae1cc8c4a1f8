"""What a client reports that it holds, and by which interest it reads messages."""

import msgspec
import numpy as np

from mapperd.client.state import ClientState
from mapperd.wire.blocks import CELLS, UNKNOWN, BlockSet, encode_blocks
from mapperd.wire.messages import (
    BlocksMessage,
    Interest,
    MapBox,
    PathMessage,
    ResetMessage,
    WelcomeMessage,
)
from tests.support.stream_server import MAP_INFO

WELCOME = WelcomeMessage(
    version=1, server="", vehicle="", session="s", map=MAP_INFO, revision=0, resumed=False
)
POINTS = np.ones((2, 3), "<f4").tobytes()


def body(*, counts: bool = False) -> bytes:
    cells = np.full((1, CELLS), 5, np.int8)
    seen = np.ones((1, CELLS), np.uint8) if counts else None
    return encode_blocks(BlockSet(np.zeros((1, 3), np.int32), np.zeros(1, np.uint32), cells, seen))


def known(interest: Interest | None = None) -> ClientState:
    client_state = ClientState(interest or Interest(), lambda _: None)
    client_state.wants_map = True
    client_state.begin(WELCOME, None)
    return client_state


def test_resume_reports_both_what_is_complete_and_the_newest() -> None:
    box = MapBox((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    client_state = known(Interest(level=1, box=box))
    assert client_state.resume() is None
    client_state.take(BlocksMessage(revision=7, stamp_ns=1, complete=6, body=body()))
    client_state.take(BlocksMessage(revision=9, stamp_ns=1, left=5, body=body()))
    client_state.take(PathMessage(first=0, points=POINTS, version=3))
    resume = client_state.resume()
    assert resume is not None
    assert (resume.revision, resume.newest) == (6, 9)
    assert (resume.level, resume.detail, resume.box) == (1, "log_odds", box)
    assert (resume.path, resume.path_version) == (2, 3)
    client_state.take(ResetMessage(map=MAP_INFO, revision=1))
    assert client_state.resume() is None
    client_state.take(BlocksMessage(revision=1, stamp_ns=1, complete=1, body=body()))
    resume = client_state.resume()
    assert resume is not None
    assert resume.newest == 1


def test_blocks_are_read_by_the_interest_of_the_last_reset() -> None:
    first, second, third = (Interest(level=n, detail="counts") for n in range(3))
    client_state = known(first)
    mirror = client_state.mirror
    assert mirror is not None
    client_state.interest = third  # changed twice; the daemon has heeded one yet
    client_state.take(BlocksMessage(revision=1, stamp_ns=1, complete=1, body=body(counts=True)))
    assert (mirror.interest, client_state.is_complete) == (first, False)
    client_state.take(ResetMessage(map=MAP_INFO, revision=1, interest=second))
    client_state.take(BlocksMessage(revision=1, stamp_ns=1, complete=1, body=body(counts=True)))
    assert (mirror.interest, client_state.is_complete) == (second, False)
    assert client_state.resume() is None
    client_state.take(ResetMessage(map=MAP_INFO, revision=1, interest=third))
    client_state.take(BlocksMessage(revision=1, stamp_ns=1, complete=1, body=body(counts=True)))
    assert (mirror.interest, client_state.is_complete) == (third, True)


def test_path_is_of_its_session() -> None:
    client_state = known()
    client_state.take(BlocksMessage(revision=1, stamp_ns=1, complete=1, body=body()))
    client_state.take(PathMessage(first=0, points=POINTS))
    again = msgspec.structs.replace(WELCOME, resumed=True)
    client_state.begin(again, client_state.resume())
    assert len(client_state.path) == 2
    other = msgspec.structs.replace(again, session="another")
    client_state.begin(other, client_state.resume())
    assert len(client_state.path) == 0
    assert len(client_state.mirror or ()) == 1


def test_thresholds_and_origin_may_change_while_the_link_is_away() -> None:
    client_state = known()
    client_state.take(BlocksMessage(revision=1, stamp_ns=1, complete=1, body=body()))
    facts = msgspec.structs.replace(MAP_INFO, origin_deg=(54.0, 10.0), occupied_log_odds=1.0)
    client_state.begin(
        msgspec.structs.replace(WELCOME, resumed=True, map=facts), client_state.resume()
    )
    assert client_state.mirror is not None
    assert client_state.mirror.info == facts
    assert len(client_state.mirror) == 1


def blocks_of(sent: dict[int, int], **more: int) -> BlocksMessage:
    """Blocks by the first number of their keys, each with one value in all its cells."""
    keys = np.zeros((len(sent), 3), np.int32)
    keys[:, 0] = list(sent)
    cells = np.repeat(np.array(list(sent.values()), np.int8)[:, None], CELLS, axis=1)
    body = encode_blocks(BlockSet(keys, np.zeros(len(sent), np.uint32), cells))
    return BlocksMessage(stamp_ns=1, body=body, **more)


def test_each_message_replaces_the_blocks_before() -> None:
    client_state = known()
    for number in range(1, 20):
        client_state.take(blocks_of({number % 3: number}, revision=number, complete=number))
        client_state.take(blocks_of({5: number if number % 2 else UNKNOWN}, revision=number))
        if number == 10:
            client_state.take(ResetMessage(map=MAP_INFO, revision=10))
    assert client_state.mirror is not None
    held = client_state.mirror.blocks()
    values = dict(zip(held.keys[:, 0].tolist(), held.cells[:, 0].tolist(), strict=True))
    assert values == {0: 18, 1: 19, 2: 17, 5: 19}


def test_revisions_never_go_down() -> None:
    client_state = known()
    client_state.take(blocks_of({1: 1}, revision=16, complete=15))
    client_state.take(blocks_of({1: 2}, revision=14, complete=14))
    resume = client_state.resume()
    assert resume is not None
    assert (resume.revision, resume.newest) == (15, 16)


def test_nothing_is_resumed_after_a_fault_although_the_connection_lives() -> None:
    welcome = msgspec.structs.replace(WELCOME, ticket="t")
    client_state = known()
    client_state.begin(welcome, None)
    client_state.take(blocks_of({1: 1}, revision=1, complete=1))
    client_state.invalidate()
    client_state.take(blocks_of({1: 2}, revision=2, complete=2))
    assert client_state.resume() is None
    client_state.begin(welcome, None)
    client_state.take(blocks_of({1: 1}, revision=1, complete=1))
    assert client_state.resume() is not None
