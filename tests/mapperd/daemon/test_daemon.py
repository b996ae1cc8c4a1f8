"""What a running daemon can be asked, with a sonar and a vehicle on loopback."""

import asyncio
import json
import socket
import threading
import time
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from mapperd import _core
from mapperd.api import DaemonApi, OperationError
from mapperd.cli.mapperd import main
from mapperd.config.layers import Layered
from mapperd.config.live import Applied, ConfigStore, Refused
from mapperd.config.loader import config_from_text
from mapperd.daemon.daemon import Daemon
from mapperd.daemon.session import Live, host_clock
from mapperd.errors import StoreError
from mapperd.events import EventLog
from mapperd.geometry.frames import pose_from_rpy
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.decoder import PosedPing, Work
from mapperd.pipeline.persistence import MemoryPersistence
from mapperd.pipeline.pose_lookup import FixedPose, OdometryPoses
from mapperd.pipeline.watchdog import Watchdog
from oculus_driver import Faults, PlaybackSonar
from oculus_driver.command_line import ExitCode
from tests.support.process import free_port
from tests.support.waiting import run

pytestmark = pytest.mark.net

MakeBytes = Callable[..., bytes]
STATUS_KEYS = [
    "phase",
    "reason",
    "version",
    "t_s",
    "uptime_s",
    "sonar",
    "odometry",
    "pose",
    "pings",
    "latency_ms",
    "behind",
    "map",
    "store",
    "recording",
    "robots",
    "servers",
]


class Keep(MemoryPersistence):
    """On an imagined disk."""

    def __init__(self, sonar_map: SonarMap) -> None:
        super().__init__(sonar_map)
        self.works: list[Work] = []
        self.broken = False

    def done(self, work: Work) -> None:
        self.works.append(work)

    def reset(self) -> None:
        if self.broken:
            raise StoreError("the disk is full", "disk_full")
        super().reset()

    def save(self) -> int | None:
        if self.broken:
            raise StoreError("the disk is full", "disk_full")
        return 123


class Bench:
    """A daemon that runs, and its parts."""

    def __init__(self, sonar: PlaybackSonar, port: int, folder: Path, *, stands: bool) -> None:
        self.folder = folder
        config = config_from_text(
            "octree: {voxel_resolution: 0.2}\nmounting: {orientation: {pitch: 0}}\n"
            f"device: {{address: {sonar.host}, port: {sonar.port}, ping_rate: highest}}\n"
            f"odometry: {{sources: [{{link: 'udp://127.0.0.1:{port}'}}]}}\n"
            f"recording: {{folder: '{folder / 'recordings'}', free_floor: 0}}\n"
        )
        self.files = Layered(config)
        self.map = SonarMap(config)
        poses = FixedPose(pose_from_rpy((0, 0, 0), (0, 0, 0))) if stands else OdometryPoses(config)
        self.keep = Keep(self.map)
        clock = host_clock()
        events = EventLog(clock)
        self.live = Live(
            self.map, poses, session="abc", events=events, persistence=self.keep, clock=clock
        )
        self.daemon = Daemon(
            ConfigStore(self.files),
            self.map,
            self.live,
            events,
            read=lambda: self.files,
            folder=folder / "maps",
        )

    def codes(self) -> list[str]:
        return [event.code for event in self.daemon.events.since(0)[0]]

    async def mapped(self, pings: int) -> None:
        wanted = self.live.counters.pings_mapped + pings
        while self.live.counters.pings_mapped < wanted:  # noqa: ASYNC110 no event to await
            await asyncio.sleep(0.01)


@asynccontextmanager
async def bench_of(
    folder: Path, pings: list[bytes], *, faults: Faults | None = None, vehicle: Any = None
) -> AsyncIterator[Bench]:
    """A daemon that maps; afterwards it has ended."""
    async with PlaybackSonar(pings, standby=True, loops=None, faults=faults) as sonar:
        port = free_port()
        bench = Bench(sonar, port, folder, stands=vehicle is None)
        end = asyncio.Event()
        running = asyncio.create_task(bench.daemon.run(end.wait()))
        driving = asyncio.create_task(drive(port, vehicle)) if vehicle else None
        try:
            while bench.daemon.phase == "starting":  # noqa: ASYNC110 it will be at once
                await asyncio.sleep(0)
            yield bench
        finally:
            end.set()
            if driving is not None:
                driving.cancel()
                await asyncio.gather(driving, return_exceptions=True)
            await running


async def drive(port: int, make: MakeBytes) -> None:
    """A vehicle that drives ahead, 50 records a second, until it is cancelled."""
    loop, clock = asyncio.get_running_loop(), host_clock()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.setblocking(False)  # noqa: FBT003 the socket's own argument
        for k in range(100_000):
            record = make(p=(0.01 * k, 0.0, 0.0), clk="unix", t=clock())
            await loop.sock_sendto(link, record, ("127.0.0.1", port))
            await asyncio.sleep(0.02)


@pytest.fixture
def pings(ping_bytes: MakeBytes) -> list[bytes]:
    return [ping_bytes(k, start_time=100 + 0.02 * k) for k in range(1, 60)]


def test_daemon_offers_all_operations(tmp_path: Path, pings: list[bytes]) -> None:
    async def work() -> None:
        async with bench_of(tmp_path, pings) as bench:
            operations: DaemonApi = bench.daemon
            await bench.mapped(3)
            saved = await operations.save("wall.bt", "test")
            written = await asyncio.to_thread(Path(saved["path"]).read_bytes)
            assert written.startswith(b"# Octomap OcTree binary file")
            assert saved["bytes"] == len(written)
            assert (await operations.snapshot("test"))["bytes"] == 123
            await operations.reset("test")
            await bench.mapped(2)
        codes = bench.codes()
        for code in ("session_began", "sonar_link", "map_saved", "snapshot", "map_reset"):
            assert code in codes
        assert codes[-1] == "session_ended"

    run(work())


@pytest.mark.parametrize("hangs", [False, True])
def test_a_long_ping_is_no_hang(tmp_path: Path, pings: list[bytes], *, hangs: bool) -> None:
    async def work() -> None:
        async with bench_of(tmp_path, pings) as bench:
            await bench.mapped(1)
            executor, begun = bench.live.mapping.pipeline.executor, threading.Event()
            map_ping, watchdog, stuck = executor.map_ping, Watchdog(0.5), set[str]()

            def long(posed: PosedPing) -> Any:
                begun.set()
                executor.map_ping = map_ping  # type: ignore[method-assign]
                for _ in range(15):
                    time.sleep(0.1)
                    if not hangs:
                        _core.finish_part()  # as an integrator does
                return map_ping(posed)

            executor.map_ping = long  # type: ignore[method-assign]
            await asyncio.to_thread(begun.wait)
            for _ in range(25):
                stuck |= set(watchdog.stuck(bench.daemon.workers(), time.monotonic()))
                await asyncio.sleep(0.05)
            assert stuck == ({"mapping"} if hangs else set())

    run(work())


def test_map_is_written_into_its_folder_alone(tmp_path: Path, pings: list[bytes]) -> None:
    async def work() -> None:
        async with bench_of(tmp_path, pings) as bench:
            for name in ("", ".", "..", "a/b.bt", "/etc/a.bt", "../a.bt", "a\0.bt"):
                with pytest.raises(OperationError) as caught:
                    await bench.daemon.save(name, "test")
                assert caught.value.reason == "bad_name"

    run(work())


def test_what_cannot_be_done_reports_the_reason(tmp_path: Path, pings: list[bytes]) -> None:
    async def refused(work: Coroutine[Any, Any, Any]) -> str:
        with pytest.raises(OperationError) as caught:
            await work
        return caught.value.reason

    async def work() -> None:
        async with bench_of(tmp_path, pings) as bench:
            await bench.mapped(1)
            assert await refused(bench.daemon.save("a.docx", "test")) == "bad_format"
            bench.keep.broken = True
            assert await refused(bench.daemon.reset("test")) == "cannot_write"
            assert await refused(bench.daemon.snapshot("test")) == "cannot_write"
            assert await refused(bench.daemon.save("a.bt", "test")) == "cannot_write"
            await bench.mapped(1)  # it goes on all the same
        assert await refused(bench.daemon.reset("test")) == "busy"

    run(work())


def test_map_in_memory_has_no_snapshot(tmp_path: Path, pings: list[bytes]) -> None:
    async def work() -> None:
        async with bench_of(tmp_path, pings) as bench:
            bench.live.persistence = MemoryPersistence(bench.map)
            with pytest.raises(OperationError, match="in memory alone"):
                await bench.daemon.snapshot("test")

    run(work())


def test_status_is_plain_and_whole(
    tmp_path: Path, pings: list[bytes], odometry_bytes: MakeBytes
) -> None:
    async def work() -> None:
        async with bench_of(tmp_path, pings, vehicle=odometry_bytes) as bench:
            before = bench.daemon.status()
            assert (before["phase"], before["pose"]) == ("mapping", None)
            await bench.mapped(5)
            while bench.daemon.status()["pings"]["mapped"] < 5:  # noqa: ASYNC110
                await asyncio.sleep(0.01)
            status = bench.daemon.status()
        assert set(STATUS_KEYS) <= set(status)
        json.dumps(status)
        latency = status["latency_ms"]
        assert 0 < latency["p50"] <= latency["p95"] <= latency["p99"]
        pings_ = status["pings"]
        assert pings_["total"] == (
            pings_["mapped"] + sum(pings_["dropped"].values()) + pings_["waiting"]
        )
        assert status["pose"]["position_m"][0] > 0
        assert status["sonar"]["range_m"] == pytest.approx(5.0)
        assert status["recording"]["state"] == "logging"
        after = bench.daemon.status()
        assert after["phase"] == "stopping"
        assert after["pings"]["waiting"] == 0

    run(work())


def test_settings_change_while_mapping(tmp_path: Path, pings: list[bytes]) -> None:
    async def work() -> None:
        async with bench_of(tmp_path, pings) as bench:
            await bench.mapped(2)
            settings = bench.daemon.settings
            assert isinstance(settings.apply({"filtering.min_range": 4.0}, "test"), Applied)
            refused = settings.apply({"octree.voxel_resolution": 1.0}, "test")
            assert isinstance(refused, Refused)
            await bench.daemon.reset("test")
            await bench.mapped(3)  # the wall is 3 m away
            reloaded = await bench.daemon.reload("SIGHUP")
            assert reloaded["changed"] == {"filtering.min_range": 0.5}
        assert "setting_changed" in bench.codes()
        assert "settings" not in bench.codes()

    run(work())


def test_reset_empties_the_map(tmp_path: Path, pings: list[bytes]) -> None:
    async def work() -> None:
        async with bench_of(tmp_path, pings) as bench:
            await bench.mapped(2)
            bench.daemon.settings.apply({"filtering.min_range": 4.0}, "test")
            bench.daemon.settings.apply({"filtering.intensity_threshold": 250}, "test")
            await bench.daemon.reset("test")
        assert bench.map.counts().occupied == 0

    run(work())


@pytest.mark.usefixtures("no_picture")
def test_recording_of_a_troubled_dive_gives_the_map_again(
    tmp_path: Path, pings: list[bytes], odometry_bytes: MakeBytes
) -> None:
    faults = Faults(cut=0.05, lose=0.05, flip=0.05, restart_ids=0.05, garbage=0.05, seed=1)
    bench_: list[Bench] = []

    async def work() -> None:
        async with bench_of(tmp_path, pings, faults=faults, vehicle=odometry_bytes) as bench:
            bench_.append(bench)
            for k in range(4):
                await bench.mapped(4)
                bench.daemon.settings.apply({"filtering.intensity_threshold": 40 + k}, "test")
                if k == 1:
                    await bench.daemon.reset("test")
            while bench.live.sonar.counters.losses < 1:  # noqa: ASYNC110
                await asyncio.sleep(0.01)
            await bench.mapped(3)

    run(work())
    (bench,) = bench_
    out = tmp_path / "out"
    words = ["--replay", str(tmp_path / "recordings"), "--as-recorded", "--out", str(out)]
    assert main(words) == ExitCode.OK
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    counters = bench.live.counters
    assert summary["map_sha256"] == bench.map.sha256()
    assert summary["pings_mapped"] == counters.pings_mapped
    assert summary["pings_dropped"] == counters.pings_dropped
    assert summary["bytes_total"] == counters.bytes_total
