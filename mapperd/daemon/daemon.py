"""The daemon: one session of live mapping, and what it can be asked meanwhile."""

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable, Iterator
from itertools import count
from pathlib import Path
from typing import Any

from mapperd import _core
from mapperd.api import OperationError, PoseRequest, ReportedChanges
from mapperd.config.layers import Layered
from mapperd.config.live import Applied, ConfigStore, Refused, changes_between
from mapperd.config.tree import Config
from mapperd.daemon.localization_service import LocalizationRequests
from mapperd.daemon.map_folder import MapFolder
from mapperd.daemon.problems import activity_of
from mapperd.daemon.session import Live
from mapperd.daemon.sonar_control import SonarControl
from mapperd.daemon.status import Watch, status_of
from mapperd.errors import ConfigError, MapError, Reject, StoreError
from mapperd.events import EventLog, Severity
from mapperd.geometry.geodesy import Origin
from mapperd.imaging.filter_chain import check_filters
from mapperd.localization.models import check_localization
from mapperd.localization.report import localization_report
from mapperd.mapping.queries import MapContent
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.executor import PingExecutor
from mapperd.pipeline.pose_lookup import origin_of
from mapperd.pipeline.watchdog import Worker
from mapperd.session_log import Request, Reset

__all__ = ["Daemon"]

RESET_TIMEOUT_S = 60.0
"""Timeout of a reset request, which waits for the pings before it."""


class Daemon:
    """Implements `mapperd.api.DaemonApi`; runs once.

    Args:
        settings: in force; the daemon follows them.
        sonar_map: the map of `live`.
        live: the session.
        events: what happened.
        read: the settings' files again; raises `ConfigError`.
        folder: for the maps that are asked for.

    Attributes:
        settings, events: as given.
        servers: status functions of the servers by name.
        phase: starting, mapping or stopping.
    """

    def __init__(
        self,
        settings: ConfigStore,
        sonar_map: SonarMap,
        live: Live,
        events: EventLog,
        *,
        read: Callable[[], Layered],
        folder: Path,
    ) -> None:
        self.servers: dict[str, Callable[[], dict[str, Any]]] = {}
        self.phase = "starting"
        self._settings = settings
        self._events = events
        self._changes = ReportedChanges()
        self._map = sonar_map
        self._live = live
        self._read = read
        self._maps = MapFolder(folder, settings)
        self._config = settings.current
        self._began_s = time.monotonic()
        self._numbers = count(1)
        self._localization = LocalizationRequests(settings, events, folder, self._ask)
        self._resets: dict[int, asyncio.Future[StoreError | None]] = {}
        follows = {*PingExecutor.FOLLOWS, *SonarControl.FOLLOWS}
        settings.follow(follows, self._take, self._check)

    @property
    def settings(self) -> ConfigStore:
        """The settings in force; changes go through it."""
        return self._settings

    @property
    def events(self) -> EventLog:
        """What happened."""
        return self._events

    @property
    def changes(self) -> ReportedChanges:
        """As `DaemonApi.changes`."""
        return self._changes

    @property
    def live(self) -> Live:
        """The session."""
        return self._live

    async def run(self, until: Awaitable[Any]) -> None:
        """Map until something else is done.

        Raises:
            ConfigError: a library that a link needs is not installed.
            OculusError: the sonar cannot be looked for.
        """
        loop = asyncio.get_running_loop()
        watch = Watch(self._events, self._live)
        self._live.mapping.on_snapshot = watch.update
        self._live.mapping.on_reset = lambda reset, problem: _in_loop(
            loop, lambda: self._reset_done(reset, problem)
        )
        looking = asyncio.create_task(watch.look())
        self.phase = "mapping"
        text = f"session {self._live.session} begins"
        self._events.add(Severity.INFO, "session_began", text, session=self._live.session)
        try:
            await self._live.run(until)
        finally:
            self.phase = "stopping"
            looking.cancel()
            await asyncio.gather(looking, return_exceptions=True)
            self._refuse_resets()
            self._events.add(Severity.INFO, "session_ended", "mapping has ended")

    def status(self) -> dict[str, Any]:
        """As `DaemonApi.status`."""
        uptime_s = time.monotonic() - self._began_s
        servers = {name: status() for name, status in self.servers.items()}
        status = status_of(self._live, self._map, self._settings.current, uptime_s, servers)
        changes = {"changes": self._changes.plain()}
        return {"phase": self.phase, "activity": activity_of(self.phase, status)} | status | changes

    def workers(self) -> list[Worker]:
        """What each thread has to do and has done, for a watchdog; any thread."""
        live = self._live
        waiting = live.queue.waiting_bytes + live.mapping.waiting
        mapping = Worker("mapping", waiting, live.mapping.steps + _core.finished_parts())
        return [mapping, live.recorder.worker(), live.persistence.worker()]

    async def save(self, name: str, origin: str) -> dict[str, Any]:
        """As `DaemonApi.save`."""
        origin_deg = origin_of(self._config, self._live.poses)
        done = await asyncio.to_thread(
            self._maps.save,
            name,
            self._whole,
            None if origin_deg is None else Origin.of_degrees(*origin_deg),
        )
        text = f"map written to {done['path']} for {origin}"
        facts = {"path": done["path"], "bytes": done["bytes"]}
        self._events.add(Severity.NOTICE, "map_saved", text, **facts)
        return done

    async def reset(self, origin: str) -> dict[str, Any]:
        """As `DaemonApi.reset`."""
        if self.phase != "mapping":
            raise OperationError(f"the daemon is {self.phase}", "busy")
        number = next(self._numbers)
        done: asyncio.Future[StoreError | None] = asyncio.get_running_loop().create_future()
        self._resets[number] = done
        self._live.ingest.order(Reset(number, origin))
        try:
            async with asyncio.timeout(RESET_TIMEOUT_S):
                problem = await done
        except TimeoutError:
            raise OperationError("the pings before it are still being mapped", "busy") from None
        finally:
            self._resets.pop(number, None)
        if problem is not None:
            raise OperationError(f"not emptied: {problem}", "cannot_write")
        self._events.add(Severity.NOTICE, "map_reset", f"map emptied for {origin}", origin=origin)
        return {}

    async def reload(self, origin: str) -> dict[str, Any]:
        """As `DaemonApi.reload`."""
        try:
            reloaded = self._settings.reload(self._read(), origin)
        except ConfigError as error:
            text = f"settings stay as they are: {error}"
            self._events.add(Severity.WARNING, "settings_refused", text)
            return {"changed": {}, "refused": {error.path: str(error)}, "waiting": []}
        refused = dict(reloaded.result.reasons) if isinstance(reloaded.result, Refused) else {}
        changes = reloaded.result.changes if isinstance(reloaded.result, Applied) else ()
        for line in _problems(refused, reloaded.waiting, nothing=not changes):
            self._events.add(Severity.NOTICE, "settings_reloaded", line)
        return {
            "changed": {change.name: change.after for change in changes},
            "refused": refused,
            "waiting": list(reloaded.waiting),
        }

    async def snapshot(self, origin: str) -> dict[str, Any]:
        """As `DaemonApi.snapshot`."""
        began_s = time.monotonic()
        try:
            size = await asyncio.to_thread(self._live.persistence.save)
        except StoreError as error:
            raise OperationError(str(error), "cannot_write") from error
        if size is None:
            raise OperationError("the map is in memory alone: outofcore.use is off", "no_store")
        self._events.add(Severity.INFO, "snapshot", f"snapshot for {origin}", bytes=size)
        return {"bytes": size, "seconds": time.monotonic() - began_s}

    def localization(self, particles: int = 0) -> dict[str, Any]:
        """As `DaemonApi.localization`."""
        facts = self._live.mapping.snapshot.localization
        return localization_report(facts, self._settings.current, particles)

    async def initial_pose(self, asked: PoseRequest, origin: str) -> dict[str, Any]:
        """As `DaemonApi.initial_pose`."""
        return await self._localization.initial_pose(asked, origin)

    async def global_localization(self, origin: str) -> dict[str, Any]:
        """As `DaemonApi.global_localization`."""
        return await self._localization.global_localization(origin)

    async def request_nomotion_update(self, origin: str) -> dict[str, Any]:
        """As `DaemonApi.request_nomotion_update`."""
        return await self._localization.request_nomotion_update(origin)

    async def set_map(self, name: str, asked: PoseRequest | None, origin: str) -> dict[str, Any]:
        """As `DaemonApi.set_map`."""
        return await self._localization.set_map(name, asked, origin)

    async def _ask(self, request: Request) -> Reject | None:
        if self.phase != "mapping":
            return Reject("busy", f"the daemon is {self.phase}")
        return await self._live.request(request)

    def _whole(self) -> MapContent:
        """The map as it is now, to be written as a file; a file with holes would show water."""
        keep = self._live.persistence
        keep.save()  # what is not in the file is not in a file's copy
        whole = keep.whole()
        if lost := whole.bricks_lost:
            whole.close()
            raise MapError(f"{lost} bricks of the map are damaged and not rebuilt", "bricks_lost")
        return whole

    def _check(self, config: Config) -> None:
        """Check whether mapping and the sonar can follow; raises `ConfigError`."""
        check_filters(config)
        check_localization(config)
        self._live.control.check(config)

    def _take(self, config: Config) -> None:
        """Follow the settings, and log changes."""
        before, self._config = self._config, config
        self._live.reconfigure(config)
        for name, value in changes_between(before, config).items():
            text = f"setting {name} is now {value}"
            self._events.add(Severity.NOTICE, "setting_changed", text, name=name, value=value)

    def _reset_done(self, reset: Reset, problem: StoreError | None) -> None:
        done = self._resets.get(reset.number)
        if done is not None and not done.done():
            done.set_result(problem)

    def _refuse_resets(self) -> None:
        for done in self._resets.values():
            if not done.done():
                done.set_result(StoreError("mapping has ended", "closed"))


def _in_loop(loop: asyncio.AbstractEventLoop, what: Callable[[], None]) -> None:
    """Call something in the event loop, unless the loop has ended."""
    with contextlib.suppress(RuntimeError):
        loop.call_soon_threadsafe(what)


def _problems(refused: dict[str, str], waiting: tuple[str, ...], *, nothing: bool) -> Iterator[str]:
    for name, reason in refused.items():
        yield f"settings stay as they are: {name}: {reason}"
    for name in waiting:
        yield f"setting {name}: changed in the files, waits for a restart"
    if nothing and not refused and not waiting:
        yield "settings read again: nothing is new"
