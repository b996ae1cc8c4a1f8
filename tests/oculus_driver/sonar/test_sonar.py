"""A sonar on the network, from outside."""

from __future__ import annotations

import asyncio
import re
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from oculus_driver import FireSettings, LinkError, LinkState, OculusSonar, SettingsError, model_of
from oculus_driver.ping import PingHeader
from oculus_driver.stream import Framing, MessageBounds, StreamParser

if TYPE_CHECKING:
    from oculus_driver import LinkStatus, LinkTimeouts, Ping
    from tests.oculus_driver.sonar.conftest import MakeSonar, Run

pytestmark = pytest.mark.net

HOST = "127.0.0.1"
FREE = FireSettings(range_m=5.0)


async def take(sonar: OculusSonar, count: int) -> list[Ping]:
    pings: list[Ping] = []
    async for ping in sonar.pings():
        pings.append(ping)
        if len(pings) == count:
            break
    return pings


def test_pings_come_in_order_and_standby_is_left_behind(fake: MakeSonar, run: Run) -> None:
    async def main() -> None:
        async with fake() as device:
            async with OculusSonar(HOST, FREE, port=device.port) as sonar:
                pings = await take(sonar, 5)
                assert sonar.state is LinkState.PINGING
            assert [ping.ping_id for ping in pings] == [1, 2, 3, 4, 5]
            assert all(ping.range_setting_m == 5.0 for ping in pings)
            assert all(ping.arrival_ns is not None for ping in pings)
            assert device.fires[0]["ping_rate"] == 0
            assert device.fires[-1]["ping_rate"] == 5  # standby on exit
            assert sonar.link.reason == "closed by the caller"

    run(main())


def test_a_sonar_without_settings_is_kept_in_standby(fake: MakeSonar, run: Run) -> None:
    # quirk 16: a sonar keeps its settings over power cycles and heats up in air.
    async def main() -> None:
        async with fake() as device, OculusSonar(HOST, port=device.port) as sonar:
            await sonar.wait_for(LinkState.STANDBY)
            confirmation = await sonar.standby()
            assert confirmation.confirmed
            assert {fire["ping_rate"] for fire in device.fires} == {5}
            assert device.pings_sent == 0

    run(main())


def test_the_sonar_can_be_left_pinging(fake: MakeSonar, run: Run) -> None:
    async def main() -> None:
        async with fake() as device:
            async with OculusSonar(HOST, FREE, port=device.port, keep_pinging=True) as sonar:
                await take(sonar, 1)
            assert {fire["ping_rate"] for fire in device.fires} == {0}

    run(main())


def test_standby_is_left_behind_after_a_cancellation_too(fake: MakeSonar, run: Run) -> None:
    async def use(port: int, started: asyncio.Event) -> None:
        async with OculusSonar(HOST, FREE, port=port) as sonar:
            async for _ in sonar.pings():
                started.set()

    async def main() -> None:
        async with fake() as device:
            started = asyncio.Event()
            task = asyncio.create_task(use(device.port, started))
            await started.wait()
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            assert device.fires[-1]["ping_rate"] == 5

    run(main())


def test_settings_are_confirmed_by_what_the_pings_show(fake: MakeSonar, run: Run) -> None:
    async def main() -> None:
        async with fake() as device, OculusSonar(HOST, FREE, port=device.port) as sonar:
            await take(sonar, 1)
            confirmation = await sonar.apply(replace(FREE, range_m=8.0, gamma=127))
            assert (confirmation.confirmed, confirmation.changed) == (True, ())
            assert confirmation.pings >= 1
            assert (device.fires[-1]["range_demand"], device.fires[-1]["gamma"]) == (8.0, 127)

    run(main())


def test_what_the_sonar_does_otherwise_is_reported(fake: MakeSonar, run: Run) -> None:
    async def main() -> None:
        echo = {"range_m": 4.0, "gain_percent": 77.0}
        async with fake(echo=echo) as device, OculusSonar(HOST, FREE, port=device.port) as sonar:
            confirmation = await sonar.apply(FREE, timeout_s=0.3)
            assert not confirmation.confirmed
            assert "range, m" in confirmation.reason
            assert [one.name for one in sonar.changed] == ["range, m", "gain, percent"]
            assert sonar.state is LinkState.PINGING  # the link is kept

    run(main())


def test_one_who_waits_for_a_confirmation_blocks_no_ping(fake: MakeSonar, run: Run) -> None:
    # quirk 37: asking and waiting where the bytes are read is a dead-lock.
    seen: list[int] = []

    async def main() -> None:
        async with fake() as device, OculusSonar(HOST, FREE, port=device.port) as sonar:
            async for ping in sonar.pings():
                confirmation = await sonar.apply(replace(FREE, range_m=6.0))
                assert confirmation.confirmed
                seen.append(ping.ping_id)
                break

    run(main())
    assert len(seen) == 1


def test_triggered_pings_come_one_by_one(fake: MakeSonar, run: Run, quick: LinkTimeouts) -> None:
    # quirk 9: one fire message per ping in triggered mode.
    async def main() -> None:
        settings = replace(FREE, network_trigger=True)
        async with (
            fake() as device,
            OculusSonar(HOST, settings, port=device.port, times=quick) as sonar,
        ):
            await sonar.wait_for(LinkState.STANDBY)
            assert (await sonar.apply(settings)).confirmed
            await asyncio.sleep(0.01)
            for expected in (1, 2, 3):
                assert (await sonar.fire()).ping_id == expected
                await asyncio.sleep(0.1)  # keep-alives go by
            assert device.pings_sent == 3
            assert device.dummies_heard > 3
            device.mute = True
            with pytest.raises(LinkError, match="no ping within"):
                await sonar.fire(timeout_s=0.05)

    run(main())


def test_a_shot_right_after_settings_waits_until_they_have_gone_out(
    fake: MakeSonar, run: Run, quick: LinkTimeouts
) -> None:
    async def main() -> None:
        settings = replace(FREE, network_trigger=True)
        slow = replace(quick, send_gap_ns=200_000_000)
        async with fake() as device, OculusSonar(HOST, FREE, port=device.port, times=slow) as sonar:
            await sonar.wait_for(LinkState.PINGING)
            await sonar.apply(replace(settings, range_m=3.0), timeout_s=0.0)
            await sonar.apply(settings, timeout_s=0.0)
            assert (await sonar.fire()).ping_id >= 1

    run(main())


def test_firing_needs_triggered_mode_and_a_connection(fake: MakeSonar, run: Run) -> None:
    async def main() -> None:
        async with fake() as device:
            async with OculusSonar(HOST, FREE, port=device.port) as sonar:
                with pytest.raises(SettingsError, match="network_trigger=True"):
                    await sonar.fire()
            triggered = replace(FREE, network_trigger=True)
            async with OculusSonar(HOST, triggered, port=device.port) as sonar:
                with pytest.raises(LinkError, match="cannot fire now"):
                    await sonar.fire()

    run(main())


def test_a_hold_keeps_the_sonar_quiet_until_released(fake: MakeSonar, run: Run) -> None:
    async def main() -> None:
        async with fake() as device, OculusSonar(HOST, FREE, port=device.port) as sonar:
            await take(sonar, 1)
            sonar.hold("out of the water")
            assert (sonar.state, sonar.link.reason) == (LinkState.STANDBY, "out of the water")
            await asyncio.sleep(0.1)
            assert device.fires[-1]["ping_rate"] == 5
            sonar.release()
            assert await sonar.wait_for(LinkState.PINGING) is LinkState.PINGING

    run(main())


def test_a_sonar_over_the_callers_limit_is_kept_quiet(fake: MakeSonar, run: Run) -> None:
    # quirk 16
    async def main() -> None:
        async with (
            fake(echo={"temperature_c": 36.0}) as device,
            OculusSonar(HOST, FREE, port=device.port, max_temperature_c=35.0) as sonar,
        ):
            await take(sonar, 1)
            await sonar.wait_for(LinkState.STANDBY)
            assert re.match(r"36\.0 °C, .*\b35\b", sonar.link.reason)
            sonar.release()
            await sonar.wait_for(LinkState.PINGING, LinkState.STANDBY)
            await take(sonar, 1)
            await sonar.wait_for(LinkState.STANDBY)

    run(main())


def test_the_range_is_cut_to_the_model(fake: MakeSonar, run: Run) -> None:
    async def main() -> None:
        far = replace(FREE, range_m=100.0)
        async with (
            fake() as device,
            OculusSonar(HOST, far, port=device.port, model=model_of(1042)) as sonar,
        ):
            await take(sonar, 1)
            assert {fire["range_demand"] for fire in device.fires} == {40.0}
            confirmation = await sonar.apply(far)
            assert confirmation.confirmed
            assert ("range, m", 100.0, 40.0) in [
                (one.name, one.asked, one.shown) for one in confirmation.changed
            ]

    run(main())


def test_the_model_is_learned_from_the_pings(fake: MakeSonar, run: Run) -> None:
    async def main() -> None:
        far = replace(FREE, range_m=100.0)
        async with (
            fake(echo={"part_number": 1042}) as device,
            OculusSonar(HOST, far, port=device.port) as sonar,
        ):
            while (await take(sonar, 1))[0].range_setting_m != 40.0:
                pass
            assert sonar.model == model_of(1042)

    run(main())


def test_every_byte_goes_past_the_tap_before_it_is_parsed(fake: MakeSonar, run: Run) -> None:
    async def main() -> None:
        taped: list[tuple[int, int]] = []
        async with (
            fake() as device,
            OculusSonar(
                HOST,
                FREE,
                port=device.port,
                on_bytes=lambda data, at: taped.append((len(data), at)),
            ) as sonar,
        ):
            pings = await take(sonar, 3)
        assert sum(size for size, _ in taped) == sonar.counters.bytes_received
        assert {ping.arrival_ns for ping in pings} <= {at for _, at in taped}

    run(main())


def test_chunks_come_with_their_message_boundaries(fake: MakeSonar, run: Run) -> None:
    async def main() -> None:
        taped: list[tuple[bytes, int, MessageBounds]] = []
        async with (
            fake() as device,
            OculusSonar(
                HOST, FREE, port=device.port, on_chunk=lambda *chunk: taped.append(chunk)
            ) as sonar,
        ):
            pings = await take(sonar, 3)
        assert sum(len(data) for data, _, _ in taped) == sonar.counters.bytes_received
        assert {ping.arrival_ns for ping in pings} <= {at for _, at, _ in taped}
        parser = StreamParser()
        for data, _, bounds in taped:
            assert parser.bounds(parser.feed(data), len(data)) == bounds

    run(main())


def test_chunks_come_with_the_messages_that_they_complete(fake: MakeSonar, run: Run) -> None:
    async def main() -> None:
        taped: list[tuple[bytes, int, Framing]] = []
        async with (
            fake() as device,
            OculusSonar(
                HOST, FREE, port=device.port, on_framing=lambda *chunk: taped.append(chunk)
            ) as sonar,
        ):
            await take(sonar, 3)
        parser = StreamParser()
        for data, at_ns, framing in taped:
            assert parser.framing(parser.feed(data, at_ns), len(data)) == framing
        assert sum(len(framing.messages) for *_, framing in taped) >= 3

    run(main())


def test_pings_are_decoded_for_readers_only(
    fake: MakeSonar, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    decoded: list[int] = []
    decode = PingHeader.decode

    def counted(header: PingHeader) -> Ping:
        decoded.append(header.ping_id)
        return decode(header)

    monkeypatch.setattr(PingHeader, "decode", counted)

    async def main() -> None:
        async with (
            fake() as device,
            OculusSonar(HOST, FREE, port=device.port, max_pings=1) as sonar,
        ):
            while sonar.counters.pings < 5:  # noqa: ASYNC110 - no reader
                await asyncio.sleep(0.001)
            assert sonar.state is LinkState.PINGING
            assert sonar.changed == ()
            assert decoded == []
            (ping,) = await take(sonar, 1)
            assert decoded == [ping.ping_id]

    run(main())


def test_what_a_callers_function_raises_ends_the_sonar_and_is_reported(
    fake: MakeSonar, run: Run
) -> None:
    def broken(_data: bytes, _at: int) -> None:
        raise ZeroDivisionError

    async def main() -> None:
        async with fake() as device:
            with pytest.raises(ZeroDivisionError):
                async with OculusSonar(HOST, FREE, port=device.port, on_bytes=broken) as sonar:
                    await take(sonar, 1)
            with pytest.raises(ZeroDivisionError):
                async with OculusSonar(HOST, FREE, port=device.port, on_bytes=broken) as sonar:
                    await sonar.wait_for(LinkState.CLOSED)

    run(main())


def test_an_error_that_nobody_waited_for_is_raised_at_the_end(fake: MakeSonar, run: Run) -> None:
    def broken(_data: bytes, _at: int) -> None:
        raise ZeroDivisionError

    async def use(port: int) -> None:
        async with OculusSonar(HOST, FREE, port=port, on_bytes=broken) as sonar:
            while sonar.state is not LinkState.CLOSED:  # noqa: ASYNC110 - it must not wait
                await asyncio.sleep(0)

    async def main() -> None:
        async with fake() as device:
            with pytest.raises(ZeroDivisionError):
                await use(device.port)

    run(main())


def test_each_state_is_reported_with_its_reason(fake: MakeSonar, run: Run) -> None:
    async def main() -> None:
        statuses: list[LinkStatus] = []
        async with (
            fake() as device,
            OculusSonar(HOST, FREE, port=device.port, on_state=statuses.append) as sonar,
        ):
            await take(sonar, 1)
        states = [status.state for status in statuses]
        assert states == ["connecting", "configuring", "pinging", "standby", "closed"]
        assert all(status.reason for status in statuses)

    run(main())


def test_a_sonar_is_opened_once(fake: MakeSonar, run: Run) -> None:
    async def main() -> None:
        async with fake() as device:
            sonar = OculusSonar(HOST, port=device.port)
            async with sonar:
                pass
            with pytest.raises(LinkError, match="only once"):
                async with sonar:
                    pass

    run(main())


def test_readers_are_let_go_when_the_sonar_is_closed(fake: MakeSonar, run: Run) -> None:
    async def main() -> None:
        async with fake() as device, asyncio.TaskGroup() as group:
            async with OculusSonar(HOST, port=device.port) as sonar:
                reader = group.create_task(take(sonar, 1))
                waiter = asyncio.create_task(sonar.apply(FREE))
                device.mute = True
                await asyncio.sleep(0.05)
            assert await reader == []
            with pytest.raises(LinkError, match="was closed"):
                await waiter

    run(main())
