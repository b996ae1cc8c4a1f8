"""A recording served as a sonar, over loopback."""

from __future__ import annotations

import asyncio
import socket
from typing import TYPE_CHECKING

import numpy as np
import pytest

from oculus_driver import (
    Faults,
    OculusError,
    Ping,
    PlaybackSonar,
    decode_ping,
    encode_dummy,
    encode_fire,
    encode_user_config,
)
from oculus_driver.wire import USER_CONFIG, MessageId
from tests.oculus_driver.virtual_sonar.client import FIRE, STANDBY, Client
from tests.support.waiting import run

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from oculus_driver import Message

pytestmark = pytest.mark.net


def test_the_real_capture_comes_out_byte_for_byte(capture_path: Path, capture: bytes) -> None:
    async def work() -> None:
        async with (
            PlaybackSonar(capture_path, speed=None) as sonar,
            await Client.of(sonar) as client,
        ):
            assert len(await client.messages(3)) == 3
            assert client.data == capture
            await sonar.finished.wait()
            assert (sonar.counters.pings, sonar.counters.bytes_sent) == (3, len(capture))

    run(work())


def test_ids_and_device_time_go_on_where_the_recording_begins_again(pings: list[bytes]) -> None:
    async def work() -> None:
        async with (
            PlaybackSonar(pings, speed=None, loops=3) as sonar,
            await Client.of(sonar) as client,
        ):
            decoded = [decode_ping(message) for message in await client.messages(12)]
            assert [ping.ping_id for ping in decoded if isinstance(ping, Ping)] == [*range(40, 52)]
            times = [ping.start_time_s for ping in decoded if isinstance(ping, Ping)]
            assert times == pytest.approx([5.0 + 0.1 * index for index in range(12)])

    run(work())


def test_standby_stops_the_pings_and_sends_dummies_until_pings_are_asked_for(
    pings: list[bytes],
) -> None:
    async def work() -> None:
        async with (
            PlaybackSonar(pings, speed=None, standby=True, dummy_period_s=0.01) as sonar,
            await Client.of(sonar) as client,
        ):
            silent = await client.messages(3)
            assert {message.message_id for message in silent} == {MessageId.DUMMY}
            client.writer.write(encode_fire(ping_rate=2))
            assert await client.ids(1) == [40]
            client.writer.write(STANDBY)
            await client.until(MessageId.DUMMY)
            assert sonar.device.request is not None
            assert sonar.device.request.standby

    run(work())


def test_settings_stay_when_the_client_leaves(pings: list[bytes]) -> None:  # quirk 16
    async def work() -> None:
        async with PlaybackSonar(pings, standby=True, loops=None, speed=None) as sonar:
            async with await Client.of(sonar) as first:
                first.writer.write(encode_fire(ping_rate=2))
                assert await first.ids(1) == [40]
            async with await Client.of(sonar) as second:
                assert (await second.ids(1))[0] > 40

    run(work())


def test_dummies_come_however_often_the_client_fires(pings: list[bytes]) -> None:
    async def work() -> None:
        async with (
            PlaybackSonar(pings, standby=True, dummy_period_s=0.1) as sonar,
            await Client.of(sonar) as client,
        ):
            waiting = asyncio.create_task(client.until(MessageId.DUMMY))
            while not waiting.done():  # keeps alive far more often than dummies are due
                client.writer.write(STANDBY)
                await asyncio.sleep(0.01)
            assert sonar.device.fires > 1

    run(work())


def test_a_triggered_sonar_sends_one_ping_for_each_fire_message(pings: list[bytes]) -> None:
    async def work() -> None:
        async with (
            PlaybackSonar(pings, standby=True, dummy_period_s=60.0) as sonar,
            await Client.of(sonar) as client,
        ):
            for ping_id in (40, 41, 42):
                client.writer.write(encode_fire(flags=0xCD))
                assert await client.ids(1) == [ping_id]
            assert sonar.counters.pings == 3

    run(work())


def test_a_second_client_waits_until_the_first_leaves(pings: list[bytes]) -> None:  # quirk 20
    async def work() -> None:
        async with PlaybackSonar(pings, loops=None, speed=None) as sonar:
            async with await Client.of(sonar) as first:
                await first.ids(1)
                second = await Client.of(sonar)
                waiting = asyncio.create_task(second.reader.read(1))
                await first.ids(20)
                assert not waiting.done()
            assert await waiting == b"S"
            second.writer.close()

    run(work())


def test_a_second_client_is_refused_on_request(pings: list[bytes]) -> None:  # quirk 20
    async def work() -> None:
        faults = Faults(refuse_second=True)
        async with (
            PlaybackSonar(pings, loops=None, speed=None, faults=faults) as sonar,
            await Client.of(sonar) as first,
        ):
            await first.ids(1)
            async with await Client.of(sonar) as second:
                assert await second.to_the_end() == []
            assert await first.ids(5)
            assert sonar.counters.refused == 1

    run(work())


def test_the_configuration_can_be_asked_for(pings: list[bytes]) -> None:
    async def work() -> None:
        async with (
            PlaybackSonar(pings, standby=True, dummy_period_s=60.0) as sonar,
            await Client.of(sonar) as client,
        ):
            client.writer.write(encode_dummy() + encode_user_config())
            answer = USER_CONFIG.unpack((await client.until(MessageId.USER_CONFIG)).data)
            assert answer["address"] == 0x7F000001  # quirk 34: the other order than in statuses

    run(work())


def test_messages_handed_over_in_pieces_are_the_same_messages(pings: list[bytes]) -> None:
    async def work() -> None:
        faults = Faults(piece_bytes=7)
        async with (
            PlaybackSonar(pings, speed=None, faults=faults) as sonar,
            await Client.of(sonar) as client,
        ):
            await client.messages(4)
            assert client.data == b"".join(pings)

    run(work())


RESET_ON_CLOSE = b"\1\0\0\0\0\0\0\0"


def test_clients_may_come_and_go_at_any_moment(make_ping: Callable[..., bytes]) -> None:
    async def work() -> None:
        loop = asyncio.get_running_loop()
        rng = np.random.default_rng(1)
        faults = Faults(cut=0.3, restart=0.2, seed=1)
        large = make_ping(rows=700)
        async with PlaybackSonar([large], loops=None, speed=None, faults=faults) as sonar:
            for _ in range(400):
                with socket.socket() as link:
                    link.settimeout(0)
                    await loop.sock_connect(link, (sonar.host, sonar.port))
                    if rng.random() < 0.5:
                        await loop.sock_sendall(link, STANDBY if rng.random() < 0.5 else FIRE)
                    if rng.random() < 0.3:
                        link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET_ON_CLOSE)
                    await asyncio.sleep(0.002 * float(rng.integers(0, 2)))
            whole: list[Message] = []
            while not whole:  # of clients that may meet a fault too
                async with await Client.of(sonar) as client:
                    client.writer.write(FIRE)
                    whole = await client.messages(1)

    run(work())


def test_leaving_does_not_wait_for_a_client_that_does_not_read(capture: bytes) -> None:
    async def work() -> None:
        async with PlaybackSonar([capture[:182016]], loops=None, speed=None) as sonar:
            client = await Client.of(sonar)
            await asyncio.sleep(0.2)
            assert sonar.counters.bytes_sent
        assert len(asyncio.all_tasks()) == 1
        client.writer.transport.abort()

    run(work())


def test_an_address_that_is_taken_is_reported(pings: list[bytes]) -> None:
    async def work() -> None:
        async with PlaybackSonar(pings) as sonar:
            with pytest.raises(OculusError, match=f"listen on 127.0.0.1:{sonar.port}: .*in use"):
                async with PlaybackSonar(pings, port=sonar.port):
                    pass

    run(work())
