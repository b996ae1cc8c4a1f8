"""What a played sonar broadcasts of itself."""

from __future__ import annotations

import asyncio
import socket

import pytest

from oculus_driver import (
    Faults,
    Identity,
    PlaybackSonar,
    VirtualSonarCounters,
    decode_status,
    encode_status,
)
from oculus_driver.status import Status
from oculus_driver.virtual_sonar.faults import FaultInjector
from oculus_driver.virtual_sonar.server import broadcast
from oculus_driver.wire import MessageId
from tests.oculus_driver.virtual_sonar.client import Client
from tests.support.waiting import run

pytestmark = pytest.mark.net


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


def test_the_status_reports_who_it_is_and_who_holds_it(pings: list[bytes]) -> None:  # quirk 20
    async def work() -> None:
        ears, transport, port = await listener()
        identity = Identity(device_id=70_007, part_number=1042)
        async with PlaybackSonar(
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


def test_an_overheated_sonar_reports_it_and_stops(pings: list[bytes]) -> None:  # quirk 17
    async def work() -> None:
        ears, transport, port = await listener()
        async with (
            PlaybackSonar(
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
                faults=FaultInjector(Faults(reorder_statuses=1.0)),
                counters=VirtualSonarCounters(),
            )
        )
        heard = [(await ears.heard.get()).device_id for _ in range(6)]
        assert heard == [2, 1, 2, 4, 3, 4]
        sending.cancel()
        await asyncio.gather(sending, return_exceptions=True)
        transport.close()

    run(work())
