"""A played sonar that misbehaves on request."""

from __future__ import annotations

import asyncio
import socket
from itertools import pairwise

import pytest

from oculus_driver import (
    Faults,
    Ping,
    PlaybackSonar,
    decode_ping,
    encode_fire,
)
from oculus_driver.wire import MessageId
from tests.oculus_driver.virtual_sonar.client import STANDBY, Client
from tests.support.waiting import run

pytestmark = pytest.mark.net


def test_a_cut_ends_the_connection_inside_a_ping(pings: list[bytes]) -> None:
    async def work() -> None:
        sent: list[tuple[int, bool]] = []

        def note(ping_id: int, whole: bool) -> None:  # noqa: FBT001 - the callback's form
            sent.append((ping_id, whole))

        faults = Faults(cut=0.5, seed=3)
        whole: list[int] = []
        async with PlaybackSonar(
            pings, loops=10, speed=None, faults=faults, on_ping=note, dummy_period_s=0.01
        ) as sonar:
            while not sonar.device.ended:
                async with await Client.of(sonar) as client:
                    for message in await client.to_the_end():
                        ping = decode_ping(message)
                        assert isinstance(ping, Ping)
                        whole.append(ping.ping_id)
        assert sonar.counters.cuts > 5
        assert len(sent) == 40
        assert whole == [ping_id for ping_id, undamaged in sent if undamaged]

    run(work())


def test_a_cut_takes_nothing_that_was_sent_before_it(pings: list[bytes]) -> None:
    async def work() -> None:
        loop, gone = asyncio.get_running_loop(), asyncio.Event()
        faults = Faults(cut=1.0, seed=2)
        async with PlaybackSonar(
            pings, speed=None, faults=faults, on_ping=lambda *_: gone.set()
        ) as sonar:
            with socket.create_connection((sonar.host, sonar.port)) as link:
                link.settimeout(0)
                await gone.wait()
                await asyncio.sleep(0.01)
                for _ in range(3):  # a reset would throw away what was not read yet
                    await loop.sock_sendall(link, STANDBY)
                    await asyncio.sleep(0.01)
                data = b""
                while piece := await loop.sock_recv(link, 1 << 16):
                    data += piece
            assert len(data) == sonar.counters.bytes_sent

    run(work())


def test_flipped_and_lost_pings_are_reported_and_the_others_arrive(pings: list[bytes]) -> None:
    async def work() -> None:
        sent: dict[int, bool] = {}
        faults = Faults(flip=0.3, lose=0.2, garbage=0.2, seed=1)
        async with (
            PlaybackSonar(
                pings,
                loops=25,
                speed=None,
                faults=faults,
                on_ping=sent.__setitem__,
                dummy_period_s=0,
            ) as sonar,
            await Client.of(sonar) as client,
        ):
            arrived = []
            while (message := (await client.messages(1))[0]).message_id != MessageId.DUMMY:
                arrived.append(message.data)
        assert sorted(sent) == [*range(40, 140)]
        assert sonar.counters.pings == sum(sent.values())
        assert 30 < sonar.counters.pings < 90
        body = {data[161:] for data in pings}  # behind id and time, which go on with each loop
        whole = [data for data in arrived if data[161:] in body]
        ids = {int.from_bytes(data[89:93], "little") for data in whole}
        assert ids >= {ping_id for ping_id, undamaged in sent.items() if undamaged}

    run(work())


def test_ids_start_again_on_request(pings: list[bytes]) -> None:
    async def work() -> None:
        faults = Faults(restart_ids=0.3, seed=5)
        async with (
            PlaybackSonar(pings, loops=5, speed=None, faults=faults) as sonar,
            await Client.of(sonar) as client,
        ):
            ids = await client.ids(20)
        assert ids.count(1) > 2
        assert all(after in (before + 1, 1) for before, after in pairwise(ids))

    run(work())


def test_a_restart_ends_the_connection_between_two_pings(pings: list[bytes]) -> None:
    async def work() -> None:
        faults = Faults(restart=0.3, seed=5)
        async with PlaybackSonar(pings, loops=None, speed=None, faults=faults) as sonar:
            for _ in range(5):
                async with await Client.of(sonar) as client:
                    await client.to_the_end()
                    assert client.parser.pending_bytes == 0
        assert sonar.counters.restarts == 5

    run(work())


def test_a_stall_delays_and_loses_nothing(pings: list[bytes]) -> None:
    async def work() -> None:
        faults = Faults(stall=0.5, stall_s=0.01)
        async with (
            PlaybackSonar(pings, loops=5, speed=None, faults=faults) as sonar,
            await Client.of(sonar) as client,
        ):
            assert await client.ids(20) == [*range(40, 60)]
            assert sonar.counters.stalls > 3

    run(work())


def test_a_client_that_does_not_fire_gets_no_more_pings_on_request(
    pings: list[bytes],
) -> None:  # quirk 1
    async def work() -> None:
        faults = Faults(silent_after_s=1000.0)
        async with (
            PlaybackSonar(pings, loops=None, speed=None, faults=faults) as sonar,
            await Client.of(sonar) as client,
        ):
            await client.ids(1)
            sonar._heard_s -= 2000.0
            await asyncio.sleep(0)
            before = sonar.counters.pings
            for _ in range(50):
                await asyncio.sleep(0)
            assert sonar.counters.pings <= before + 1
            client.writer.write(encode_fire())
            await client.ids(before + 5)

    run(work())


@pytest.mark.parametrize("deaf_to", [1, 2])
def test_a_sonar_may_understand_one_version_only(pings: list[bytes], deaf_to: int) -> None:
    async def work() -> None:  # quirk 14
        faults = Faults(ignored_fire_version=deaf_to)
        async with (
            PlaybackSonar(
                pings, standby=True, speed=None, dummy_period_s=0.01, faults=faults
            ) as sonar,
            await Client.of(sonar) as client,
        ):
            client.writer.write(encode_fire(version=deaf_to))
            await client.until(MessageId.DUMMY)
            client.writer.write(encode_fire(version=3 - deaf_to))
            assert await client.ids(1) == [40]
            assert (sonar.device.fires, sonar.device.fires_ignored) == (1, 1)

    run(work())
