"""The live source of the step: a sonar and a vehicle on the network become a map.

A thin shell of asyncio: the driver brings pings, links bring odometry, both are stamped by
one clock, and what is settled goes through the step in a thread, one ping after the other.
"""

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any

from mapperd.config import Config, Device
from mapperd.errors import ConfigError
from mapperd.links.address import parse_address
from mapperd.links.link import Link
from mapperd.links.state import LinkStatus as OdometryStatus
from mapperd.mapping import SonarMap
from mapperd.pairing import PoseSource, ping_time_ns
from mapperd.recorder import Recorder
from mapperd.reject import Reject
from mapperd.stepping import Stepping
from oculus_driver.clock import SonarClock
from oculus_driver.link_state import LinkStatus
from oculus_driver.ping import Ping
from oculus_driver.settings import FireSettings, Mode, PingRate
from oculus_driver.sonar import OculusSonar
from oculus_driver.wire import MessageId

__all__ = ["Live", "fire_settings", "host_clock"]

LOOK_S = 0.1
"""So often pings are looked through that wait for odometry which may never come."""

MOST_WAITING_BYTES = 64 * 1024 * 1024
"""With so many samples waiting, pings stay in the driver's queue, which drops the oldest."""


def host_clock() -> Callable[[], int]:
    """Unix time in nanoseconds that no correction of the host's clock can set back.

    Monotonic time and one offset, so that senders may stamp with Unix time.
    """
    offset_ns = time.time_ns() - time.monotonic_ns()
    return lambda: time.monotonic_ns() + offset_ns


def fire_settings(device: Device) -> FireSettings:
    """What the sonar is asked for.

    Raises:
        SettingsError: something that the driver cannot ask for.
    """
    return FireSettings(
        mode=Mode(device.mode),
        ping_rate=PingRate[device.ping_rate.upper()],
        range_m=device.range,
        gain_percent=device.gain,
        beams=device.beams,
    )


class Live:
    """One sonar and one vehicle on their way into one map; runs once.

    Args:
        sonar_map: where the pings go; its settings say where the links are.
        poses: fixed, or from the vehicle's odometry.
        on_state: is told what the link to the sonar does.
        on_link: is told what the links of the odometry do.
        clock: nanoseconds, of all arrivals.

    Raises:
        ConfigError: the folder of the recordings cannot be used, or two sources share a link.

    Attributes:
        stepping: the way of the pings, with its counters.
        sonar_clock: places pings in time.
        links: of the odometry.
        recorder: of all that comes in.
    """

    def __init__(
        self,
        sonar_map: SonarMap,
        poses: PoseSource,
        on_state: Callable[[LinkStatus], None] | None = None,
        on_link: Callable[[str, OdometryStatus], None] | None = None,
        clock: Callable[[], int] | None = None,
    ) -> None:
        config = sonar_map.config
        self.stepping = Stepping(sonar_map, poses, time.perf_counter)
        self.sonar_clock = SonarClock(latency_ns=round(config.device.latency_sec * 1e9))
        self._config = config
        self._poses = poses
        self._clock = clock or host_clock()
        _require_own_links(config)
        self.links = [
            Link(
                source.name,
                parse_address(source.link),
                partial(self._take_odometry, source.name),
                self._clock,
                on_link,
            )
            for source in config.odometry.sources
        ]
        self.recorder = Recorder(config)
        self._on_state = on_state
        self._news = asyncio.Event()
        self._room = asyncio.Event()
        self._stopping = False
        self._sonar = OculusSonar(
            config.device.address or None,
            fire_settings(config.device),
            serial=config.device.serial or None,
            port=config.device.port,
            on_bytes=self.recorder.sonar_bytes,
            on_state=self._tell_state,
            clock=self._clock,
        )

    async def run(self, until: Awaitable[Any]) -> None:
        """Map until something else is done, then put the sonar into standby.

        Args:
            until: what to wait for.

        Raises:
            ConfigError: a library that a link needs is not installed.
            OculusError: the sonar cannot be looked for.
        """
        end = asyncio.ensure_future(until)
        links = [asyncio.create_task(link.run()) for link in self.links]
        mapping = asyncio.create_task(self._map_on())
        try:
            async with self.recorder, self._sonar:
                await _first_of(end, self._receive(), asyncio.shield(mapping), *links)
            async for ping in self._sonar.pings():  # what came while it was made quiet
                self._offer(ping)
        finally:
            for link in links:
                link.cancel()
            await asyncio.gather(*links, return_exceptions=True)
            self._stopping = True
            self._news.set()
            await mapping  # never cancelled: a step that has begun in its thread goes on anyway
        await self._map_settled(None, final=True)
        self._count()

    @property
    def link(self) -> LinkStatus:
        """What the link to the sonar does."""
        return self._sonar.link

    def _tell_state(self, status: LinkStatus) -> None:
        self.recorder.sonar_link(status)
        if self._on_state is not None:
            self._on_state(status)

    def _take_odometry(self, name: str, data: bytes, arrival_ns: int, *, gap: bool) -> None:
        self.recorder.link_bytes(name, data, arrival_ns, gap=gap)
        self._poses.add_odometry(name, data, arrival_ns, gap_before=gap)
        self._news.set()

    async def _receive(self) -> None:
        """Let pings wait for their poses, as long as there is room."""
        async for ping in self._sonar.pings():
            self._offer(ping)
            while self._poses.waiting_bytes > MOST_WAITING_BYTES:
                self._room.clear()
                await self._room.wait()

    def _offer(self, ping: Ping) -> None:
        """Let a ping wait for the pose of its time, told by the sonar's clock if it has one."""
        self.stepping.offer(ping, ping_time_ns(ping, self.sonar_clock))
        self._news.set()

    async def _map_on(self) -> None:
        while not self._stopping:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(LOOK_S):
                    await self._news.wait()
            self._news.clear()
            await self._map_settled(self._clock())

    async def _map_settled(self, now_ns: int | None, *, final: bool = False) -> None:
        for ping, pose in self._poses.settled(now_ns, final=final):
            # The core works without the interpreter's lock: meanwhile the links are read on.
            await asyncio.to_thread(self.stepping.step, ping, pose)
            self._room.set()

    def _count(self) -> None:
        """Add what the driver counted; what it had to drop was a ping too."""
        heard, counters = self._sonar.counters, self.stepping.counters
        for _ in range(heard.dropped):
            self.stepping.offer(Reject("too_slow", "pings came faster than they could be mapped"))
        for _ in range(heard.messages.get(MessageId.PING_RESULT, 0) - heard.pings):
            self.stepping.offer(Reject("bad_ping", "came twice, or see messages_rejected"))
        counters.bytes_total = heard.bytes_received
        counters.bytes_rejected = heard.bytes_rejected
        counters.resyncs = heard.resyncs
        counters.messages_rejected.update(heard.rejects)
        counters.pings_lost = heard.lost_pings


async def _first_of(*works: Awaitable[Any]) -> None:
    """Run until one of these ends, cancel the others, and raise what one of them raised."""
    tasks = [asyncio.ensure_future(work) for work in works]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        outcomes = await asyncio.gather(*tasks, return_exceptions=True)
    for outcome in outcomes:
        if isinstance(outcome, Exception):
            raise outcome


def _require_own_links(config: Config) -> None:
    """Two sources cannot listen at one address."""
    used: dict[str, str] = {}
    for source in config.odometry.sources:
        other = used.setdefault(source.link, source.name)
        if other != source.name:
            raise ConfigError(
                f"sources {other!r} and {source.name!r} share the link {source.link}; "
                "allowed: one each",
                "$.odometry.sources",
            )
