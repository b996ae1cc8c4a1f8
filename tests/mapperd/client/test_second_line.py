"""`MapClient` with a second line, against a small daemon on real sockets."""

import asyncio
from typing import Any

import msgspec
import numpy as np
import pytest

from mapperd.client import MapClient, connect
from mapperd.client.connect import place_of
from mapperd.client.second_line import SecondDialogue, SecondLine
from mapperd.wire.blocks import CELLS, BlockSet, encode_blocks
from mapperd.wire.messages import Blocks, Bye, Hello, Pose, Reset, Status
from tests.mapperd.client.test_client import POSE, go, pair, until
from tests.mapperd.client.test_second_dialogue import a_first
from tests.support.stream_server import TOKEN, Connection, Served, Server

pytestmark = pytest.mark.net


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connect, "WAIT_S", 0.01)
    monkeypatch.setattr(connect, "LONGEST_WAIT_S", 0.01)


def advising(**more: Any) -> Served:
    return Served(ticket="secret", advises_second=True, **more)


def blocks(order: int, key: int, value: int) -> Blocks:
    told = BlockSet(
        np.array([[key, 0, 0]], np.int32),
        np.zeros(1, np.uint32),
        np.full((1, CELLS), value, np.int8),
    )
    return Blocks(revision=order, stamp_ns=1, body=encode_blocks(told), order=order)


def lines(server: Server) -> tuple[list[Connection], list[Connection]]:
    """First connections and second lines that live."""
    firsts = [one for one in server.connections if not one.is_second]
    return firsts, [one for one in server.connections if one.is_second]


def hellos(served: Served) -> tuple[list[Hello], list[Hello]]:
    firsts = [hello for hello in served.hellos if not hello.beside]
    return firsts, [hello for hello in served.hellos if hello.beside]


def value_of(client: MapClient, key: int) -> int:
    assert client.mirror is not None
    return int(client.mirror.cells_of([[key, 0, 0]])[0, 0])


async def both(server: Server, client: MapClient) -> tuple[Connection, Connection]:
    await until(lambda: client.link.lines == 2)
    (first,), (second,) = lines(server)
    return first, second


def test_advice_opens_a_second_line_whose_blocks_arrive() -> None:
    async def advise() -> None:
        served = advising(token=TOKEN)
        async with pair(served, token=TOKEN, name="me", bytes_per_s=10**6) as (server, client):
            assert client.link.lines == 0
            first, second = await both(server, client)
            (hello,) = hellos(served)[1]
            assert hello == Hello(version=1, proof=hello.proof, name="me", beside="secret")
            second.say(blocks(7, 1, 5))
            await until(lambda: value_of(client, 1) == 5)
            first.say(blocks(6, 1, 4), blocks(8, 2, 3))
            await until(lambda: value_of(client, 2) == 3)
            assert value_of(client, 1) == 5
            await until(lambda: (first.acked, second.acked) == (first.sent, second.sent))
            assert client.link.bytes == first.sent + second.sent
            assert (client.link.connects, client.link.faults) == (1, 0)
        assert client.link.lines == 0

    go(advise())


@pytest.mark.parametrize("advice", [None, False, 1])
def test_without_advice_there_is_one_line(advice: object) -> None:
    async def follow() -> None:
        served = Served(ticket="secret", advises_second=advice, status_s=0.01)
        async with pair(served) as (server, client):
            await client.complete(5)
            for number in range(2, 5):
                stamp = Status(stamp_ns=number, link={"second_line": advice})
                server.connections[0].say(stamp)
                await until(lambda: client.status is not None)
            await until(lambda: server.connections[0].acked > 500)
            assert (len(served.hellos), client.link.lines) == (1, 1)

    go(follow())


@pytest.mark.parametrize("how", ["cut", "closing", "silent"])
def test_second_line_that_ended_is_tried_again(how: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connect, "SILENCE_S", 0.5)

    async def end() -> None:
        served = advising(status_s=0.01)
        async with pair(served) as (server, client):
            first, second = await both(server, client)
            if how == "silent":
                second.quiet = True
            elif how == "closing":
                second.say(Bye(reason="closing"))
            else:
                second.writer.transport.abort()
            await until(lambda: len(hellos(served)[1]) > 1 and client.link.lines == 2)
            assert lines(server)[0] == [first]
            assert hellos(served)[1][1].beside == "secret"
            assert (client.link.connects, client.link.faults) == (1, 0)

    go(end())


def test_end_of_the_first_is_that_of_the_second() -> None:
    async def end() -> None:
        served = advising()
        async with pair(served) as (server, client):
            first, second = await both(server, client)
            second.say(blocks(50, 1, 5))
            await until(lambda: value_of(client, 1) == 5)
            served.ticket = "another"
            first.writer.transport.abort()
            await until(lambda: client.link.connects == 2)
            _, again = await both(server, client)
            assert again is not second
            assert [hello.beside for hello in hellos(served)[1]] == ["secret", "another"]
            again.say(blocks(2, 1, 6))  # orders begin anew
            await until(lambda: value_of(client, 1) == 6)

    go(end())


def test_second_line_is_gone_before_the_client_connects_again() -> None:
    async def end() -> None:
        served = advising(refusal=None)
        async with pair(served) as (server, client):
            first, _ = await both(server, client)
            served.refusal = Bye(reason="too_many_clients", message="full")
            first.writer.transport.abort()
            await until(lambda: client.link.reason == "full")
            await until(lambda: not lines(server)[1])
            assert client.link.lines == 0

    go(end())


@pytest.mark.parametrize("reason", ["no_such_connection", "too_many_clients", "wrong_token"])
def test_line_that_is_refused_for_good_is_not_tried_again(reason: str) -> None:
    async def refuse() -> None:
        served = advising(second_refusal=Bye(reason=reason), status_s=0.005)
        async with pair(served) as (server, client):
            await until(lambda: hellos(served)[1])
            received = client.link.bytes
            await until(lambda: client.link.bytes > received + 2000)  # advised all the while
            assert [len(said) for said in hellos(served)] == [1, 1]
            assert (client.link.lines, client.link.faults) == (1, 0)
            served.second_refusal = None
            server.cut()
            await both(server, client)
            assert client.link.connects == 2

    go(refuse())


def test_line_that_is_refused_for_now_is_tried_again() -> None:
    async def refuse() -> None:
        served = advising(second_refusal=Bye(reason="locked_out"))
        async with pair(served) as (server, client):
            await until(lambda: len(hellos(served)[1]) > 2)
            served.second_refusal = None
            await both(server, client)
            assert client.link.faults == 0

    go(refuse())


@pytest.mark.parametrize("bad", [POSE, blocks(9, 2**29 * 2, 1)], ids=["order", "blocks"])
def test_fault_on_the_second_line_costs_it_and_trust(bad: Pose | Blocks) -> None:
    async def spoil() -> None:
        served = advising(status_s=0.005)
        async with pair(served) as (server, client):
            await client.complete(5)
            first, second = await both(server, client)
            second.say(bad)
            await until(lambda: client.link.faults == 1)
            first.say(blocks(1, 1, 5))
            await until(lambda: value_of(client, 1) == 5)
            received = client.link.bytes
            await until(lambda: client.link.bytes > received + 2000)
            assert [len(said) for said in hellos(served)] == [1, 1]
            assert (client.link.lines, client.link.connects) == (1, 1)
            first.tell()
            await until(lambda: client.mirror is not None and client.mirror.complete is not None)
            first.writer.transport.abort()
            await both(server, client)
            assert hellos(served)[0][1].resume is None
            assert client.link.faults == 1

    go(spoil())


def test_reset_leaves_the_second_line_alone() -> None:
    async def reset() -> None:
        served = advising()
        async with pair(served) as (server, client):
            first, second = await both(server, client)
            second.say(blocks(3, 1, 5))
            await until(lambda: value_of(client, 1) == 5)
            facts = msgspec.structs.replace(served.facts, id="another")
            first.say(Reset(map=facts, revision=4, order=4))
            await until(lambda: client.mirror is not None and len(client.mirror) == 0)
            second.say(blocks(4, 1, 6), blocks(5, 2, 7))
            await until(lambda: value_of(client, 2) == 7)
            assert value_of(client, 1) == -128
            assert lines(server) == ([first], [second])

    go(reset())


def test_nothing_of_a_line_is_left_when_it_is_closed() -> None:
    async def close() -> None:
        served = advising()
        knowledge = a_first(ticket="secret", session=served.session)[1]
        async with Server(served) as server:
            line = SecondLine(
                place_of(server.address),
                None,
                lambda: SecondDialogue("", knowledge, None),
                lambda _: None,
                lambda: None,
            )
            line.open()
            await until(lambda: line.is_welcome)
            await line.close()
            assert not line.is_welcome
            await line.close()

    go(close())


def test_client_that_hangs_up_while_the_second_line_comes_about_leaves_nothing() -> None:
    async def hang_up() -> None:
        async with Server(advising()) as server:
            for turns in range(0, 40, 3):
                async with MapClient(server.address) as client:
                    await until(lambda: client.link.state == "connected")
                    for _ in range(turns):
                        await asyncio.sleep(0)
            await until(lambda: not server.connections)

    go(hang_up())
