"""A sonar that is found by its status."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import pytest

from oculus_driver import (
    FireSettings,
    LinkState,
    Mode,
    OculusSonar,
    SettingsError,
    Status,
    decode_status,
    encode_status,
)

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

    from oculus_driver import LinkTimeouts
    from tests.oculus_driver.sonar.conftest import MakeSonar, Run

pytestmark = pytest.mark.net

FREE = FireSettings(range_m=5.0)
OURS, OTHER = 7892, 1234
TOO_HOT = 0x03 | 3 << 14


@dataclass(frozen=True)
class Heard:
    address: str
    status: Status


class Ether:
    """Where statuses are heard: those that the test sends."""

    def __init__(self) -> None:
        self.waiting: asyncio.Queue[Heard | Exception] = asyncio.Queue()
        self.open = False

    def __call__(self) -> Self:
        return self

    async def __aenter__(self) -> Self:
        self.open = True
        return self

    async def __aexit__(self, *_: object) -> None:
        self.open = False

    async def updates(self) -> AsyncIterator[Heard]:
        while True:
            heard = await self.waiting.get()
            if isinstance(heard, Exception):
                raise heard
            yield heard
            self.waiting.task_done()

    def announce(self, address: str = "127.0.0.1", serial: int = OURS, **values: Any) -> None:
        status = decode_status(encode_status(device_id=serial, address=address, **values))
        assert isinstance(status, Status)
        self.waiting.put_nowait(Heard(address, status))


async def listen(sonar: OculusSonar) -> None:
    async with sonar:
        async for _ in sonar.pings():
            pass


def test_a_sonar_is_found_and_known_by_its_status(fake: MakeSonar, run: Run) -> None:
    async def main() -> None:
        ether = Ether()
        async with fake() as device:
            async with OculusSonar(settings=FREE, port=device.port, discovery=ether) as sonar:
                assert sonar.state is LinkState.SEARCHING
                assert "no status" in sonar.link.reason
                ether.announce()
                await sonar.wait_for(LinkState.PINGING)
                assert sonar.model is not None
                assert sonar.status is not None
                assert (sonar.model.name, sonar.status.device_id) == ("M750d", OURS)
                assert sonar.link.address == "127.0.0.1"
            assert not ether.open

    run(main())


def test_another_sonar_is_left_alone(fake: MakeSonar, run: Run) -> None:
    async def main() -> None:
        ether = Ether()
        async with (
            fake() as device,
            OculusSonar(settings=FREE, serial=OURS, port=device.port, discovery=ether) as sonar,
        ):
            ether.announce(serial=OTHER)
            await ether.waiting.join()
            assert sonar.state is LinkState.SEARCHING
            ether.announce()
            await sonar.wait_for(LinkState.PINGING)
            ether.announce("127.0.0.2", serial=OTHER)  # another one, not ours at a new address
            await sonar.wait_for(LinkState.PINGING)
            assert sonar.status is not None
            assert sonar.status.device_id == OURS

    run(main())


def test_a_sonar_that_is_held_is_waited_for(fake: MakeSonar, run: Run) -> None:
    # quirk 20
    async def main() -> None:
        ether = Ether()
        async with (
            fake() as device,
            OculusSonar(settings=FREE, port=device.port, discovery=ether) as sonar,
        ):
            ether.announce(client_address="192.168.2.10")
            ether.announce(status_bits=0x83)
            await ether.waiting.join()
            assert "in use by another client" in sonar.link.reason
            assert device.clients == 0
            ether.announce()
            await sonar.wait_for(LinkState.PINGING)

    run(main())


def test_a_sonar_with_another_address_is_followed(
    fake: MakeSonar, run: Run, quick: LinkTimeouts
) -> None:
    async def main() -> None:
        ether = Ether()
        async with (
            fake() as device,
            OculusSonar(settings=FREE, port=device.port, times=quick, discovery=ether) as sonar,
        ):
            ether.announce("127.0.0.2")  # nobody there
            await sonar.wait_for(LinkState.BACKING_OFF)
            ether.announce("127.0.0.1")
            await sonar.wait_for(LinkState.PINGING)
            assert sonar.link.address == "127.0.0.1"

    run(main())


def test_a_sonar_that_is_too_hot_is_kept_quiet_until_it_has_cooled(
    fake: MakeSonar, run: Run
) -> None:
    # quirk 17
    async def main() -> None:
        ether = Ether()
        async with (
            fake() as device,
            OculusSonar(settings=FREE, port=device.port, discovery=ether) as sonar,
        ):
            ether.announce()
            await sonar.wait_for(LinkState.PINGING)
            ether.announce(status_bits=TOO_HOT)
            await sonar.wait_for(LinkState.STANDBY)
            assert "too hot" in sonar.link.reason
            ether.announce()
            await sonar.wait_for(LinkState.PINGING)

    run(main())


def test_a_mode_that_the_sonar_has_not_ends_it_with_advice(run: Run) -> None:
    async def main() -> None:
        ether = Ether()
        settings = FireSettings(mode=Mode.HIGH_FREQUENCY)
        ether.announce(part_number=1041)
        with pytest.raises(SettingsError, match=r"M370s .*mode 2.*mode 1"):
            await listen(OculusSonar(settings=settings, discovery=ether))

    run(main())


def test_an_unknown_model_works_and_is_named_once(
    fake: MakeSonar, run: Run, caplog: pytest.LogCaptureFixture
) -> None:
    # quirk 24: no hard check of the model.
    async def main() -> None:
        ether = Ether()
        async with (
            fake() as device,
            OculusSonar(settings=FREE, port=device.port, discovery=ether) as sonar,
        ):
            for _ in range(3):
                ether.announce(part_number=9999)
            await sonar.wait_for(LinkState.PINGING)

    run(main())
    (warning,) = (r.getMessage() for r in caplog.records if r.levelname == "WARNING")
    assert "part 9999" in warning


def test_what_goes_wrong_with_the_search_is_reported(run: Run) -> None:
    async def main() -> None:
        ether = Ether()
        ether.waiting.put_nowait(OSError("port 52102 is in use"))
        with pytest.raises(OSError, match="port 52102 is in use"):
            await listen(OculusSonar(settings=FREE, discovery=ether))

    run(main())
