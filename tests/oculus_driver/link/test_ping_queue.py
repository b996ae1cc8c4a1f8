"""Pings waiting for a reader."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import numpy as np
import pytest

from oculus_driver import Ping, PingQueue, decode_ping
from oculus_driver.ping import PingHeader, decode_header

if TYPE_CHECKING:
    from collections.abc import Callable

    from oculus_driver import Message
    from tests.oculus_driver.conftest import MakePing


@pytest.fixture
def pings(make_ping: MakePing, parse: Callable[[bytes], Message]) -> list[Ping]:
    decoded = [decode_ping(parse(make_ping(ping_id=ping_id))) for ping_id in range(10)]
    return [ping for ping in decoded if isinstance(ping, Ping)]


def ids(taken: list[Ping]) -> list[int]:
    return [ping.ping_id for ping in taken]


async def drain(queue: PingQueue) -> list[Ping]:
    return [ping async for ping in queue]


def test_pings_come_out_in_order_until_the_queue_is_closed(pings: list[Ping]) -> None:
    queue = PingQueue()
    for ping in pings:
        queue.put(ping)
    queue.close()
    assert ids(asyncio.run(drain(queue))) == list(range(10))
    assert (queue.taken, queue.dropped, len(queue)) == (10, 0, 0)


def test_a_full_queue_drops_the_oldest_and_counts_them(pings: list[Ping]) -> None:
    queue = PingQueue(3)
    for ping in pings:
        queue.put(ping)
    assert (len(queue), queue.dropped) == (3, 7)
    queue.close()
    assert ids(asyncio.run(drain(queue))) == [7, 8, 9]


def test_a_queue_is_full_by_bytes_too_but_keeps_the_newest(pings: list[Ping]) -> None:
    size = pings[0].image.nbytes
    assert size == 5 * 256 * np.dtype(np.uint8).itemsize
    queue = PingQueue(max_bytes=2 * size)
    for ping in pings:
        queue.put(ping)
    assert (len(queue), queue.dropped) == (2, 8)
    tiny = PingQueue(max_bytes=1)
    for ping in pings:
        tiny.put(ping)
    assert (len(tiny), tiny.dropped) == (1, 9)


def test_a_header_is_decoded_when_it_is_taken(
    make_ping: MakePing, parse: Callable[[bytes], Message]
) -> None:
    message = parse(make_ping(ping_id=3))
    header = decode_header(message)
    assert isinstance(header, PingHeader)
    queue = PingQueue(max_bytes=len(message.data))
    queue.put(header)
    queue.put(header)
    queue.close()
    (ping,) = asyncio.run(drain(queue))
    assert isinstance(ping, Ping)
    assert (ping.ping_id, queue.dropped) == (3, 1)


def test_the_room_of_taken_pings_is_free_again(pings: list[Ping]) -> None:
    async def main() -> None:
        queue = PingQueue(max_bytes=2 * pings[0].image.nbytes)
        for ping in pings:
            queue.put(ping)
            assert await anext(queue) is ping
        assert queue.dropped == 0

    asyncio.run(main())


def test_a_reader_that_waits_gets_the_next_ping(pings: list[Ping]) -> None:
    async def main() -> None:
        queue = PingQueue()
        reader = asyncio.create_task(queue.__anext__())
        await asyncio.sleep(0)
        queue.put(pings[0])
        assert await reader is pings[0]

    asyncio.run(main())


def test_readers_share_the_pings(pings: list[Ping]) -> None:
    async def main() -> None:
        queue = PingQueue()
        readers = [asyncio.create_task(drain(queue)) for _ in range(3)]
        for ping in pings:
            await asyncio.sleep(0)
            queue.put(ping)
        queue.close()
        taken = [ping for share in await asyncio.gather(*readers) for ping in share]
        assert sorted(ids(taken)) == list(range(10))

    asyncio.run(main())


def test_a_ping_for_a_cancelled_reader_goes_to_another(pings: list[Ping]) -> None:
    async def main() -> None:
        queue = PingQueue()
        first, second = (asyncio.create_task(queue.__anext__()) for _ in range(2))
        await asyncio.sleep(0)
        queue.put(pings[0])  # wakes the first
        first.cancel()
        assert await second is pings[0]
        with pytest.raises(asyncio.CancelledError):
            await first
        assert (queue.taken, queue.dropped) == (1, 0)

    asyncio.run(main())


def test_what_is_left_comes_before_the_error(pings: list[Ping]) -> None:
    async def main() -> None:
        queue = PingQueue()
        queue.put(pings[0])
        queue.close(ZeroDivisionError())
        queue.put(pings[1])  # too late
        assert await anext(queue) is pings[0]
        with pytest.raises(ZeroDivisionError):
            await anext(queue)
        assert queue.dropped == 1

    asyncio.run(main())


def test_closing_lets_all_readers_go() -> None:
    async def main() -> None:
        queue = PingQueue()
        readers = [asyncio.create_task(drain(queue)) for _ in range(3)]
        await asyncio.sleep(0)
        queue.close()
        assert await asyncio.gather(*readers) == [[], [], []]

    asyncio.run(main())


def test_a_queue_without_room_is_refused() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        PingQueue(0)
