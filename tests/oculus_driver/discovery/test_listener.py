"""Discovery over loopback, with real sockets."""

from __future__ import annotations

import asyncio
import gc
import itertools
import logging
import socket
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import pytest

from oculus_driver import Discovery, DiscoveryError, encode_status
from oculus_driver.discovery.listener import ANY_HOST

if TYPE_CHECKING:
    from collections.abc import Coroutine, Iterator

pytestmark = pytest.mark.net

EVERYBODY_HERE = "127.255.255.255"
"""The broadcast address of the loopback network."""


@contextmanager
def speaking() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sonar:
        sonar.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        yield sonar


def run(work: Coroutine[Any, Any, None]) -> None:
    async def limited() -> None:
        async with asyncio.timeout(20):
            await work

    asyncio.run(limited())


def test_two_listeners_on_one_host_hear_the_same_sonar() -> None:
    async def work() -> None:
        async with Discovery(port=0) as first, Discovery(port=first.port) as second:
            with speaking() as sonar:
                sonar.sendto(encode_status(device_id=7), (EVERYBODY_HERE, first.port))
            for discovery in (first, second):
                seen = await anext(discovery.updates())
                assert (seen.status.device_id, seen.address, seen.count) == (7, "127.0.0.1", 1)
                assert seen.source_address == "127.0.0.1"
                assert discovery.present() == [seen]

    run(work())


@pytest.mark.parametrize("option", ["SO_REUSEADDR", "SO_REUSEPORT"])
def test_a_program_that_shares_the_port_in_either_way_is_no_hindrance(option: str) -> None:
    async def work(port: int) -> None:
        async with Discovery(port=port) as discovery:
            assert discovery.port == port

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as viewer:
        viewer.setsockopt(socket.SOL_SOCKET, getattr(socket, option), 1)
        viewer.bind((ANY_HOST, 0))
        run(work(viewer.getsockname()[1]))


def test_a_port_that_is_not_shared_is_named() -> None:
    async def work(port: int) -> None:
        with pytest.raises(DiscoveryError, match=rf"UDP port {port} .* stop that program"):
            await Discovery(port=port).__aenter__()

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as selfish:
        selfish.bind((ANY_HOST, 0))
        run(work(selfish.getsockname()[1]))


def test_an_address_of_another_host_is_named() -> None:
    async def work() -> None:
        with pytest.raises(DiscoveryError, match=r"192\.0\.2\.1 "):
            await Discovery(port=0, host="192.0.2.1").__aenter__()

    run(work())


def test_junk_is_counted_and_the_next_status_heard() -> None:
    # quirk 28: one datagram of another size must not end the listening
    async def work() -> None:
        async with Discovery(port=0, host="127.0.0.1") as discovery:
            with speaking() as sonar:
                for datagram in (b"", b"00", bytes(2000), encode_status(device_id=7)):
                    sonar.sendto(datagram, ("127.0.0.1", discovery.port))
            assert (await anext(discovery.updates())).status.device_id == 7
            assert discovery.state.rejects == {"short_message": 2, "bad_magic": 1}

    run(work())


def test_every_iterator_gets_every_sonar_and_ends_with_the_discovery() -> None:
    async def serials(discovery: Discovery) -> list[int]:
        return [seen.status.device_id async for seen in discovery.updates()]

    async def work() -> None:
        async with Discovery(port=0, host="127.0.0.1") as discovery, asyncio.TaskGroup() as group:
            readers = [group.create_task(serials(discovery)) for _ in range(2)]
            with speaking() as sonar:
                for serial in (1, 2, 3):
                    sonar.sendto(encode_status(device_id=serial), ("127.0.0.1", discovery.port))
            async for seen in discovery.updates():
                if seen.status.device_id == 3:
                    break
            await discovery.__aexit__(None, None, None)
        assert [await reader for reader in readers] == [[1, 2, 3]] * 2
        assert [seen async for seen in discovery.updates()] == discovery.present()

    run(work())


def test_a_slow_reader_gets_the_newest_status_of_each_sonar() -> None:
    async def work() -> None:
        seconds = itertools.count()
        clock_ns = lambda: next(seconds) * 500_000_000  # noqa: E731 - a manual clock
        async with Discovery(port=0, host="127.0.0.1", clock_ns=clock_ns) as discovery:
            slow = discovery.updates()
            for _ in range(5):
                for serial in (1, 2):
                    discovery._take(encode_status(device_id=serial), "127.0.0.1")
            assert [(await anext(slow)).count for _ in range(2)] == [5, 5]
            assert discovery.dropped == {"superseded": 8}

    run(work())


def test_what_needs_somebody_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    async def work() -> None:
        seconds = itertools.count()
        clock_ns = lambda: next(seconds) * 1_000_000_000  # noqa: E731 - a manual clock
        async with Discovery(port=0, host="127.0.0.1", clock_ns=clock_ns) as discovery:
            for bits in (3, 3 | 3 << 14, 3 | 3 << 14, 3, 3 | 3 << 14):
                status = encode_status(device_id=7, part_number=9999, status_bits=bits)
                discovery._take(status, "127.0.0.1")

    with caplog.at_level(logging.INFO, "oculus_driver.discovery.listener"):
        run(work())
    messages = [record.getMessage() for record in caplog.records]
    assert sum("serial number 7" in line for line in messages) == 1
    assert sum("unknown model" in line for line in messages) == 1  # quirk 24: warn once, go on
    assert sum("overheated" in line for line in messages) == 2  # quirk 17: each time that it begins
    assert len(messages) == 4


def test_the_client_of_a_sonar_is_not_logged_as_a_problem(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def work() -> None:
        async with Discovery(port=0, host="127.0.0.1") as discovery:
            status = encode_status(device_id=7, part_number=1032, client_address="127.0.0.1")
            discovery._take(status, "127.0.0.1")
            [sonar] = discovery.present()
            assert sonar.status.busy

    with caplog.at_level(logging.INFO, "oculus_driver.discovery.listener"):
        run(work())
    assert not [record for record in caplog.records if "in use" in record.getMessage()]


def test_leaving_while_a_reader_waits_leaks_nothing(recwarn: pytest.WarningsRecorder) -> None:
    async def work() -> None:
        async with Discovery(port=0, host="127.0.0.1") as discovery:
            waiting = asyncio.ensure_future(anext(discovery.updates()))
            await asyncio.sleep(0)
        with pytest.raises(StopAsyncIteration):
            await waiting
        assert asyncio.all_tasks() == {asyncio.current_task()}

    run(work())
    gc.collect()
    assert [str(warning.message) for warning in recwarn] == []


def test_the_port_is_free_when_the_discovery_is_left() -> None:
    async def work() -> None:
        async with Discovery(port=0) as discovery:
            pass
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as selfish:
            selfish.bind((ANY_HOST, discovery.port))

    run(work())


def test_a_cancelled_reader_loses_no_sighting() -> None:
    async def work() -> None:
        async with Discovery(port=0, host="127.0.0.1") as discovery:
            reader = discovery.updates()
            waiting = asyncio.ensure_future(anext(reader))
            await asyncio.sleep(0)
            discovery._take(encode_status(device_id=7), "127.0.0.1")
            waiting.cancel()
            with pytest.raises(asyncio.CancelledError):
                await waiting
            assert (await anext(reader)).status.device_id == 7

    run(work())
