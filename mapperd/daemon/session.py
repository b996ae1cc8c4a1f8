"""A live session: maps one sonar and one vehicle on the network.

The event loop only passes bytes on, in one order, to the recorder and to the mapping thread. The
mapping thread does what a replay of the recording does.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any, Never

import msgspec

from mapperd import __version__
from mapperd.config.live import changes_between
from mapperd.config.odometry import parse_address
from mapperd.config.tree import Config
from mapperd.daemon.localization_service import Requests
from mapperd.daemon.sonar_control import SonarControl, fire_settings
from mapperd.errors import ConfigError, Reject
from mapperd.events import EventLog, Severity
from mapperd.localization.session import LocalizationSession, numbers_of, poses_depend_on
from mapperd.mapping.sonar_map import SonarMap
from mapperd.odometry.bridge import encoding_of
from mapperd.odometry.links import OdometryLink, OdometryLinkStatus
from mapperd.pipeline.backlog import Backlog
from mapperd.pipeline.build import build_pipeline
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.ingest import SONAR, STATUS, ChunkQueue, Ingest
from mapperd.pipeline.persistence import MapPersistence, MemoryPersistence
from mapperd.pipeline.pose_lookup import FixedPose, OdometryPoses
from mapperd.pipeline.recorder import Recorder
from mapperd.pipeline.worker import MappingThread, snapshot_reader
from mapperd.session_log import LINK, ClockSet, Remarks, Request, Session, Settings
from oculus_driver.link.state import LinkState, LinkStatus
from oculus_driver.recording.sonar_log import MAX_CLOCK_ERROR_NS
from oculus_driver.sonar import OculusSonar
from oculus_driver.stream import Framing

__all__ = ["Live", "host_clock"]


CLOCK_INTERVAL_S = 1.0
"""Interval between two looks at the host's clock."""


def host_clock() -> Callable[[], int]:
    """Return a clock of Unix time in nanoseconds that never goes back.

    It is the monotonic clock with a constant offset, so that senders may stamp with Unix time.
    """
    offset_ns = unix_offset_ns()
    return lambda: time.monotonic_ns() + offset_ns


def unix_offset_ns() -> int:
    """Return the offset from the monotonic clock to Unix time; it changes if the clock is set."""
    return time.time_ns() - time.monotonic_ns()


class Live:
    """One session that maps one sonar and one vehicle; runs once.

    Args:
        sonar_map: the map; its settings name the links.
        poses: fixed, or from the vehicle's odometry; fresh.
        session: id of the session for its recordings.
        events: receives the state changes of the links; may be None.
        persistence: of the map; None keeps it in memory.
        clock: of all arrivals, nanoseconds.
        localization: started; None where it is off.

    Raises:
        ConfigError: the recordings folder cannot be used, two sources share a link, or a source
            has the name of another link.

    Attributes:
        session, persistence, localization: as given.
        mapping: the mapping thread, with its snapshot.
        counters: of the pings.
        links: odometry links.
        recorder, ingest, queue: of all input.
        control: applies changed settings to the sonar.
    """

    def __init__(
        self,
        sonar_map: SonarMap,
        poses: FixedPose | OdometryPoses,
        *,
        session: str = "",
        events: EventLog | None = None,
        persistence: MapPersistence | None = None,
        clock: Callable[[], int] | None = None,
        localization: LocalizationSession | None = None,
    ) -> None:
        config = sonar_map.config
        _require_own_links(config)
        self.session = session
        self.persistence: MapPersistence = persistence or MemoryPersistence(sonar_map)
        self.counters = PipelineCounters()
        self.localization = localization
        self._config = config
        self._poses = poses
        self._events = events
        self.now_ns = clock or host_clock()
        self._is_new_connection = False
        self._start_offset_ns = unix_offset_ns()
        self.queue = ChunkQueue()
        self.recorder = Recorder(config, session, self.now_ns)
        encodings = {source.name: encoding_of(source) for source in config.odometry.sources}
        self.ingest = Ingest(self.recorder, self.queue, encodings, self.now_ns)
        self.mapping = self._mapping_thread(sonar_map)
        self._requests = Requests(self.ingest, None if localization is None else localization.maps)
        self.links = self._odometry_links()
        self._sonar = OculusSonar(
            config.device.address or None,
            fire_settings(config),
            serial=config.device.serial or None,
            port=config.device.port,
            on_framing=self._receive_sonar,
            on_status=partial(self.ingest.receive, STATUS, gap=False),
            on_state=self._log_sonar_state,
            clock=self.now_ns,
            max_pings=1,  # nobody reads them: the mapping thread decodes its messages
        )
        self.control = SonarControl(self._sonar, config, events)

    async def run(self, until: Awaitable[Any]) -> None:
        """Map until `until` is done, then put the sonar into standby.

        Args:
            until: the end of the session.

        Raises:
            ConfigError: a library for a link is not installed.
            OculusError: the sonar cannot be discovered.
        """
        ended = self._when_mapping_ends()
        end = asyncio.ensure_future(until)
        links = [asyncio.create_task(link.run()) for link in self.links]
        links.append(asyncio.create_task(self._watch_clock()))
        async with self.recorder:
            mapping = self.mapping
            self.persistence.begin(
                mapping.pipeline.decoder,
                self.recorder,
                self.queue.wake,
                poses_depend_on(self.localization),
            )
            self.ingest.order(self._beginning())
            self._requests.open()
            mapping.on_request = self._requests.done
            mapping.start()
            try:
                async with self._sonar:
                    works = (self._watch(), self.control.run())
                    await _first_of(end, *works, asyncio.shield(ended), *links)
            finally:
                for link in links:
                    link.cancel()
                await asyncio.gather(*links, return_exceptions=True)
                self.queue.close()
                self._requests.close()
                await ended  # not cancellable: the thread finishes its work in any case
        if self.mapping.failure is not None:
            raise self.mapping.failure

    def reconfigure(self, config: Config) -> None:
        """Map with other settings from the next bytes on; any thread.

        Args:
            config: differs from the present settings only in those of `PingExecutor.FOLLOWS` and
                `SonarControl.FOLLOWS`, and has passed `check_filters` and `control.check`.
        """
        values = changes_between(self._config, config)
        self._config = config
        if values:
            self.ingest.order(Settings(values))
        if values.keys() & {*SonarControl.FOLLOWS}:
            self.control.request(config)

    async def request(self, request: Request) -> Reject | None:
        """Record a request and pass it to localization; return why it was refused.

        Only for the event loop. The mapping thread serves requests between two pings, so this may
        take a while.

        Args:
            request: without its number, and without the fingerprint of a map.

        Raises:
            MapError: the map cannot be loaded; nothing was requested.
        """
        return await self._requests.request(request)

    @property
    def poses(self) -> FixedPose | OdometryPoses:
        """Source of the poses."""
        return self._poses

    @property
    def config(self) -> Config:
        """The settings in force."""
        return self._config

    @property
    def link(self) -> LinkStatus:
        """State of the link to the sonar."""
        return self._sonar.link

    @property
    def sonar(self) -> OculusSonar:
        """The sonar."""
        return self._sonar

    def _mapping_thread(self, sonar_map: SonarMap) -> MappingThread:
        pipeline = build_pipeline(
            sonar_map,
            self._poses,
            localization=None if self.localization is None else self.localization.stage,
            persistence=self.persistence,
            remarks=Remarks(),
            counters=self.counters,
        )
        return MappingThread(
            self.queue,
            pipeline,
            Backlog(sonar_map.config.behind),
            self.persistence,
            remark=self.ingest.remark,
            clock=self.now_ns,
            read_snapshot=snapshot_reader(self.now_ns),
        )

    def _odometry_links(self) -> list[OdometryLink]:
        return [
            OdometryLink(
                source.name,
                parse_address(source.link),
                partial(self.ingest.receive, source.name),
                self.now_ns,
                self._log_link_state,
                decoded=partial(self._poses.decoded, source.name),
            )
            for source in self._config.odometry.sources
        ]

    def _beginning(self) -> Session:
        """Return everything that a replay needs to repeat this session."""
        pose = self._poses.pose if isinstance(self._poses, FixedPose) else None
        settings = msgspec.to_builtins(self._config)
        place = None if pose is None else (*pose.position_m.tolist(), *pose.map_q_base.tolist())
        localization = self.localization
        saved = None if localization is None else numbers_of(localization.saved)
        sha256 = "" if localization is None else localization.map_sha256
        return Session(self.session, __version__, settings, place, saved, sha256)

    def _when_mapping_ends(self) -> "asyncio.Future[None]":
        loop = asyncio.get_running_loop()
        ended: asyncio.Future[None] = loop.create_future()

        def notify() -> None:
            loop.call_soon_threadsafe(ended.set_result, None)

        self.mapping.on_end = notify
        return ended

    async def _watch_clock(self) -> Never:
        """Record and log each time the host's clock is set, as on a host without a clock chip."""
        known_ns = 0
        while True:
            offset_ns = unix_offset_ns() - self._start_offset_ns
            if abs(offset_ns - known_ns) > MAX_CLOCK_ERROR_NS:
                known_ns = offset_ns
                self.ingest.remark(ClockSet(offset_ns))
                if self._events is not None:
                    text = (
                        f"the host's clock was set: it is {offset_ns / 1e9:+.1f} s from the stamps "
                        "of this session, which keep the clock of its start"
                    )
                    self._events.add(Severity.WARNING, "clock_set", text, offset_s=offset_ns / 1e9)
            await asyncio.sleep(CLOCK_INTERVAL_S)

    async def _watch(self) -> None:
        """Raise errors of the sonar's link."""
        await self._sonar.wait_for(LinkState.CLOSED)

    def _receive_sonar(self, data: bytes, arrival_ns: int, framing: Framing) -> None:
        gap, self._is_new_connection = self._is_new_connection, False
        self.ingest.receive(SONAR, data, arrival_ns, framing, gap=gap)

    def _log_sonar_state(self, status: LinkStatus) -> None:
        # The bytes of a new connection do not continue those of the previous one.
        self._is_new_connection |= status.state == LinkState.CONNECTING
        if self._events is not None:
            text = f"sonar: {status.state}: {status.reason}"
            facts = {"state": str(status.state), "address": status.address}
            self._events.add(Severity.NOTICE, "sonar_link", text, **facts)

    def _log_link_state(self, name: str, status: OdometryLinkStatus) -> None:
        if self._events is not None:
            text = f"{name}: {status.phase}: {status.reason}"
            facts = {"link": name, "state": str(status.phase)}
            self._events.add(Severity.NOTICE, "odometry_link", text, **facts)


async def _first_of(*works: Awaitable[Any]) -> None:
    """Run until one awaitable ends, cancel the others, and raise the error of one."""
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
    """Refuse two sources at one address, and a source with the name of another link."""
    used: dict[str, str] = {}
    for source in config.odometry.sources:
        if source.name in (SONAR, STATUS, LINK):
            raise ConfigError(
                f"a source cannot have the name {source.name!r}: it is reserved",
                "$.odometry.sources",
            )
        other = used.setdefault(source.link, source.name)
        if other != source.name:
            raise ConfigError(
                f"sources {other!r} and {source.name!r} share the link {source.link}; "
                "allowed: one each",
                "$.odometry.sources",
            )
