"""A sonar and a vehicle on loopback become a map."""

import asyncio
import json
import re
import socket
import threading
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mapperd.cli.mapperd import main
from mapperd.config.loader import config_from_text
from mapperd.config.tree import Config
from mapperd.daemon.session import Live, host_clock
from mapperd.daemon.sonar_control import fire_settings
from mapperd.errors import ConfigError
from mapperd.events import EventLog
from mapperd.geometry.frames import pose_from_rpy
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.decoder import PosedPing
from mapperd.pipeline.pose_lookup import FixedPose, OdometryPoses
from mapperd.session.replay import Replay, Window
from mapperd.session_log import DECISIONS, remarks_in
from oculus_driver import Ping, PlaybackSonar
from oculus_driver.command_line import ExitCode
from oculus_driver.ping import PingHeader
from oculus_driver.recording import open_recording
from oculus_driver.wire import PingRate
from tests.support.process import free_port

pytestmark = pytest.mark.net

PingBytes = Callable[..., bytes]
LIMIT_S = 20.0


def run(work: Coroutine[Any, Any, None]) -> None:
    async def limited() -> None:
        async with asyncio.timeout(LIMIT_S):
            await work
        assert asyncio.all_tasks() == {asyncio.current_task()}

    asyncio.run(limited())


def config_of(sonar: PlaybackSonar, odometry_port: int, more: str = "") -> Config:
    return config_from_text(
        "octree: {voxel_resolution: 0.2}\nmounting: {orientation: {pitch: 0}}\n"
        f"device: {{address: {sonar.host}, port: {sonar.port}, ping_rate: highest}}\n"
        f"odometry: {{sources: [{{link: 'udp://127.0.0.1:{odometry_port}'}}]}}\n{more}"
    )


async def send_odometry(port: int, make: Callable[..., bytes], **changes: Any) -> None:
    """A vehicle that drives ahead, 50 records a second, until it is cancelled."""
    loop, clock = asyncio.get_running_loop(), host_clock()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.setblocking(False)  # noqa: FBT003 the socket's own argument
        for k in range(10_000):
            record = make(p=(0.01 * k, 0.0, 0.0), clk="unix", t=clock(), **changes)
            await loop.sock_sendto(link, record, ("127.0.0.1", port))
            await asyncio.sleep(0.02)


async def mapped(live: Live, pings: int) -> None:
    while live.counters.pings_mapped < pings:  # noqa: ASYNC110 no event to await
        await asyncio.sleep(0.01)


def test_pings_meet_the_poses_of_their_time(
    ping_bytes: PingBytes, odometry_bytes: Callable[..., bytes]
) -> None:
    async def work() -> None:
        pings = [ping_bytes(k, start_time=100 + 0.05 * k) for k in range(1, 40)]
        async with PlaybackSonar(pings, standby=True, loops=None) as sonar:
            port = free_port()
            sonar_map = SonarMap(config_of(sonar, port))
            poses = OdometryPoses(sonar_map.config)
            live = Live(sonar_map, poses)
            vehicle = asyncio.create_task(send_odometry(port, odometry_bytes))
            await live.run(mapped(live, 10))
            vehicle.cancel()
            await asyncio.gather(vehicle, return_exceptions=True)
            counters = live.counters
            dropped = counters.pings_dropped.total()
            assert counters.pings_total == counters.pings_mapped + dropped
            assert counters.pings_mapped >= 10
            assert poses.odometry.accepted == poses.odometry.received > 10
            assert live.mapping.snapshot.clocks["placed"]["device"] > 0
            occupied_x = sonar_map.voxels("occupied").centres_m[:, 0]
            assert 3.0 < np.max(occupied_x) < 4.5  # the wall 3 m ahead went along
            demand = sonar.device.request
            assert demand is not None
            assert demand.standby  # it is not left pinging in air

    run(work())


def test_pings_are_decoded_in_the_mapping_thread_only(
    ping_bytes: PingBytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    threads: list[str] = []
    decode = PingHeader.decode

    def noted(header: PingHeader) -> Ping:
        threads.append(threading.current_thread().name)
        return decode(header)

    async def work() -> None:
        async with PlaybackSonar([ping_bytes(1)], standby=True, loops=None, speed=None) as sonar:
            sonar_map = SonarMap(config_of(sonar, free_port()))
            live = Live(sonar_map, FixedPose(pose_at_origin()))
            monkeypatch.setattr(PingHeader, "decode", noted)
            await live.run(mapped(live, 10))
            monkeypatch.undo()
            assert set(threads) == {"mapping"}
            assert len(threads) == live.counters.pings_total

    run(work())


def test_a_ping_without_odometry_is_dropped_with_its_reason(ping_bytes: PingBytes) -> None:
    async def work() -> None:
        async with PlaybackSonar([ping_bytes(1)], standby=True, loops=None, speed=None) as sonar:
            sonar_map = SonarMap(config_of(sonar, free_port()))
            live = Live(sonar_map, OdometryPoses(sonar_map.config))
            await live.run(asyncio.sleep(0.3))
            counters = live.counters
            assert counters.pings_mapped == 0
            assert counters.pings_dropped["no_odometry"] > 0
            assert counters.pings_total == counters.pings_dropped.total()

    run(work())


def test_a_port_that_is_taken_is_reported_and_tried_again(ping_bytes: PingBytes) -> None:
    async def work() -> None:
        port = free_port()
        events = EventLog(host_clock())
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
            taken.bind(("127.0.0.1", port))
            async with PlaybackSonar([ping_bytes(1)]) as sonar:
                live = Live(
                    SonarMap(config_of(sonar, port)),
                    FixedPose(pose_at_origin()),
                    events=events,
                )

                async def freed() -> None:
                    while live.links[0].status.losses == 0:  # noqa: ASYNC110 no event to await
                        await asyncio.sleep(0.01)
                    taken.close()
                    while live.links[0].status.opened == 0:  # noqa: ASYNC110
                        await asyncio.sleep(0.01)

                await live.run(freed())
        reported = [one for one in events.since(0)[0] if one.code == "odometry_link"]
        phases = ["opening", "backing off", "opening", "waiting", "closed"]
        assert [one.facts["state"] for one in reported] == phases
        assert {one.facts["link"] for one in reported} == {"odometry"}
        assert "in use" in reported[1].text

    run(work())


def test_what_goes_wrong_in_the_step_ends_the_run(
    ping_bytes: PingBytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def work() -> None:
        async with PlaybackSonar([ping_bytes(1)], standby=True, loops=None) as sonar:
            live = Live(SonarMap(config_of(sonar, free_port())), FixedPose(pose_at_origin()))

            def fails(posed: PosedPing) -> None:
                raise RuntimeError(f"{posed.ping.ping_id} {posed.pose}")

            monkeypatch.setattr(live.mapping.pipeline.executor, "map_ping", fails)
            with pytest.raises(RuntimeError, match="1 "):
                await live.run(asyncio.sleep(60))

    run(work())


def pose_at_origin() -> Any:
    return pose_from_rpy((0, 0, 0), (0, 0, 0))


def test_the_settings_report_what_the_sonar_is_asked_for() -> None:
    config = config_from_text(
        "device: {mode: 2, ping_rate: low, range: 4.5, gain: 33, beams: 256, address: 10.0.0.7}"
    )
    settings = fire_settings(config)
    assert (settings.mode, settings.ping_rate) == (2, PingRate.LOW)
    assert (settings.range_m, settings.gain_percent, settings.beams) == (4.5, 33, 256)


def test_the_command_writes_the_same_folder(
    tmp_path: Path, ping_bytes: PingBytes, capsys: pytest.CaptureFixture[str]
) -> None:
    async def work() -> int:
        async with PlaybackSonar([ping_bytes(1)], standby=True, loops=None) as sonar:
            path = tmp_path / "live.yaml"
            path.write_text(
                "octree: {voxel_resolution: 0.2}\nmounting: {orientation: {pitch: 0}}\n"
                f"device: {{address: {sonar.host}, port: {sonar.port}}}\n"
                f"odometry: {{sources: [{{link: 'udp://127.0.0.1:{free_port()}'}}]}}\n",
                encoding="utf-8",
            )
            words = ["--config", path, "--out", tmp_path / "out", "--pose", "0,0,0,0,0,0"]
            words += ["--duration", "1.5"]
            return await asyncio.to_thread(main, [str(word) for word in words])

    # No main thread, no signal handlers: the time limit ends it.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("asyncio.unix_events._UnixSelectorEventLoop.add_signal_handler", lambda *_: 0)
        assert asyncio.run(work()) == ExitCode.OK
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert summary["pings_mapped"] > 3
    assert summary["poses"]["source"] == "fixed"
    assert summary["live"]["pings_placed_by"]
    assert (tmp_path / "out" / "map.bt").exists()
    stated = capsys.readouterr()
    assert "mapped" in stated.out
    assert "sonar: pinging" in stated.err


def test_no_sonar_is_reported_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        port = silent.getsockname()[1]
        path = tmp_path / "live.yaml"
        path.write_text(
            f"device: {{address: 127.0.0.1, port: {port}}}\nodometry: {{sources: [{{link: 'udp://127.0.0.1:{free_port()}'}}]}}\n",
            encoding="utf-8",
        )
        words = ["--config", path, "--out", tmp_path / "out", "--duration", "0.2"]
        assert main([str(word) for word in words]) == ExitCode.BAD_DATA
    assert re.search(rf"live: .*127\.0\.0\.1:{port}", capsys.readouterr().err)


def test_what_comes_in_is_recorded_and_can_be_replayed(
    tmp_path: Path, ping_bytes: PingBytes, odometry_bytes: Callable[..., bytes]
) -> None:
    async def work() -> SonarMap:
        pings = [ping_bytes(k, start_time=100 + 0.05 * k) for k in range(1, 40)]
        async with PlaybackSonar(pings, standby=True, loops=None) as sonar:
            port = free_port()
            more = f"recording: {{folder: {tmp_path}, free_floor: 0}}\n"
            sonar_map = SonarMap(config_of(sonar, port, more))
            live = Live(sonar_map, OdometryPoses(sonar_map.config))
            vehicle = asyncio.create_task(send_odometry(port, odometry_bytes))
            await live.run(mapped(live, 10))
            vehicle.cancel()
            await asyncio.gather(vehicle, return_exceptions=True)
            return sonar_map

    recorded: list[SonarMap] = []

    async def once() -> None:
        recorded.append(await work())

    run(once())
    (path,) = tmp_path.iterdir()
    with open_recording(path) as recording:
        chunks = list(recording)
    assert {chunk.encoding for chunk in chunks} == {"oculus", "odometry-native", DECISIONS}
    again = SonarMap(recorded[0].config)
    replay = Replay(
        again,
        OdometryPoses(again.config),
        Window(),
        lambda: 0.0,
        confirm=False,
        remarks=remarks_in(chunks),  # a busy machine leaves pings out
    )
    for _ in replay.run(chunks):
        pass
    assert replay.counters.pings_mapped >= 10
    assert again.sha256() == recorded[0].sha256()


async def flood(writer: asyncio.StreamWriter) -> None:
    """Write 8 MB/s of NMEA with wrong checksums until it is cancelled."""
    lines = b"$GPGGA,101112.00,4717.11,N,00833.91,E,1,08,0.9,499.6,M,48.0,M,,*00\r\n" * 1200
    try:
        while True:
            writer.write(lines)
            await writer.drain()
            await asyncio.sleep(len(lines) / 8e6)
    finally:
        writer.close()


def test_garbage_on_one_link_costs_neither_pings_nor_recordings(
    tmp_path: Path, ping_bytes: PingBytes, odometry_bytes: Callable[..., bytes]
) -> None:
    maps: list[SonarMap] = []

    async def work() -> None:
        pings = [ping_bytes(k, start_time=100 + 0.05 * k) for k in range(1, 60)]
        garbage: list[asyncio.Task[None]] = []
        async with (
            PlaybackSonar(pings, standby=True, loops=None) as sonar,
            await asyncio.start_server(
                lambda _, writer: garbage.append(asyncio.create_task(flood(writer))), "127.0.0.1"
            ) as bad,
        ):
            port, bad_port = free_port(), bad.sockets[0].getsockname()[1]
            sources = f"{{name: good, link: 'udp://127.0.0.1:{port}'}}"
            sources += f", {{name: bad, format: nmea, link: 'tcp://127.0.0.1:{bad_port}'}}"
            sonar_map = SonarMap(
                config_from_text(
                    "octree: {voxel_resolution: 0.2}\nmounting: {orientation: {pitch: 0}}\n"
                    "behind: {max_wait: 5}\n"
                    f"device: {{address: {sonar.host}, port: {sonar.port}, ping_rate: highest}}\n"
                    f"odometry: {{sources: [{sources}]}}\n"
                    f"recording: {{folder: {tmp_path}, free_floor: 0}}\n"
                )
            )
            maps.append(sonar_map)
            live = Live(sonar_map, OdometryPoses(sonar_map.config))
            vehicle = asyncio.create_task(send_odometry(port, odometry_bytes))
            await live.run(asyncio.sleep(4))
            for task in (vehicle, *garbage):
                task.cancel()
            await asyncio.gather(vehicle, *garbage, return_exceptions=True)
            good, link = live.links
            assert link.status.bytes_received > 8e6
            assert link.limit.reason == "hardly any valid frame"
            assert good.limit.bytes_dropped == live.queue.bytes_refused == 0
            assert live.counters.pings_mapped > 40
            assert live.counters.pings_dropped["too_slow"] == 0

    run(work())
    (path,) = tmp_path.iterdir()
    with open_recording(path) as recording:
        chunks = list(recording)
    assert sum(len(chunk.data) for chunk in chunks if chunk.link == "bad") < 1 << 20
    again = SonarMap(maps[0].config)
    poses, remarks = OdometryPoses(again.config), remarks_in(chunks)
    for _ in Replay(again, poses, Window(), confirm=False, remarks=remarks).run(chunks):
        pass
    assert again.sha256() == maps[0].sha256()


def test_two_sources_cannot_share_a_link() -> None:
    text = "odometry: {sources: [{name: a}, {name: b}]}"
    config = config_from_text(text)
    with pytest.raises(ConfigError, match=r"'a' and 'b' .*udp://"):
        Live(SonarMap(config), FixedPose(pose_at_origin()))
