"""`mapperd` without a recording: map live data until stopped."""

import asyncio
import contextlib
import ctypes
import os
import secrets
import signal
import socket
import sys
import time
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

from mapperd.config.layers import Layered
from mapperd.config.live import ConfigStore
from mapperd.config.paths import map_path, pose_path, recordings_folder, state_folder
from mapperd.config.tree import Config
from mapperd.daemon.daemon import Daemon
from mapperd.daemon.localization_service import PoseKeeper
from mapperd.daemon.map_folder import localization_summary, summary_of
from mapperd.daemon.servers import serving, stream_server
from mapperd.daemon.session import Live, host_clock
from mapperd.daemon.supervisor import is_main_thread, supervised
from mapperd.daemon.systemd import Journal, Notifier, goes_to_journal, inherited_sockets, watchdog_s
from mapperd.errors import ConfigError, MapError, StoreError
from mapperd.events import EventLog, Severity
from mapperd.export.trajectory import TrajectoryWriter
from mapperd.geometry.gaussian import PlanarGaussian
from mapperd.localization.report import state_of
from mapperd.localization.saved_pose import load_pose
from mapperd.localization.session import LocalizationSession, begun
from mapperd.localization.status import LocalizationSnapshot
from mapperd.mapping.queries import MapContent
from mapperd.pipeline.pose_lookup import FixedPose, OdometryPoses
from mapperd.pipeline.recorder import Recorder
from mapperd.pipeline.watchdog import process_progress
from mapperd.server.map_source import MapSource
from mapperd.server.stream_server import StreamServer
from mapperd.session.startup import OpenMap, open_map
from oculus_driver.recording.log_files import free_bytes_of

__all__ = ["LiveRun", "map_live"]

STDERR = 2

MIN_FREE_BYTES = 64 << 20
"""On the disk of the map file, for the beginning of a session."""

STATUS_PERIOD_S = 10.0
"""Period of status lines."""

Printer = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class LiveRun:
    """How a live session is run.

    Attributes:
        settings: in force.
        poses: makes what gives poses: fixed, or from the vehicle's odometry.
        duration_s: seconds to map; None is until somebody stops it.
        print_line: prints status lines, in addition to events.
        read: the settings' files again; raises `ConfigError`.
        notifier: of the service manager.
        trajectory: receives the poses of the mapped pings.
    """

    settings: ConfigStore
    poses: Callable[[Config], FixedPose | OdometryPoses]
    duration_s: float | None
    print_line: Printer
    read: Callable[[], Layered]
    notifier: Notifier
    trajectory: TrajectoryWriter


FOLLOWS = ("visualization.tile_save_interval",)
"""Live settings of the map on disk."""


def map_live(run: LiveRun) -> tuple[MapContent, dict[str, Any]]:
    """Map until SIGINT, SIGTERM or the end of the time; return the map, open, and the summary.

    Raises:
        ConfigError: a library that a link needs is not installed, or the settings are wrong.
        LiveError: an address cannot be listened on.
        OculusError: the sonar cannot be looked for, or not be configured as the settings require.
        StoreError: the map's file cannot be used.
    """
    keep_large_pieces_apart()
    if run.settings.current.outofcore.use and is_main_thread():
        # A recovery takes long and resumes at the next start: do not wait for it.
        signal.signal(signal.SIGINT, lambda number, _: _end_at_once(run, number))
    return asyncio.run(_map(run))


async def _map(run: LiveRun) -> tuple[MapContent, dict[str, Any]]:
    clock = host_clock()
    events = EventLog(clock)
    to_journal = goes_to_journal(os.environ, STDERR)
    events.listen(Journal(sys.stderr, time.monotonic, priorities=to_journal).write)
    session = secrets.token_hex(8)
    run.settings.follow(FOLLOWS, lambda _: None)  # looked up at every save
    # The end of a session that was cut short may be long.
    with run.notifier.extended_timeout(process_progress):
        opened = await asyncio.to_thread(
            open_map,
            run.settings.current,
            session,
            events,
            os.environ,
            lambda: run.settings.current.visualization.tile_save_interval,
        )
    try:
        _keep_origin(run.settings, opened)
        localization = await asyncio.to_thread(_start_localization, run.settings.current, events)
        live = Live(
            opened.sonar_map,
            run.poses(run.settings.current),
            session=session,
            events=events,
            persistence=opened.persistence,
            clock=clock,
            localization=localization,
        )
        _require_space(run.settings.current, live, opened, events)
        source, wall_s = await _served(run, opened, live, events, clock)
    finally:
        opened.close()
    _return_free_memory()  # of all threads, before this one makes the results
    with run.notifier.extended_timeout(process_progress):
        whole = opened.persistence.whole()
        if (stored := opened.persistence.status()) is not None:
            source["store"] = store_facts(stored, whole)
        return whole, summary_of(source, whole, live.poses, live.counters, wall_s)


def store_facts(stored: dict[str, Any], whole: MapContent) -> dict[str, Any]:
    """Return what the summary states of the map's file.

    Args:
        stored: status of its persistence, after the end.
        whole: the whole map.
    """
    named = ("path", "sessions_not_mapped", "data_lost", "loss")
    return {name: stored[name] for name in named} | {"bricks_lost": whole.bricks_lost}


def _require_space(config: Config, live: Live, opened: OpenMap, events: EventLog) -> None:
    """Refuse a session that cannot be kept, or log it if the settings allow it.

    Raises:
        StoreError: its recording or its map has no space (`disk_full`).
    """
    problem = live.recorder.shortage()
    store = opened.persistence.store
    if problem is None and store is not None and free_bytes_of(store.path.parent) < MIN_FREE_BYTES:
        problem = f"{store.path}: less than {MIN_FREE_BYTES >> 20} MiB are free for the map"
    if problem is None:
        return
    text = f"no space to keep a session: {problem}"
    if config.recording.require_space:
        remedy = "delete files or choose another disk; recording.require_space: false allows it"
        raise StoreError(f"{text}; {remedy}", "disk_full")
    events.add(Severity.ERROR, "no_space", text)


async def _served(
    run: LiveRun, opened: OpenMap, live: Live, events: EventLog, clock: Callable[[], int]
) -> tuple[dict[str, Any], float]:
    """Map, and serve requests meanwhile; return where the pings came from, and the seconds."""
    folder = state_folder(run.settings.current, os.environ)
    daemon = Daemon(
        run.settings, opened.sonar_map, live, events, read=run.read, folder=folder / "maps"
    )
    stop = asyncio.Event()
    inherited = inherited_sockets(os.environ, os.getpid())
    async with contextlib.AsyncExitStack() as stack:
        server = _server(run, opened, daemon, stack, clock=clock, inherited=inherited)
        daemon.servers["stream"] = server.status
        await stack.enter_async_context(serving(daemon, folder, os.environ, clock))
        await stack.enter_async_context(server)
        feeding = supervised(
            daemon,
            daemon.workers,
            run.notifier,
            watchdog_s=watchdog_s(os.environ, os.getpid()),
            stop=stop.set,
            abandon=partial(_end_at_once, run, recorder=live.recorder),
            print_line=run.print_line,
        )
        await stack.enter_async_context(feeding)
        live.mapping.pipeline.executor.on_mapped = run.trajectory.add
        for task in (_print_status(live, run.print_line), free_memory(run.trajectory)):
            stack.callback(asyncio.create_task(task).cancel)
        await stack.enter_async_context(_poses_kept(run.settings, live, events, clock))
        began_s = time.perf_counter()
        await daemon.run(_until(stop, run.duration_s))
        wall_s = time.perf_counter() - began_s
        source = {"live": _live_facts(daemon, stop_requested=stop.is_set())}
        source |= opened.sonar_map.rule_facts()
        if (snapshot := live.mapping.snapshot.localization) is not None:
            source |= localization_summary(snapshot)
    return source, wall_s


def _end_at_once(run: LiveRun, signal_number: int, recorder: Recorder | None = None) -> NoReturn:
    """End the process without waiting for its threads; state what becomes of the map."""
    run.print_line(f"ended at once: {kept_at_once(run.settings.current, recorder)}")
    os._exit(128 + signal_number)


def kept_at_once(config: Config, recorder: Recorder | None) -> str:
    """Return in one line what a session leaves that ends at any moment.

    Args:
        config: the settings.
        recorder: of the session; None before it has begun, while recordings are mapped.
    """
    lost = "" if recorder is None else recorder.lost_at_once
    if not config.recording.enabled and recorder is not None:
        lost = "recording.enabled is off"
    if config.outofcore.use:
        rest = (
            f"what came after that is lost where it is not recorded: {lost}"
            if lost
            else "the next start maps the rest of the recording"
        )
        return f"the map is in {map_path(config, os.environ)} as it was saved last; {rest}"
    if not config.recording.enabled:
        return "the map was in memory and is lost, and recording.enabled is off"
    folder = recordings_folder(config, os.environ)
    rest = f"; they lack a part: {lost}" if lost else ""
    return (
        f"the map was in memory and is lost; its recordings are in {folder}: mapperd --replay{rest}"
    )


def _server(
    run: LiveRun,
    opened: OpenMap,
    daemon: Daemon,
    stack: contextlib.AsyncExitStack,
    *,
    clock: Callable[[], int],
    inherited: Mapping[str, socket.socket],
) -> StreamServer:
    """The server of clients, with the map that it serves."""
    live = daemon.live
    source = MapSource(
        opened.sonar_map,
        opened.persistence,
        log_odds_step=run.settings.current.stream.log_odds_step,
        origin_deg=lambda: live.poses.origin_deg,
    )
    stack.enter_context(source)
    return stream_server(daemon, live, source, os.environ, now_ns=clock, inherited=inherited)


@contextlib.asynccontextmanager
async def _poses_kept(
    settings: ConfigStore, live: Live, events: EventLog, clock: Callable[[], int]
) -> AsyncIterator[None]:
    """Save the estimated pose meanwhile, and at the end."""
    if live.localization is None:
        yield
        return
    keeper = PoseKeeper(
        pose_path(settings.current, os.environ),
        lambda: live.mapping.snapshot.localization,
        lambda: settings.current.amcl,
        clock,
        events,
    )
    saving = asyncio.create_task(keeper.run())
    try:
        yield
    finally:
        saving.cancel()
        await asyncio.gather(saving, return_exceptions=True)
        await asyncio.to_thread(keeper.save)


def _keep_origin(settings: ConfigStore, opened: OpenMap) -> None:
    """A continued map keeps the origin of its first session."""
    if opened.origin_deg is None or settings.current.odometry.origin is not None:
        return
    latitude, longitude = opened.origin_deg
    value = {"latitude": latitude, "longitude": longitude}
    opened.sonar_map.reconfigure(settings.settle("odometry.origin", value, "the map's file"))


def _start_localization(config: Config, events: EventLog) -> LocalizationSession | None:
    """Begin localization by the settings, at the saved pose where there is one.

    Raises:
        ConfigError: its map cannot be used, or is the one that is being made.
    """
    ours = config.localization
    grows = config.outofcore.use and ours.mapping != "off"
    if grows and ours.map_path and _same(Path(ours.map_path), map_path(config, os.environ)):
        place = "$.localization.map_path"
        raise ConfigError(
            f"{place}: is the map that pings are mapped into, which would then change below the "
            "vehicle's feet; allowed: a copy of it, or localization.mapping off",
            place,
        )
    return begun(config, _saved_pose(config, events))


def _saved_pose(config: Config, events: EventLog) -> PlanarGaussian | None:
    """Read the pose from before a restart; an invalid file is ignored with an event."""
    if config.localization.mode == "off":
        return None
    try:
        return load_pose(pose_path(config, os.environ), config.amcl.global_frame_id)
    except MapError as error:
        text = f"begins without its saved pose: {error}"
        events.add(Severity.WARNING, "saved_pose_ignored", text)
        return None


def _same(one: Path, other: Path) -> bool:
    return one.absolute() == other.absolute() or (
        one.exists() and other.exists() and one.samefile(other)
    )


M_MMAP_THRESHOLD, M_ARENA_MAX = -3, -8
"""Parameters of glibc's mallopt(3)."""
LARGE_BYTES = 128 * 1024
HEAPS = 2


def keep_large_pieces_apart() -> None:
    """Let the system, not a heap, hold each large piece of memory from now on.

    Otherwise glibc moves ever larger pieces into the heaps of all threads. Small ones between them
    keep what is freed: a daemon grew by 6 % over ten hours. Costs half a millisecond a ping.
    """
    set_option = getattr(ctypes.CDLL(None), "mallopt", None)  # only glibc has it
    if set_option is not None:
        set_option(M_MMAP_THRESHOLD, LARGE_BYTES)
        set_option(M_ARENA_MAX, HEAPS)


async def free_memory(trajectory: TrajectoryWriter) -> NoReturn:
    """Move the poses to the disk, and free memory to the system, until cancelled."""
    while True:
        await asyncio.sleep(STATUS_PERIOD_S)
        await asyncio.to_thread(trajectory.flush)
        await asyncio.to_thread(_return_free_memory)


def _return_free_memory() -> None:
    """Return free memory to the system, which takes milliseconds.

    glibc keeps free pieces between used ones, for each thread apart: 170 MB after a backlog of
    100 MB, and more the longer threads allocate side by side.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # only glibc has it
    if trim is not None:
        trim(0)


async def _print_status(live: Live, print_line: Printer) -> None:
    """Print the status now and then."""
    while True:
        await asyncio.sleep(STATUS_PERIOD_S)
        pings = live.mapping.snapshot.pings
        dropped = sum(pings["dropped"].values())
        sonar = f"{pings['mapped']} pings mapped, {dropped} dropped, sonar {live.link.state}"
        print_line(sonar + _where(live.mapping.snapshot.localization))


def _where(snapshot: LocalizationSnapshot | None) -> str:
    """Localization as text for the status line."""
    if snapshot is None:
        return ""
    state = f", {state_of(snapshot)}"
    if snapshot.belief is None:
        return state
    best = snapshot.belief.best
    return f"{state} at x {best.x_m:.2f} m, y {best.y_m:.2f} m"


async def _until(stop: asyncio.Event, duration_s: float | None) -> None:
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(duration_s):
            await stop.wait()


def _live_facts(daemon: Daemon, *, stop_requested: bool) -> dict[str, Any]:
    status, device = daemon.status(), daemon.settings.current.device
    sonar = status["sonar"]
    return {
        "session": status["session"],
        "told_to_stop": stop_requested,
        "sonar": f"{sonar['address'] or device.address or 'found by status'}:{device.port}",
        "odometry": status["odometry"]["connections"],
        "recording": status["recording"],
        "pings_placed_by": {how: count for how, count in sonar["placed_by"].items() if count},
        "sonar_restarts": sonar["restarts"],
        "latency_ms": status["latency_ms"],
        "behind": status["behind"],
    }
