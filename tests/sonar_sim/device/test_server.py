"""A simulated sonar on loopback, used through the driver as a real one is."""

import asyncio
import itertools
import socket
from collections.abc import Callable, Coroutine
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from sonar_sim.device.server import ServedScenario, ServeSettings
from sonar_sim.errors import SonarSimError
from sonar_sim.navigation.odometry_output import by_arrival, output_named
from sonar_sim.scene.scenario import Scenario
from sonar_sim.scene.vehicle import OdometrySample

from mapperd.odometry.native import decode_native
from mapperd.odometry.records import Odometry
from oculus_driver import (
    Discovery,
    Faults,
    FireSettings,
    LinkState,
    LinkTimeouts,
    Mode,
    OculusSonar,
    Ping,
    PingRate,
    Status,
    decode_status,
    encode_fire,
)
from tests.oculus_driver.virtual_sonar.client import Client

pytestmark = pytest.mark.net

MakeScenario = Callable[..., Scenario]
LIMIT_S = 30.0
QUICK = FireSettings(range_m=3.0, beams=256, ping_rate=PingRate.HIGHEST)


def run(work: Coroutine[Any, Any, None]) -> None:
    async def limited() -> None:
        async with asyncio.timeout(LIMIT_S):
            await work
        assert asyncio.all_tasks() == {asyncio.current_task()}

    asyncio.run(limited())


async def next_ping(sonar: OculusSonar) -> Ping:
    return await anext(aiter(sonar.pings()))


async def fresh_ping(served: ServedScenario, sonar: OculusSonar) -> Ping:
    """A ping that was sent from now on: older ones wait for the reader."""
    sent = served.sonar.counters.pings
    while (ping := await next_ping(sonar)).ping_id <= sent:
        pass
    return ping


def floor_m(ping: Ping) -> float:
    """Range of the loudest row of the middle beams, beyond the transmitter's ring-down."""
    middle = ping.image[:, ping.beams // 2 - 8 : ping.beams // 2 + 8].astype(float)
    heard = np.where(ping.ranges_m > 0.3, middle.sum(axis=1), 0.0)
    return float(ping.ranges_m[np.argmax(heard)])


def test_the_driver_gets_what_it_asks_for(floor_scenario: MakeScenario) -> None:
    async def work() -> None:
        async with (
            ServedScenario(floor_scenario(), ServeSettings(standby=True)) as served,
            OculusSonar("127.0.0.1", port=served.sonar.port) as sonar,
        ):
            assert await sonar.wait_for(LinkState.STANDBY) == LinkState.STANDBY
            for settings in (
                QUICK,
                replace(QUICK, range_m=2.5, beams=512, gamma=127, gain_percent=40.0),
                replace(QUICK, bits_per_sample=16, gain_words=False),
                replace(QUICK, bits_per_sample=32),
                replace(QUICK, mode=Mode.HIGH_FREQUENCY, range_m=None, range_percent=7.5),
            ):
                assert (await sonar.apply(settings)).confirmed
                ping = await fresh_ping(served, sonar)
                assert not ping.warnings
                assert (ping.beams, ping.mode) == (settings.beams, settings.mode)
                assert ping.bits_per_sample == settings.bits_per_sample
                assert (ping.gains is not None) == settings.gain_words
                assert ping.max_range_m == pytest.approx(settings.range_m or 3.0, rel=0.01)
                assert ping.gain_percent == settings.gain_percent
                assert (ping.part_number, sonar.model and sonar.model.name) == (1032, "M750d")
                assert floor_m(ping) == pytest.approx(2.0, abs=0.06)
            assert (await sonar.standby()).confirmed

    run(work())


def test_the_first_ping_waits_for_its_echoes_not_for_the_scene(
    floor_scenario: MakeScenario,
) -> None:
    async def work() -> None:
        async with (
            ServedScenario(floor_scenario()) as served,
            await Client.of_address("127.0.0.1", served.sonar.port) as client,
        ):
            # Open, it has a simulator ready, and no ping of it counts.
            assert len(served.sonar.device._maker._simulators) == 1
            assert await client.ids(1) == [1]

    run(work())


def test_version_1_is_answered_in_version_1(floor_scenario: MakeScenario) -> None:
    async def work() -> None:
        async with (
            ServedScenario(floor_scenario(), ServeSettings(standby=True)) as served,
            OculusSonar("127.0.0.1", QUICK, port=served.sonar.port, version=1) as sonar,
        ):
            first, second = await next_ping(sonar), await next_ping(sonar)
            assert (first.version, first.start_time_s) == (1, None)
            assert first.start_ticks is not None
            assert second.start_ticks is not None
            period_s = (second.start_ticks - first.start_ticks) * 8e-9
            assert period_s >= 0.0249 * (second.ping_id - first.ping_id)

    run(work())


def test_pings_state_when_they_were_and_come_no_faster_than_sound(
    floor_scenario: MakeScenario,
) -> None:
    async def work() -> None:
        async with (
            ServedScenario(floor_scenario()) as served,
            OculusSonar(
                "127.0.0.1", replace(QUICK, range_m=100.0), port=served.sonar.port
            ) as sonar,
        ):
            assert (await sonar.apply(sonar.settings)).confirmed
            await fresh_ping(served, sonar)
            pings = [await next_ping(sonar) for _ in range(4)]
            for before, after in itertools.pairwise(pings):
                assert after.start_time_s is not None
                assert before.start_time_s is not None
                assert before.arrival_ns is not None
                assert after.ping_id == before.ping_id + 1
                assert after.start_time_s - before.start_time_s >= 2 * 99.0 / 1500.0
            # The last echo is back before the message comes.
            device = served.sonar.device
            assert pings[-1].start_time_s is not None
            assert device.seconds_since_boot - pings[-1].start_time_s >= 2 * 99.0 / 1500.0

    run(work())


def test_a_trigger_gets_one_ping(floor_scenario: MakeScenario) -> None:
    async def work() -> None:
        async with (
            ServedScenario(floor_scenario(), ServeSettings(standby=True)) as served,
            await Client.of_address("127.0.0.1", served.sonar.port) as client,
        ):
            for ping_id in (1, 2, 3):
                client.writer.write(encode_fire(flags=0x89, range_demand=3.0))
                assert await client.ids(1) == [ping_id]
            await asyncio.sleep(0.2)
            assert served.sonar.device.simulated == served.sonar.counters.pings == 3

    run(work())


@pytest.mark.parametrize(
    ("model", "part"), [("M370s", 1041), ("M750d", 1032), ("M1200d", 1042), ("M3000d", 2203)]
)
def test_every_model_reports_its_model(floor_scenario: MakeScenario, model: str, part: int) -> None:
    async def work() -> None:
        loop = asyncio.get_running_loop()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as heard:
            heard.bind(("127.0.0.1", 0))
            heard.setblocking(False)  # noqa: FBT003 the socket's own argument
            settings = ServeSettings(status_to=[heard.getsockname()], device_id=70_000)
            async with ServedScenario(floor_scenario(model), settings):
                status = decode_status(await loop.sock_recv(heard, 1000))
        assert isinstance(status, Status)
        assert (status.model.part_number, status.device_id) == (part, 70_000)
        assert status.pressure_bar is not None

    run(work())


def test_the_driver_finds_it_by_its_status(floor_scenario: MakeScenario) -> None:
    async def work() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        settings = ServeSettings(status_to=[("127.0.0.1", port)], device_id=4711)
        async with ServedScenario(floor_scenario(), settings), Discovery(port=port) as found:
            sighting = await anext(aiter(found.updates()))
            assert sighting.status.device_id == 4711

    run(work())


def test_the_driver_falls_back_to_the_version_that_is_understood(
    floor_scenario: MakeScenario,
) -> None:
    async def work() -> None:
        settings = ServeSettings(standby=True, faults=Faults(ignored_fire_version=2))
        times = LinkTimeouts(fallback_ns=200_000_000, keep_alive_ns=50_000_000)
        async with (
            ServedScenario(floor_scenario(), settings) as served,
            OculusSonar("127.0.0.1", QUICK, port=served.sonar.port, times=times) as sonar,
        ):
            assert (await next_ping(sonar)).version == 1
            assert served.sonar.device.fires_ignored > 0

    run(work())


def test_the_driver_comes_back_after_a_restart_and_asks_again(floor_scenario: MakeScenario) -> None:
    async def work() -> None:
        settings = ServeSettings(standby=True, faults=Faults(restart=0.2, seed=2))
        times = LinkTimeouts(back_off_ns=(10_000_000,))
        async with (
            ServedScenario(floor_scenario(), settings) as served,
            OculusSonar("127.0.0.1", QUICK, port=served.sonar.port, times=times) as sonar,
        ):
            while sonar.counters.connections < 3:
                ping = await next_ping(sonar)
            assert served.sonar.counters.restarts >= 2
            assert ping.max_range_m == pytest.approx(3.0, rel=0.01)

    run(work())


def test_the_driver_triggers_single_pings(floor_scenario: MakeScenario) -> None:
    async def work() -> None:
        triggered = replace(QUICK, network_trigger=True)
        async with (
            ServedScenario(floor_scenario(), ServeSettings(standby=True)) as served,
            OculusSonar("127.0.0.1", triggered, port=served.sonar.port) as sonar,
        ):
            await sonar.wait_for(LinkState.STANDBY)
            assert (await sonar.apply(triggered)).confirmed
            assert [(await sonar.fire()).ping_id for _ in range(3)] == [1, 2, 3]

    run(work())


def test_a_restart_begins_ids_and_time_again(floor_scenario: MakeScenario) -> None:
    async def work() -> None:
        faults = Faults(restart_ids=1.0)
        async with (
            ServedScenario(floor_scenario(), ServeSettings(faults=faults)) as served,
            await Client.of_address("127.0.0.1", served.sonar.port) as client,
        ):
            assert await client.ids(3) == [1, 1, 1]

    run(work())


def test_the_link_outlives_cuts_and_noise(floor_scenario: MakeScenario) -> None:
    async def work() -> None:
        faults = Faults(cut=0.05, flip=0.1, garbage=0.2, lose=0.1, seed=3)
        async with (
            ServedScenario(floor_scenario(), ServeSettings(faults=faults)) as served,
            OculusSonar("127.0.0.1", QUICK, port=served.sonar.port) as sonar,
        ):
            pings = [await next_ping(sonar) for _ in range(15)]
            assert served.sonar.counters.pings_damaged > 0
            good = [ping for ping in pings if not ping.warnings and ping.max_range_m < 3.1]
            assert np.median([floor_m(ping) for ping in good]) == pytest.approx(2.0, abs=0.06)

    run(work())


def test_odometry_comes_with_its_errors_and_late(
    floor_scenario: MakeScenario, with_errors: Callable[..., Scenario]
) -> None:
    async def work() -> None:
        loop = asyncio.get_running_loop()
        scenario = with_errors(floor_scenario(), position_bias_m=(5.0, 0.0, 0.0), latency_s=0.05)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as heard:
            heard.bind(("127.0.0.1", 0))
            heard.setblocking(False)  # noqa: FBT003 as above
            output = output_named(f"native@udp:127.0.0.1:{heard.getsockname()[1]}")
            async with ServedScenario(scenario, ServeSettings(outputs=[output])) as served:
                for _ in range(10):
                    record = decode_native(await loop.sock_recv(heard, 2048))
                    now_ns = served.unix_ns(served.route_s())
                    assert isinstance(record, Odometry)
                    assert record.position_m is not None
                    time_s = (record.stamp_ns - served.unix_ns(0.0)) / 1e9
                    truth_m = scenario.trajectory.pose(time_s).position_m
                    assert record.position_m - truth_m == pytest.approx([5, 0, 0], abs=0.03)
                    assert now_ns - record.stamp_ns >= 50_000_000
                assert output.sent >= 10

    run(work())


def test_odometry_over_tcp_and_a_serial_line(floor_scenario: MakeScenario) -> None:
    async def work() -> None:
        outputs = [
            output_named("waterlinked@tcp:127.0.0.1:0"),
            output_named("waterlinked-serial@pty"),
        ]
        async with ServedScenario(floor_scenario(), ServeSettings(outputs=outputs)):
            _, host, port = outputs[0].link.name.split(":")
            reader, writer = await asyncio.open_connection(host, int(port))
            assert (await reader.readline()).startswith(b'{"')
            writer.close()
            path = outputs[1].link.name.removeprefix("serial:")
            with open(path, "rb", buffering=0) as line:  # noqa: ASYNC230, PTH123 there at once
                await asyncio.sleep(0.1)
                assert b"wr" in line.read(1000)

    run(work())


@pytest.mark.parametrize(
    "text",
    ["native", "native@", "native@udp:1", "native@udp:h:99999", "x@udp:h:1", "native@ftp:a:1"],
)
def test_a_link_that_cannot_be_is_reported(text: str) -> None:
    with pytest.raises(SonarSimError, match="odometry: "):
        output_named(text)


def test_a_port_that_is_taken_is_reported(floor_scenario: MakeScenario) -> None:
    async def work() -> None:
        with socket.socket() as taken:
            taken.bind(("127.0.0.1", 0))
            taken.listen()
            port = taken.getsockname()[1]
            outputs = [output_named(f"nmea@tcp:127.0.0.1:{port}")]
            with pytest.raises(SonarSimError, match=f"listen on 127.0.0.1:{port}"):
                async with ServedScenario(floor_scenario(), ServeSettings(outputs=outputs)):
                    pass

    run(work())


def test_records_that_jitter_overtakes_come_later() -> None:
    delays = [0.5, 0.0, 0.0, 0.2, 0.0, 0.0]
    samples: list[Any] = [
        OdometrySample(0.1 * k, 0.1 * k + 0.05 + delay, None, None, None)  # type: ignore[arg-type]
        for k, delay in enumerate(delays)
    ]
    arrived = [sample.arrival_s for sample in by_arrival(iter(samples), 0.05)]
    assert arrived == sorted(arrived)
    assert len(arrived) == len(samples)
