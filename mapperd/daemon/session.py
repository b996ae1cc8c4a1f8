"""The live source of the step: a sonar and a vehicle on the network become a map.

A thin shell of asyncio that only moves bytes: what the links bring goes, in one order, to the
recorder and to the mapping thread, which does what a replay of that recording does.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any

import msgspec

from mapperd import __version__
from mapperd.config.changes import changes_between
from mapperd.config.link_address import parse_address
from mapperd.config.tree import Config, DeviceConfig
from mapperd.daemon.localization_service import Requests
from mapperd.errors import ConfigError, Reject
from mapperd.events import EventLog, Severity
from mapperd.localization.session import LocalizationSession, numbers_of, poses_depend_on
from mapperd.mapping.sonar_map import SonarMap
from mapperd.odometry.bridge import encoding_of
from mapperd.odometry.links import Link
from mapperd.odometry.links import LinkStatus as OdometryStatus
from mapperd.pipeline.backlog import Backlog
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.decoder import SessionDecoder
from mapperd.pipeline.executor import PingExecutor
from mapperd.pipeline.ingest import SONAR, ChunkQueue, Ingest
from mapperd.pipeline.persistence import MapPersistence, MemoryPersistence
from mapperd.pipeline.pose_lookup import FixedPose, OdometryPoses
from mapperd.pipeline.recorder import Recorder
from mapperd.pipeline.snapshot import snapshot_reader
from mapperd.pipeline.step import StepRunner
from mapperd.pipeline.worker import MappingThread
from mapperd.session_log import LINK, Request, Session, Settings
from oculus_driver.link.state import LinkState, LinkStatus
from oculus_driver.settings import FireSettings, Mode, PingRate
from oculus_driver.sonar import OculusSonar

__all__ = ["Live", "fire_settings", "host_clock"]


def host_clock() -> Callable[[], int]:
    """Unix time in nanoseconds that no correction of the host's clock can set back.

    Monotonic time and one offset, so that senders may stamp with Unix time.
    """
    offset_ns = time.time_ns() - time.monotonic_ns()
    return lambda: time.monotonic_ns() + offset_ns


def fire_settings(device: DeviceConfig) -> FireSettings:
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
    """One session: one sonar and one vehicle on their way into one map; runs once.

    Args:
        sonar_map: where the pings go; its settings say where the links are.
        poses: fixed, or from the vehicle's odometry; fresh.
        session: id of the session, in its recordings.
        events: is told what the links do; may be none.
        keep: of the map; None keeps it in memory.
        clock: nanoseconds, of all arrivals.
        localizing: begun; None is off.

    Raises:
        ConfigError: the folder of the recordings cannot be used, two sources share a link, or a
            source has the name of another link.

    Attributes:
        session: as given.
        mapping: the thread of the pings, with its facts.
        counters: of the pings.
        links: of the odometry.
        recorder, inlet, queue: of all that comes in.
        keep: of the map.
        localizing: as given.
    """

    def __init__(
        self,
        sonar_map: SonarMap,
        poses: FixedPose | OdometryPoses,
        *,
        session: str = "",
        events: EventLog | None = None,
        keep: MapPersistence | None = None,
        clock: Callable[[], int] | None = None,
        localizing: LocalizationSession | None = None,
    ) -> None:
        config = sonar_map.config
        _require_own_links(config)
        self.session = session
        self.keep: MapPersistence = MemoryPersistence(sonar_map) if keep is None else keep
        self.counters = PipelineCounters()
        self.localizing = localizing
        self._config = config
        self._poses = poses
        self._events = events
        self._clock = clock or host_clock()
        self._fresh = False
        self.queue = ChunkQueue()
        self.recorder = Recorder(config, session, self._clock)
        encodings = {source.name: encoding_of(source) for source in config.odometry.sources}
        self.inlet = Ingest(self.recorder, self.queue, encodings, self._clock)
        self.mapping = self._mapping(sonar_map)
        self._requests = Requests(self.inlet, None if localizing is None else localizing.maps)
        self.links = self._odometry_links()
        self._sonar = OculusSonar(
            config.device.address or None,
            fire_settings(config.device),
            serial=config.device.serial or None,
            port=config.device.port,
            on_bytes=self._take_sonar,
            on_state=self._tell_sonar,
            clock=self._clock,
            max_pings=1,  # the driver looks at pings for its own purposes; we take the bytes
        )

    async def run(self, until: Awaitable[Any]) -> None:
        """Map until something else is done, then put the sonar into standby.

        Args:
            until: what to wait for.

        Raises:
            ConfigError: a library that a link needs is not installed.
            OculusError: the sonar cannot be looked for.
        """
        ended = self._when_mapping_ends()
        end = asyncio.ensure_future(until)
        links = [asyncio.create_task(link.run()) for link in self.links]
        async with self.recorder:
            mapping = self.mapping
            self.keep.begin(
                mapping.engine,
                self.recorder,
                self.queue.wake,
                poses_depend_on(self.localizing),
            )
            self.inlet.order(self._beginning())
            self._requests.open()
            mapping.on_request = self._requests.done
            mapping.start()
            try:
                async with self._sonar:
                    await _first_of(end, self._watch(), asyncio.shield(ended), *links)
            finally:
                for link in links:
                    link.cancel()
                await asyncio.gather(*links, return_exceptions=True)
                self.queue.close()
                self._requests.close()
                await ended  # never cancelled: a step that has begun in its thread goes on anyway
        if self.mapping.failure is not None:
            raise self.mapping.failure

    def take(self, config: Config) -> None:
        """Map with other settings from the next bytes on; any thread.

        Args:
            config: differs from the settings before in those that `StepRunner.FOLLOWS` names, and
                has passed `check_filters`.
        """
        values = changes_between(self._config, config)
        self._config = config
        if values:
            self.inlet.order(Settings(values))

    async def ask(self, request: Request) -> Reject | None:
        """Ask localization for something, as an order that is recorded; returns why not.

        The event loop's alone. It is done between two pings, so that it may take a while.

        Args:
            request: its number, and a map's fingerprint, are put in here.

        Raises:
            MapError: the map cannot be loaded; nothing was ordered.
        """
        return await self._requests.ask(request)

    @property
    def poses(self) -> FixedPose | OdometryPoses:
        """Where the poses come from."""
        return self._poses

    @property
    def link(self) -> LinkStatus:
        """What the link to the sonar does."""
        return self._sonar.link

    @property
    def sonar(self) -> OculusSonar:
        """The sonar."""
        return self._sonar

    def _mapping(self, sonar_map: SonarMap) -> MappingThread:
        engine = SessionDecoder(
            sonar_map.config, self._poses, self.counters, confirm=False, obey=True
        )
        stepping = StepRunner(sonar_map, time.perf_counter, self.counters)
        onboard = None if self.localizing is None else self.localizing.onboard
        return MappingThread(
            self.queue,
            engine,
            PingExecutor(stepping, self.keep, onboard=onboard),
            Backlog(sonar_map.config.behind),
            remark=self.inlet.remark,
            clock=self._clock,
            facts_of=snapshot_reader(self._poses, self._clock),
            keep=self.keep,
        )

    def _odometry_links(self) -> list[Link]:
        return [
            Link(
                source.name,
                parse_address(source.link),
                partial(self.inlet.bytes_came, source.name),
                self._clock,
                self._tell_link,
            )
            for source in self._config.odometry.sources
        ]

    def _beginning(self) -> Session:
        """Everything that a replay needs to map this session as it is mapped."""
        pose = self._poses.pose if isinstance(self._poses, FixedPose) else None
        settings = msgspec.to_builtins(self._config)
        place = None if pose is None else (*pose.position_m.tolist(), *pose.map_q_base.tolist())
        begun = self.localizing
        saved = None if begun is None else numbers_of(begun.saved)
        sha256 = "" if begun is None else begun.map_sha256
        return Session(self.session, __version__, settings, place, saved, sha256)

    def _when_mapping_ends(self) -> "asyncio.Future[None]":
        loop = asyncio.get_running_loop()
        ended: asyncio.Future[None] = loop.create_future()

        def tell() -> None:
            loop.call_soon_threadsafe(ended.set_result, None)

        self.mapping.on_end = tell
        return ended

    async def _watch(self) -> None:
        """Raise what goes wrong with the sonar's link."""
        async for _ in self._sonar.pings():
            pass

    def _take_sonar(self, data: bytes, arrival_ns: int) -> None:
        gap, self._fresh = self._fresh, False
        self.inlet.bytes_came(SONAR, data, arrival_ns, gap=gap)

    def _tell_sonar(self, status: LinkStatus) -> None:
        # Bytes of a new connection do not join the old ones.
        self._fresh = self._fresh or status.state == LinkState.CONNECTING
        if self._events is not None:
            text = f"sonar: {status.state}: {status.reason}"
            facts = {"state": str(status.state), "address": status.address}
            self._events.add(Severity.NOTICE, "sonar_link", text, **facts)

    def _tell_link(self, name: str, status: OdometryStatus) -> None:
        if self._events is not None:
            text = f"{name}: {status.phase}: {status.reason}"
            facts = {"link": name, "state": str(status.phase)}
            self._events.add(Severity.NOTICE, "odometry_link", text, **facts)


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
    """Two sources cannot listen at one address, nor have the name of another link."""
    used: dict[str, str] = {}
    for source in config.odometry.sources:
        if source.name in (SONAR, "status", LINK):
            raise ConfigError(
                f"a source cannot have the name {source.name!r}: that is another link's",
                "$.odometry.sources",
            )
        other = used.setdefault(source.link, source.name)
        if other != source.name:
            raise ConfigError(
                f"sources {other!r} and {source.name!r} share the link {source.link}; "
                "allowed: one each",
                "$.odometry.sources",
            )
