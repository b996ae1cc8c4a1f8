"""A recording served as a sonar, over loopback."""

from __future__ import annotations

import asyncio
import socket
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import pytest

from oculus_driver import (
    Faults,
    Identity,
    OculusError,
    Ping,
    PlayCounters,
    PlayedSonar,
    StreamParser,
    decode_ping,
    decode_status,
    encode_dummy,
    encode_fire,
    encode_status,
    encode_user_config,
)
from oculus_driver.played.broadcast import broadcast
from oculus_driver.played.faults import Dice
from oculus_driver.status import Status
from oculus_driver.wire import USER_CONFIG, MessageId

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine
    from pathlib import Path

    from oculus_driver import Message

LIMIT_S = 20.0
FIRE = encode_fire()
STANDBY = encode_fire(ping_rate=5)


def run(work: Coroutine[Any, Any, None]) -> None:
    async def limited() -> None:
        async with asyncio.timeout(LIMIT_S):
            await work

    asyncio.run(limited())


class Client:
    """A peer of the played sonar: a socket and a parser."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer
        self.parser = StreamParser()
        self.data = b""
        self.ready: list[Message] = []

    @classmethod
    async def of(cls, sonar: PlayedSonar) -> Client:
        return cls(*await asyncio.open_connection(sonar.host, sonar.port))

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.writer.close()

    async def messages(self, count: int) -> list[Message]:
        """The next messages; fewer if the connection ends."""
        while len(self.ready) < count and (data := await self.reader.read(1 << 16)):
            self.data += data
            self.ready += self.parser.feed(data)
        found, self.ready = self.ready[:count], self.ready[count:]
        return found

    async def to_the_end(self) -> list[Message]:
        return await self.messages(1 << 30)

    async def until(self, message_id: int) -> Message:
        while True:
            for message in await self.messages(1):
                if message.message_id == message_id:
                    return message

    async def ids(self, count: int) -> list[int]:
        pings: list[int] = []
        while len(pings) < count:
            for message in await self.messages(1):
                ping = decode_ping(message)
                if isinstance(ping, Ping):
                    pings.append(ping.ping_id)
        return pings


@pytest.fixture
def pings(make_ping: Callable[..., bytes]) -> list[bytes]:
    return [make_ping(ping_id=40 + index, start_time=5.0 + 0.1 * index) for index in range(4)]


def test_the_real_capture_comes_out_byte_for_byte(capture_path: Path, capture: bytes) -> None:
    async def work() -> None:
        async with PlayedSonar(capture_path, speed=None) as sonar, await Client.of(sonar) as client:
            assert len(await client.messages(3)) == 3
            assert client.data == capture
            await sonar.finished.wait()
            assert (sonar.counters.pings, sonar.counters.bytes_sent) == (3, len(capture))

    run(work())


def test_ids_and_device_time_go_on_where_the_recording_begins_again(pings: list[bytes]) -> None:
    async def work() -> None:
        async with (
            PlayedSonar(pings, speed=None, loops=3) as sonar,
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
            PlayedSonar(pings, speed=None, standby=True, dummy_period_s=0.01) as sonar,
            await Client.of(sonar) as client,
        ):
            silent = await client.messages(3)
            assert {message.message_id for message in silent} == {MessageId.DUMMY}
            client.writer.write(encode_fire(ping_rate=2))
            assert await client.ids(1) == [40]
            client.writer.write(STANDBY)
            await client.until(MessageId.DUMMY)
            assert sonar.device.demand is not None
            assert sonar.device.demand.standby

    run(work())


def test_settings_stay_when_the_client_leaves(pings: list[bytes]) -> None:  # quirk 16
    async def work() -> None:
        async with PlayedSonar(pings, standby=True, loops=None, speed=None) as sonar:
            async with await Client.of(sonar) as first:
                first.writer.write(encode_fire(ping_rate=2))
                assert await first.ids(1) == [40]
            async with await Client.of(sonar) as second:
                assert (await second.ids(1))[0] > 40

    run(work())


def test_dummies_come_however_often_the_client_fires(pings: list[bytes]) -> None:
    async def work() -> None:
        async with (
            PlayedSonar(pings, standby=True, dummy_period_s=0.1) as sonar,
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
            PlayedSonar(pings, standby=True, dummy_period_s=60.0) as sonar,
            await Client.of(sonar) as client,
        ):
            for ping_id in (40, 41, 42):
                client.writer.write(encode_fire(flags=0xCD))
                assert await client.ids(1) == [ping_id]
            assert sonar.counters.pings == 3

    run(work())


def test_a_second_client_waits_until_the_first_leaves(pings: list[bytes]) -> None:  # quirk 20
    async def work() -> None:
        async with PlayedSonar(pings, loops=None, speed=None) as sonar:
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
            PlayedSonar(pings, loops=None, speed=None, faults=faults) as sonar,
            await Client.of(sonar) as first,
        ):
            await first.ids(1)
            async with await Client.of(sonar) as second:
                assert await second.to_the_end() == []
            assert await first.ids(5)
            assert sonar.counters.refused == 1

    run(work())


def test_a_cut_ends_the_connection_inside_a_ping(pings: list[bytes]) -> None:
    async def work() -> None:
        sent: list[tuple[int, bool]] = []

        def note(ping_id: int, whole: bool) -> None:  # noqa: FBT001 - the callback's form
            sent.append((ping_id, whole))

        faults = Faults(cut=0.5, number=3)
        whole: list[int] = []
        async with PlayedSonar(
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
        faults = Faults(cut=1.0, number=2)
        async with PlayedSonar(
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


def test_flipped_and_lost_pings_are_told_and_the_others_arrive(pings: list[bytes]) -> None:
    async def work() -> None:
        sent: dict[int, bool] = {}
        faults = Faults(flip=0.3, lose=0.2, garbage=0.2, number=1)
        async with (
            PlayedSonar(
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
        faults = Faults(restart_ids=0.3, number=5)
        async with (
            PlayedSonar(pings, loops=5, speed=None, faults=faults) as sonar,
            await Client.of(sonar) as client,
        ):
            ids = await client.ids(20)
        assert ids.count(1) > 2
        assert all(after in (before + 1, 1) for before, after in pairwise(ids))

    run(work())


def test_a_restart_ends_the_connection_between_two_pings(pings: list[bytes]) -> None:
    async def work() -> None:
        faults = Faults(restart=0.3, number=5)
        async with PlayedSonar(pings, loops=None, speed=None, faults=faults) as sonar:
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
            PlayedSonar(pings, loops=5, speed=None, faults=faults) as sonar,
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
            PlayedSonar(pings, loops=None, speed=None, faults=faults) as sonar,
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
        faults = Faults(deaf_to_version=deaf_to)
        async with (
            PlayedSonar(
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


def test_the_configuration_can_be_asked_for(pings: list[bytes]) -> None:
    async def work() -> None:
        async with (
            PlayedSonar(pings, standby=True, dummy_period_s=60.0) as sonar,
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
            PlayedSonar(pings, speed=None, faults=faults) as sonar,
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
        faults = Faults(cut=0.3, restart=0.2, number=1)
        large = make_ping(rows=700)
        async with PlayedSonar([large], loops=None, speed=None, faults=faults) as sonar:
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
        async with PlayedSonar([capture[:182016]], loops=None, speed=None) as sonar:
            client = await Client.of(sonar)
            await asyncio.sleep(0.2)
            assert sonar.counters.bytes_sent
        assert len(asyncio.all_tasks()) == 1
        client.writer.transport.abort()

    run(work())


def test_an_address_that_is_taken_is_told(pings: list[bytes]) -> None:
    async def work() -> None:
        async with PlayedSonar(pings) as sonar:
            with pytest.raises(OculusError, match=f"listen on 127.0.0.1:{sonar.port}: .*in use"):
                async with PlayedSonar(pings, port=sonar.port):
                    pass

    run(work())


class Statuses(asyncio.DatagramProtocol):
    """Hears statuses on loopback."""

    def __init__(self) -> None:
        self.heard: asyncio.Queue[Status] = asyncio.Queue()

    def datagram_received(self, data: bytes, addr: object) -> None:  # noqa: ARG002 - asyncio's
        status = decode_status(data)
        assert isinstance(status, Status)
        self.heard.put_nowait(status)


async def listener() -> tuple[Statuses, asyncio.DatagramTransport, int]:
    transport, protocol = await asyncio.get_running_loop().create_datagram_endpoint(
        Statuses, local_addr=("127.0.0.1", 0), family=socket.AF_INET
    )
    return protocol, transport, transport.get_extra_info("sockname")[1]


def test_the_status_says_who_it_is_and_who_holds_it(pings: list[bytes]) -> None:  # quirk 20
    async def work() -> None:
        ears, transport, port = await listener()
        identity = Identity(device_id=70_007, part_number=1042)
        async with PlayedSonar(
            pings, identity=identity, status_to=[("127.0.0.1", port)], status_period_s=0.01
        ) as sonar:
            status = await ears.heard.get()
            assert (status.device_id, status.model.name, status.busy) == (70_007, "M1200d", False)
            assert (str(status.address), status.master_state) == ("127.0.0.1", "running")
            async with await Client.of(sonar):
                while not (status := await ears.heard.get()).busy:
                    pass
                assert str(status.client_address) == "127.0.0.1"
            while (await ears.heard.get()).busy:
                pass
        transport.close()

    run(work())


def test_an_overheated_sonar_says_so_and_stops(pings: list[bytes]) -> None:  # quirk 17
    async def work() -> None:
        ears, transport, port = await listener()
        async with (
            PlayedSonar(
                pings,
                loops=None,
                speed=None,
                dummy_period_s=0.01,
                status_to=[("127.0.0.1", port)],
                status_period_s=0.01,
            ) as sonar,
            await Client.of(sonar) as client,
        ):
            await client.ids(1)
            sonar.device.status_bits = 0x03 | 3 << 14
            await client.until(MessageId.DUMMY)
            while (await ears.heard.get()).temperature_state != "shut down":
                pass
        transport.close()

    run(work())


def test_statuses_come_late_and_twice_on_request() -> None:  # quirk 21
    async def work() -> None:
        ears, transport, port = await listener()
        statuses = (encode_status(device_id=number) for number in range(1, 1000))
        sending = asyncio.create_task(
            broadcast(
                lambda: next(statuses),
                "127.0.0.1",
                [("127.0.0.1", port)],
                0.001,
                dice=Dice(Faults(reorder_statuses=1.0)),
                counters=PlayCounters(),
            )
        )
        heard = [(await ears.heard.get()).device_id for _ in range(6)]
        assert heard == [2, 1, 2, 4, 3, 4]
        sending.cancel()
        await asyncio.gather(sending, return_exceptions=True)
        transport.close()

    run(work())
