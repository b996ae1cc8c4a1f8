"""What a sonar does at sea, and what becomes of the link and the pings."""

from __future__ import annotations

import asyncio
import json
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from oculus_driver import FireSettings, LinkState, LinkTimeouts, OculusSonar
from oculus_driver.wire import MessageId
from tests.support.process import free_tcp_port

if TYPE_CHECKING:
    from pathlib import Path

    from oculus_driver import LinkStatus, Ping
    from tests.oculus_driver.conftest import MakePing
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


def test_a_cut_connection_is_made_again_with_the_settings(
    fake: MakeSonar, run: Run, quick: LinkTimeouts
) -> None:
    # quirk 22: lost right after the first configuration; and at any later time.
    async def main() -> None:
        async with (
            fake() as device,
            OculusSonar(HOST, FREE, port=device.port, times=quick) as sonar,
        ):
            for clients in (1, 2, 3):
                await take(sonar, 3)
                assert device.clients == clients
                device.drop()
                assert await sonar.wait_for(LinkState.BACKING_OFF)
                assert "connection" in sonar.link.reason
                await sonar.wait_for(LinkState.PINGING)
            assert sonar.counters.losses == 3
            assert {fire["range_demand"] for fire in device.fires} == {5.0}

    run(main())


def test_a_pause_of_this_program_is_no_silence_of_the_sonar(
    fake: MakeSonar, run: Run, quick: LinkTimeouts
) -> None:
    times = replace(quick, silence_ns=200_000_000, reconnect_ns=300_000_000)

    async def main() -> None:
        async with (
            fake() as device,
            OculusSonar(HOST, FREE, port=device.port, times=times, max_pings=1) as sonar,
        ):
            for _ in range(3):
                await take(sonar, 3)
                time.sleep(1.5)  # noqa: ASYNC251 - as a stopped process does
            await take(sonar, 3)
            assert (device.clients, sonar.counters.losses) == (1, 0)
            device.mute = True
            await sonar.wait_for(LinkState.BACKING_OFF)  # a silent sonar is still noticed

    run(main())


@pytest.mark.slow
def test_a_process_that_is_stopped_for_ten_seconds_keeps_its_link(capture_path: Path) -> None:
    port = free_tcp_port()
    oculus = (sys.executable, "-m", "oculus_driver.cli")
    play = (
        *oculus,
        "play",
        str(capture_path),
        "--loop",
        "--remade",
        "--status-to",
        HOST,
        "--port",
        str(port),
    )
    log = (*oculus, "watch", HOST, "--port", str(port), "--ping", "--bits", "32", "--json")
    with (
        subprocess.Popen(play, stdout=subprocess.DEVNULL) as device,  # noqa: S603 our own
        subprocess.Popen(log, stdout=subprocess.PIPE, text=True) as watch,  # noqa: S603
    ):
        assert watch.stdout is not None
        lines = (json.loads(line) for line in watch.stdout)
        try:
            assert next(line for line in lines if line["state"] == "pinging")
            before = next(line for line in lines if line.get("pings", 0) > 3)
            watch.send_signal(signal.SIGSTOP)
            time.sleep(10.5)
            watch.send_signal(signal.SIGCONT)
            counts = [next(line for line in lines if line["event"] == "pings") for _ in range(4)]
        finally:
            watch.kill()
            device.kill()
    assert [one["connections"] for one in counts] == [before["connections"]] * 4
    assert [one["losses"] for one in counts] == [before["losses"]] * 4
    assert counts[-1]["pings"] > before["pings"]


def test_a_sonar_that_is_switched_on_later_is_found(
    fake: MakeSonar, run: Run, quick: LinkTimeouts
) -> None:
    async def main() -> None:
        device = fake()
        device.port = free_tcp_port()
        async with OculusSonar(HOST, FREE, port=device.port, times=quick) as sonar:
            await sonar.wait_for(LinkState.BACKING_OFF)
            assert "refused: another client" in sonar.link.reason
            async with device:
                await take(sonar, 2)

    run(main())


def test_an_address_that_never_answers_is_given_up_and_left(run: Run, quick: LinkTimeouts) -> None:
    async def main() -> None:
        with socket.create_server((HOST, 0), backlog=0) as full:
            port = full.getsockname()[1]
            waiting = [socket.socket() for _ in range(4)]
            for one in waiting:  # the queue is full: the next attempt gets no answer at all
                one.settimeout(0.0)
                one.connect_ex((HOST, port))
            async with OculusSonar(HOST, FREE, port=port, times=quick) as sonar:
                await sonar.wait_for(LinkState.BACKING_OFF)
                assert "0.5 s" in sonar.link.reason
                await sonar.wait_for(LinkState.CONNECTING)
            for one in waiting:
                one.close()

    run(main())


def test_nothing_is_left_of_a_connection_at_the_end(fake: MakeSonar, run: Run) -> None:
    async def main() -> None:
        async with fake() as device:
            async with OculusSonar(HOST, FREE, port=device.port) as sonar:
                await take(sonar, 1)
                connection = sonar._driver._connection
            assert connection is not None
            assert connection.closed.done()

    run(main())


def test_a_peer_that_never_reads_is_left_all_the_same(run: Run) -> None:
    async def main() -> None:
        with socket.create_server((HOST, 0)) as deaf:
            async with OculusSonar(HOST, FREE, port=deaf.getsockname()[1]) as sonar:
                await sonar.wait_for(LinkState.CONFIGURING)
                connection = sonar._driver._connection
                assert connection is not None
                assert connection._transport is not None
                connection._transport.write(bytes(1 << 25))
            assert connection.closed.done()

    run(main())


def test_commands_that_do_not_get_out_end_the_connection(run: Run, quick: LinkTimeouts) -> None:
    async def main() -> None:
        with socket.create_server((HOST, 0)) as deaf:
            port = deaf.getsockname()[1]
            async with OculusSonar(HOST, FREE, port=port, times=quick) as sonar:
                await sonar.wait_for(LinkState.CONFIGURING)
                connection = sonar._driver._connection
                assert connection is not None
                assert connection._transport is not None
                connection._transport.write(bytes(1 << 25))
                await sonar.wait_for(LinkState.BACKING_OFF)
                assert "commands" in sonar.link.reason

    run(main())


def test_a_second_client_is_informed_what_may_be_wrong(
    fake: MakeSonar, run: Run, quick: LinkTimeouts
) -> None:
    # quirk 20: one client at a time.
    async def main() -> None:
        async with (
            fake() as device,
            OculusSonar(HOST, FREE, port=device.port) as first,
        ):
            await take(first, 1)
            async with OculusSonar(HOST, FREE, port=device.port, times=quick) as second:
                await second.wait_for(LinkState.BACKING_OFF)
                await asyncio.sleep(0.05)
                assert second.counters.pings == 0
            await take(first, 1)
            assert first.counters.losses == 0

    run(main())


def test_version_1_is_spoken_to_a_sonar_that_knows_no_other(
    fake: MakeSonar, run: Run, quick: LinkTimeouts
) -> None:
    # quirk 14: the version of the results follows that of the fire message.
    async def main() -> None:
        async with (
            fake(versions=(1,)) as device,
            OculusSonar(HOST, FREE, port=device.port, times=quick) as sonar,
        ):
            (ping,) = await take(sonar, 1)
            assert (ping.version, sonar.link.fire_version) == (1, 1)
            assert device.fires[0]["version"] == 2

    run(main())


def test_silence_is_named_and_ends_in_a_new_connection(
    fake: MakeSonar, run: Run, quick: LinkTimeouts
) -> None:
    async def main() -> None:
        strict = replace(quick, silence_ns=200_000_000)
        async with (
            fake() as device,
            OculusSonar(HOST, FREE, port=device.port, times=strict) as sonar,
        ):
            await take(sonar, 1)
            device.mute = True
            await sonar.wait_for(LinkState.SILENT)
            await sonar.wait_for(LinkState.BACKING_OFF)
            assert "no message from 127.0.0.1" in sonar.link.reason
            device.mute = False
            await sonar.wait_for(LinkState.PINGING)

    run(main())


def test_a_message_that_stops_in_the_middle_costs_the_connection_not_the_program(
    fake: MakeSonar, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("oculus_driver.link.receiver.STALL_TIMEOUT_NS", 50_000_000)

    async def main() -> None:
        statuses: list[LinkStatus] = []
        never_ns = 10**11  # no other timer runs out
        quiet = LinkTimeouts(never_ns, None, silence_ns=never_ns, fallback_ns=never_ns)
        async with (
            fake() as device,
            OculusSonar(
                HOST, FREE, port=device.port, times=quiet, on_state=statuses.append
            ) as sonar,
        ):
            await take(sonar, 1)
            device.mute = True
            device.send(device.ping_message()[:1000])
            await sonar.wait_for(LinkState.BACKING_OFF)
            assert "after 1000 bytes" in sonar.link.reason
            assert LinkState.SILENT not in [status.state for status in statuses]
            device.mute = False
            await sonar.wait_for(LinkState.PINGING)
            assert sonar.counters.rejects["truncated"] == 1

    run(main())


@pytest.mark.parametrize("limit_mbps", [100, None])
def test_big_pings_come_through_slow_and_fast_networks(
    fake: MakeSonar, run: Run, limit_mbps: int | None
) -> None:
    # 100 Mbit/s and 1 Gbit/s: the byte in the fire message, and pings at that speed.
    async def main() -> None:
        settings = replace(FREE, network_limit_mbps=limit_mbps)
        async with (
            fake(rows=703) as device,
            OculusSonar(HOST, settings, port=device.port) as sonar,
        ):
            await take(sonar, 1)
            assert device.fires[-1]["network_speed_mbps"] == (limit_mbps or 255)
            device.mute = True
            first_id = device.next_id
            for _ in range(10):
                await device.send_at(limit_mbps or 1000, device.ping_message())
            pings = await take(sonar, 1)
            while pings[-1].ping_id < first_id + 9:
                pings += await take(sonar, 1)
            assert (sonar.counters.losses, sonar.counters.lost_pings) == (0, 0)
            assert sonar.counters.bytes_rejected == 0
            assert pings[-1].image.shape == (703, 512)

    run(main())


def test_noise_without_end_costs_the_connection(
    fake: MakeSonar, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("oculus_driver.link.receiver.MAX_RESYNC_BYTES", 100_000)

    async def main() -> None:
        async with fake() as device, OculusSonar(HOST, FREE, port=device.port) as sonar:
            await take(sonar, 1)
            device.mute = True
            device.send(bytes(200_000))
            await sonar.wait_for(LinkState.BACKING_OFF)
            assert sonar.link.reason.startswith("no message in ")
            device.mute = False
            await sonar.wait_for(LinkState.PINGING)
            assert sonar.counters.resyncs == 1

    run(main())


def test_noise_between_messages_costs_no_ping(fake: MakeSonar, run: Run) -> None:
    async def main() -> None:
        async with fake() as device, OculusSonar(HOST, FREE, port=device.port) as sonar:
            await take(sonar, 1)
            device.mute = True
            for _ in range(5):
                device.send(b"noise SO noise")
                device.ping()
            device.ping()
            pings = await take(sonar, sonar.counters.queued or 1)
            while pings[-1].ping_id != device.next_id - 1:
                pings += await take(sonar, 1)
            ids = [ping.ping_id for ping in pings]
            assert ids == list(range(ids[0], ids[0] + len(ids)))
            assert sonar.counters.lost_pings == 0
            assert sonar.counters.losses == 0

    run(main())


def test_other_messages_and_unknown_ids_are_counted_and_skipped(fake: MakeSonar, run: Run) -> None:
    # quirk 32
    async def main() -> None:
        unknown = bytes.fromhex("534fd41e0000ee0000000400000000000102 0304".replace(" ", ""))
        async with fake() as device, OculusSonar(HOST, FREE, port=device.port) as sonar:
            await take(sonar, 1)
            device.send(unknown)
            await take(sonar, 3)
            assert sonar.counters.messages[0xEE] == 1
            assert sonar.counters.rejects["unknown_id"] == 1
            assert sonar.counters.bytes_rejected == 0

    run(main())


def test_a_ping_is_delivered_once(fake: MakeSonar, run: Run) -> None:
    async def main() -> None:
        async with fake() as device, OculusSonar(HOST, FREE, port=device.port) as sonar:
            await take(sonar, 1)
            device.mute = True
            message = device.ping_message(ping_id=1000)
            device.send(message + message)
            device.ping(ping_id=1001)
            pings = await take(sonar, 1)
            while pings[-1].ping_id != 1001:
                pings += await take(sonar, 1)
            assert [ping.ping_id for ping in pings].count(1000) == 1
            assert sonar.counters.duplicates == 1

    run(main())


def test_a_reader_that_sleeps_loses_old_pings_and_not_the_link(fake: MakeSonar, run: Run) -> None:
    async def main() -> None:
        async with (
            fake() as device,
            OculusSonar(HOST, FREE, port=device.port, max_pings=4) as sonar,
        ):
            (first,) = await take(sonar, 1)
            async with asyncio.timeout(10.0):
                await device.sent(first.ping_id + 40)
            counters = sonar.counters
            assert counters.queued == 4
            assert counters.dropped > 20
            pings = await take(sonar, 4)
            ids = [ping.ping_id for ping in pings]
            assert ids == list(range(ids[0], ids[0] + 4))
            assert ids[0] >= first.ping_id + counters.dropped
            assert counters.pings == counters.taken + counters.dropped + counters.queued
            assert (counters.losses, counters.lost_pings) == (0, 0)

    run(main())


def test_a_program_that_stands_still_for_a_second_keeps_the_link(
    make_ping: MakePing, run: Run, quick: LinkTimeouts
) -> None:
    # The device pings on from a thread of its own while our event loop is blocked.
    async def main() -> None:
        with socket.create_server((HOST, 0)) as server:
            port = server.getsockname()[1]
            pinging = asyncio.create_task(
                asyncio.to_thread(ping_for_two_seconds, server, make_ping)
            )
            patient = replace(quick, back_off_ns=(10**9,), reconnect_ns=500_000_000)
            async with OculusSonar(HOST, FREE, port=port, times=patient) as sonar:
                await take(sonar, 10)
                time.sleep(1.0)  # noqa: ASYNC251 - the fault under test
                await take(sonar, 10)
                counters = sonar.counters
                assert (counters.losses, counters.connections) == (0, 1)
                assert (counters.lost_pings, counters.bytes_rejected) == (0, 0)
            await pinging

    run(main())


def ping_for_two_seconds(server: socket.socket, make_ping: MakePing) -> None:
    client, _ = server.accept()
    with client:
        for ping_id in range(200):
            try:
                client.sendall(make_ping(ping_id=ping_id))
            except OSError:
                return
            time.sleep(0.01)


def test_all_pings_of_a_stormy_hour_are_delivered_or_counted(
    fake: MakeSonar, run: Run, quick: LinkTimeouts
) -> None:
    async def main() -> None:
        async with (
            fake() as device,
            OculusSonar(HOST, FREE, port=device.port, times=quick) as sonar,
        ):
            device.rate_hz = 1000.0
            taken = 0
            for _ in range(20):
                taken += len(await take(sonar, 7))
                device.drop()
                await sonar.wait_for(LinkState.BACKING_OFF)
            await sonar.wait_for(LinkState.PINGING)
            counters = sonar.counters
            assert counters.taken == taken == 140
            assert counters.pings == counters.taken + counters.dropped + counters.queued
            whole = counters.messages[MessageId.PING_RESULT]
            assert whole == counters.pings + counters.duplicates
            assert counters.losses == 20
            assert counters.connections == 21

    run(main())
