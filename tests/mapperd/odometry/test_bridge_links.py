"""Peers on real wires, through links and the bridge, to poses: with a cut, and back again.

Time is the test's own, so that seconds of silence take none: each message is sent, heard, and only
then does the clock go on.
"""

import asyncio
import math
import socket
import time
from collections.abc import Awaitable, Callable
from contextlib import asynccontextmanager
from functools import partial
from typing import Any

import pytest

from mapperd.config.odometry import (
    FormatName,
    OdometryFusionConfig,
    OdometrySourceConfig,
    parse_address,
)
from mapperd.config.tree import Config
from mapperd.errors import Reject
from mapperd.odometry.bridge import OdometryBridge
from mapperd.odometry.fusion import FusedPose
from mapperd.odometry.links import OdometryLink
from mapperd.odometry.native import NativeRecord, encode_native
from tests.support.peers.autopilot import Autopilot
from tests.support.peers.dvl import Dvl
from tests.support.peers.nmea_talker import NmeaTalker
from tests.support.peers.serial_pty import SerialPty
from tests.support.process import free_port, free_tcp_port
from tests.support.waiting import until

pytestmark = pytest.mark.net

S = 1_000_000_000
T0 = 1_700_000_000 * S  # 22:13:20 UTC
STEP_S = 0.1
LIMIT_S = 20.0
Send = Callable[[bytes], Awaitable[None]]


class Bench:
    """One source on a real link, and its poses.

    Attributes:
        now_ns: the clock of the arrivals.
    """

    def __init__(self, name: FormatName, link: str) -> None:
        source = OdometrySourceConfig(name="peer", format=name, link=link)
        ahrs = OdometrySourceConfig(name="ahrs", link="udp://127.0.0.1:1")
        self.bridge = OdometryBridge(Config(odometry=OdometryFusionConfig(sources=(source, ahrs))))
        self.now_ns = T0
        self.bytes = 0
        self.link = OdometryLink("peer", parse_address(link), self._take, lambda: self.now_ns)

    def _take(self, data: bytes, arrival_ns: int, *, gap: bool) -> None:
        self.bytes += len(data)
        self.bridge.feed("peer", data, arrival_ns, gap_before=gap)

    @property
    def t_s(self) -> float:
        """Since the beginning."""
        return (self.now_ns - T0) / S

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        self.now_ns += round(seconds * S)

    def attitude(self) -> None:
        """Another attitude sensor reports: level, facing east."""
        record = NativeRecord(v=1, clk="arrival", w="enu", b="flu", q=(1.0, 0.0, 0.0, 0.0))
        self.bridge.feed("ahrs", encode_native(record), self.now_ns)

    async def heard(self, send: Send, data: bytes) -> None:
        """Send, and wait until all of it has come."""
        before = self.bytes
        await send(data)
        await until(lambda: self.bytes == before + len(data))

    def pose(self, ago_s: float = 0.15) -> FusedPose:
        fused = self.bridge.fusion.at(self.now_ns - round(ago_s * S))
        assert isinstance(fused, FusedPose), fused
        return fused

    def reason(self, ago_s: float = 0.0) -> str:
        reject = self.bridge.fusion.at(self.now_ns - round(ago_s * S))
        assert isinstance(reject, Reject)
        return reject.reason

    def counted(self) -> None:
        bridge = self.bridge
        assert bridge.received == bridge.accepted + bridge.rejects.total() > 0


def run(bench: Bench, work: Callable[[], Awaitable[None]]) -> None:
    async def both() -> None:
        task = asyncio.create_task(bench.link.run())
        try:
            async with asyncio.timeout(LIMIT_S):
                await work()
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    asyncio.run(both())
    bench.counted()


def yaw_of(fused: FusedPose) -> float:
    """Of a level vehicle, from east."""
    w, x, y, z = fused.pose.map_q_base.tolist()
    assert (x, y) == pytest.approx((0.0, 0.0), abs=1e-9)
    return math.remainder(2 * math.atan2(z, w), math.tau)


def test_autopilot_over_udp() -> None:
    port = free_port()
    bench = Bench("mavlink", f"udp://127.0.0.1:{port}")
    autopilot = Autopilot()
    north_mps, yaw = 0.5, 0.3  # clockwise from north

    async def drive(send: Send, messages: int, since_s: float = 0.0) -> None:
        for _ in range(messages):
            ned = (north_mps * (bench.t_s - since_s), 0.0, 2.0)
            await bench.heard(send, autopilot.local_position(ned, (north_mps, 0, 0)))
            await bench.heard(send, autopilot.attitude((0.0, 0.0, yaw)))
            bench.wait(STEP_S)
            autopilot.boot_ms += round(1000 * STEP_S)

    async def work() -> None:
        await until(lambda: bench.link.status.opened == 1)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.connect(("127.0.0.1", port))
            sender.setblocking(False)  # noqa: FBT003 the socket's own argument

            async def send(data: bytes) -> None:
                await asyncio.get_running_loop().sock_sendall(sender, data)

            await drive(send, 20)
            check(0.01)
            bench.wait(10.0)
            autopilot.boot_ms += 10_000
            assert bench.reason() == "after_odometry"
            await drive(send, 30)
            check(0.01)
            assert bench.reason(ago_s=8.0) == "odometry_gap"
            before = bench.pose().segment
            autopilot.boot_ms = 3000  # it is rebooted, and its world restarts where it is
            await drive(send, 20, bench.t_s)
            check(0.15)  # what is lost is the motion of two records
            assert bench.pose().segment > before

    def check(within_m: float) -> None:
        fused = bench.pose()
        t_s = bench.t_s - 0.15
        assert fused.pose.position_m == pytest.approx([0.0, north_mps * t_s, -2.0], abs=within_m)
        assert yaw_of(fused) == pytest.approx(math.pi / 2 - yaw)
        assert fused.velocity_mps == pytest.approx([0.0, north_mps, 0.0], abs=0.01)

    run(bench, work)


@asynccontextmanager
async def callers(port: int) -> Any:
    """A sender on TCP: gives a queue of those who have connected."""
    calls: asyncio.Queue[asyncio.StreamWriter] = asyncio.Queue()
    writers: list[asyncio.StreamWriter] = []

    def called(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writers.append(writer)
        calls.put_nowait(writer)

    server = await asyncio.start_server(called, "127.0.0.1", port)
    async with server:
        yield calls
        for writer in writers:
            writer.transport.abort()
        await asyncio.gather(*(w.wait_closed() for w in writers), return_exceptions=True)


async def dvl_drive(
    bench: Bench, send: Send, message: Callable[[Dvl], bytes], messages: int
) -> None:
    dvl = Dvl(latency_us=100_000)
    for _ in range(messages):
        # Messages describe the state 100 ms ago.
        dvl.unix_us = bench.now_ns // 1000 - dvl.latency_us
        bench.attitude()
        await bench.heard(send, message(dvl))
        bench.wait(STEP_S)


def check_dvl(bench: Bench, before_m: float, seconds: float) -> float:
    """The way since then, at 0.4 m/s ahead: east; returns where it is now."""
    x_m = float(bench.pose(0.35).pose.position_m[0])
    assert x_m - before_m == pytest.approx(0.4 * seconds, abs=0.09)
    assert bench.pose(0.35).velocity_mps == pytest.approx([0.4, 0.0, 0.0])
    return x_m


def test_dvl_over_tcp_is_reset_and_comes_back() -> None:
    port = free_tcp_port()
    bench = Bench("water_linked_json", f"tcp://127.0.0.1:{port}")

    async def work() -> None:
        async with callers(port) as calls:
            message = lambda dvl: dvl.velocity((0.4, 0.0, 0.0))  # noqa: E731 two words
            writer = await calls.get()
            await dvl_drive(bench, to(writer), message, 20)
            displacement_m = check_dvl(bench, 0.0, 1.7)
            first = bench.pose(0.35).segment
            await bench.heard(to(writer), Dvl().velocity()[:60])
            writer.transport.abort()
            await until(lambda: bench.link.status.losses == 1)
            bench.wait(10.0)
            assert bench.reason() in ("after_odometry", "no_odometry")
            await dvl_drive(bench, to(await calls.get()), message, 20)
            check_dvl(bench, displacement_m, 1.9)
            assert bench.pose(0.35).segment > first  # nobody knows the way in between
            assert bench.bridge.rejects.total() == 0  # the half report spoilt none after it

    run(bench, work)


def to(writer: asyncio.StreamWriter) -> Send:
    async def send(data: bytes) -> None:
        writer.write(data)
        await writer.drain()

    return send


def test_dvl_on_a_serial_line_is_unplugged_and_comes_back(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mapperd.config.odometry.UDEV_FOLDERS", (tmp_path,))
    plug = tmp_path / "usb-DVL"
    bench = Bench("water_linked_serial", "serial:usb-DVL?baud=115200")

    async def work() -> None:
        with SerialPty() as line:

            async def send(data: bytes) -> None:
                line.send(data)

            message = lambda dvl: dvl.velocity_sentence((0.4, 0.0, 0.0))  # noqa: E731
            plug.symlink_to(line.path)
            await until(lambda: bench.link.status.opened == 1)
            await dvl_drive(bench, send, message, 20)
            displacement_m = check_dvl(bench, 0.0, 1.7)
            plug.unlink()
            line.unplug()
            await until(lambda: bench.link.status.losses == 1)
            bench.wait(10.0)
            assert bench.reason() in ("after_odometry", "no_odometry")
            line.plug()
            plug.symlink_to(line.path)
            await until(lambda: bench.link.status.opened == 2)
            await dvl_drive(bench, send, message, 20)
            check_dvl(bench, displacement_m, 1.9)

    run(bench, work)


def test_nmea_talker_over_tcp_is_cut_and_comes_back() -> None:
    port = free_tcp_port()
    bench = Bench("nmea", f"tcp://127.0.0.1:{port}")
    talker = NmeaTalker()
    minute_m = 1856.94  # one minute of latitude at 60° north, WGS-84

    def stated() -> bytes:
        """North at 0.5 m/s, nose north."""
        seconds = bench.now_ns / S % 60
        talker.time = time.strftime("%H%M", time.gmtime(bench.now_ns // S)) + f"{seconds:05.2f}"
        minutes = 0.5 * bench.t_s / minute_m
        place = ((f"60{minutes:010.7f}", "N"), ("00500.000", "E"))
        return talker.gga(*place, altitude="0.0") + talker.prdid("0.0", "0.0", "0.0")

    def lost(times: int) -> bool:
        return bench.link.status.losses == times

    async def work() -> None:
        async with callers(port) as calls:
            for cuts in (1, 2):
                writer = await calls.get()
                for _ in range(20):
                    await bench.heard(to(writer), stated())
                    bench.wait(STEP_S)
                fused = bench.pose()
                t_s = bench.t_s - 0.15
                assert fused.pose.position_m[:2] == pytest.approx([0.0, 0.5 * t_s], abs=0.02)
                assert yaw_of(fused) == pytest.approx(math.pi / 2)
                writer.write(b"$GPGGA,22")
                await writer.drain()
                writer.close()
                await until(partial(lost, cuts))
                bench.wait(10.0)
                assert bench.reason() == "after_odometry"

    run(bench, work)
