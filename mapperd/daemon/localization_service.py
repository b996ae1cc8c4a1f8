"""Requests to localization: checked, recorded, answered; the last pose is saved."""

import asyncio
import contextlib
import re
import time
from collections.abc import Awaitable, Callable
from itertools import count
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from mapperd.api import OperationError, PoseRequest
from mapperd.config.live import ConfigStore
from mapperd.config.tree import AmclConfig
from mapperd.errors import ExportError, MapError, Reject
from mapperd.events import EventLog, Severity
from mapperd.geometry.gaussian import PlanarGaussian
from mapperd.localization.map_io import image_of
from mapperd.localization.saved_pose import SavePace, save_pose
from mapperd.localization.session import KnownMaps
from mapperd.localization.status import LocalizationSnapshot
from mapperd.pipeline.ingest import Ingest
from mapperd.session_log import (
    Covariance9,
    GlobalLocalization,
    InitialPose,
    NewMap,
    NoMotionUpdate,
    Request,
    SetMap,
)

__all__ = [
    "CLOSED",
    "MAP_SUFFIXES",
    "LocalizationRequests",
    "PoseKeeper",
    "Requests",
    "known_map_path",
]

MAP_SUFFIXES = (".yaml", ".yml", ".map", ".bt", ".ot")
"""Grids of Nav2's map server; maps of ours; OctoMap's."""

NAME = re.compile(r"\w[\w .+-]*\.\w+")
MAX_BYTES = 200

Ask = Callable[[Request], Awaitable[Reject | None]]

REQUEST_TIMEOUT_S = 60.0
"""Timeout of a request, which waits for the pings before it."""

MAP_S = 600.0
"""And for a map to be loaded."""


class LocalizationRequests:
    """Converts requests to orders, and their outcomes to events.

    Args:
        settings: in force.
        events: what happened.
        folder: of the maps that may be asked for.
        ask: as `Live.request`: puts a request among the bytes and waits for what becomes of it.

    Attributes:
        is_changing_map: a map is being loaded; another one is refused meanwhile.
    """

    def __init__(self, settings: ConfigStore, events: EventLog, folder: Path, ask: Ask) -> None:
        self._settings = settings
        self._events = events
        self._folder = folder
        self._ask = ask
        self.is_changing_map = False

    async def initial_pose(self, asked: PoseRequest, origin: str) -> dict[str, Any]:
        """As `DaemonApi.initial_pose`."""
        pose, frame = self._pose_of(asked)
        flat = _flat(pose)
        await self._done(InitialPose(0, *flat, frame, origin), "initial pose", origin)
        x_m, y_m, yaw_rad, _ = flat
        text = f"initial pose x {x_m:.2f} m, y {y_m:.2f} m, {yaw_rad:.3f} rad from {origin}"
        self._events.add(Severity.NOTICE, "pose_set", text, x_m=x_m, y_m=y_m, yaw_rad=yaw_rad)
        return {}

    async def global_localization(self, origin: str) -> dict[str, Any]:
        """As `DaemonApi.global_localization`."""
        await self._done(GlobalLocalization(0, origin), "global localization", origin)
        text = f"global localization begins for {origin}: the vehicle may be anywhere on the map"
        self._events.add(Severity.NOTICE, "global_localization", text, origin=origin)
        return {}

    async def request_nomotion_update(self, origin: str) -> dict[str, Any]:
        """As `DaemonApi.request_nomotion_update`."""
        await self._done(NoMotionUpdate(0, origin), "update without motion", origin)
        return {}

    async def set_map(self, name: str, asked: PoseRequest | None, origin: str) -> dict[str, Any]:
        """As `DaemonApi.set_map`."""
        pose = None if asked is None else self._pose_of(asked)
        path = str(await asyncio.to_thread(known_map_path, self._folder, name))
        request: Request = NewMap(0, path, "", origin)
        if pose is not None:
            request = SetMap(0, path, "", *_flat(pose[0]), pose[1], origin)
        if self.is_changing_map:
            raise OperationError("another map is being set; try again", "busy")
        self.is_changing_map = True
        try:
            await self._done(request, f"map {name}", origin, MAP_S)
        finally:
            self.is_changing_map = False
        text = f"localizing on {name} for {origin}"
        self._events.add(Severity.NOTICE, "map_set", text, map=name)
        return {"path": path}

    def _pose_of(self, asked: PoseRequest) -> tuple[PlanarGaussian, str]:
        try:
            pose = asked.gaussian()
        except ValueError as error:
            raise OperationError(f"no pose: {error}", "bad_pose") from error
        return pose, asked.frame or self._settings.current.amcl.global_frame_id

    async def _done(
        self, request: Request, what: str, origin: str, timeout_s: float | None = None
    ) -> None:
        """Have it done; a refusal is an event and an error.

        Raises:
            OperationError: with the reason of the refusal.
        """
        refused = await self._refused(
            request, REQUEST_TIMEOUT_S if timeout_s is None else timeout_s
        )
        if refused is None:
            return
        text = f"{what} for {origin} refused: {refused.detail}"
        self._events.add(Severity.WARNING, "localization_refused", text, reason=refused.reason)
        raise OperationError(refused.detail, refused.reason)

    async def _refused(self, request: Request, timeout_s: float) -> Reject | None:
        if self._settings.current.localization.mode == "off":
            return Reject("localization_off", "localization.mode is off")
        try:
            async with asyncio.timeout(timeout_s):
                return await self._ask(request)
        except TimeoutError:
            return Reject("busy", "the pings before it are still being mapped")
        except MapError as error:
            return Reject("bad_map", str(error))


def known_map_path(folder: Path, name: str) -> Path:
    """The file of a map that lies in the folder itself: names from outside lead nowhere else.

    Raises:
        OperationError: no such name (`bad_name`), no such format (`bad_format`), or no such file
            (`no_such_map`).
    """
    if not NAME.fullmatch(name) or len(name.encode(errors="replace")) > MAX_BYTES:
        raise OperationError(
            f"{name[:60]!a}: no name of a map; allowed: letters, digits, spaces and ._+- after "
            "the first, no folder",
            "bad_name",
        )
    path = folder / name
    if path.suffix not in MAP_SUFFIXES:
        allowed = " ".join(MAP_SUFFIXES)
        raise OperationError(f"{name}: no map to be localized on; allowed: {allowed}", "bad_format")
    _require_here(path)
    if path.suffix in (".yaml", ".yml"):
        _require_here(folder / _image_beside(path))
    return path


def _require_here(path: Path) -> None:
    """A file of the folder itself: a link may lead anywhere, a pipe keeps a reader waiting."""
    if path.is_symlink() or not path.is_file():
        raise OperationError(f"{path.name}: no such file in the folder for maps", "no_such_map")


def _image_beside(path: Path) -> str:
    try:
        image = image_of(path)
    except MapError as error:
        raise OperationError(str(error), "bad_map") from error
    if image != Path(image).name:
        raise OperationError(f"{path.name}: its image is not beside it", "bad_map")
    return image


def _flat(pose: PlanarGaussian) -> tuple[float, float, float, Covariance9]:
    xx, xy, xa, yx, yy, ya, ax, ay, aa = pose.covariance.ravel().tolist()
    return pose.x_m, pose.y_m, pose.yaw_rad, (xx, xy, xa, yx, yy, ya, ax, ay, aa)


CLOSED = Reject("closed", "mapping has ended")


class Requests:
    """Requests of one session; used in one event loop, except `done`.

    Args:
        ingest: records them as orders.
        maps: loads the maps that they name; None where localization is off.
    """

    def __init__(self, ingest: Ingest, maps: KnownMaps | None) -> None:
        self._ingest = ingest
        self._maps = maps
        self._numbers = count(1)
        self._waiting: dict[int, asyncio.Future[Reject | None]] = {}
        self._loop: asyncio.AbstractEventLoop | None = None

    def open(self) -> None:
        """Begin; from the event loop."""
        self._loop = asyncio.get_running_loop()

    def close(self) -> None:
        """Fail all pending requests."""
        self._loop = None
        for answer in self._waiting.values():
            if not answer.done():
                answer.set_result(CLOSED)

    async def request(self, request: Request) -> Reject | None:
        """As `Live.request`."""
        if self._loop is None:
            return CLOSED
        request = replace(request, number=next(self._numbers))
        if isinstance(request, NewMap | SetMap) and self._maps is not None:
            known = await asyncio.to_thread(self._maps.load, request.path)
            request = replace(request, path=known.path, sha256=known.sha256)
            if self._loop is None:  # it has ended meanwhile
                return CLOSED
            self._maps.offer(known)
        answer: asyncio.Future[Reject | None] = asyncio.get_running_loop().create_future()
        self._waiting[request.number] = answer
        try:
            self._ingest.order(request)
            return await answer
        finally:
            self._waiting.pop(request.number)

    def done(self, request: Request, refused: Reject | None) -> None:
        """A request was carried out, or refused; any thread."""
        loop = self._loop
        if loop is not None:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(self._answer, request.number, refused)

    def _answer(self, number: int, refused: Reject | None) -> None:
        answer = self._waiting.get(number)
        if answer is not None and not answer.done():
            answer.set_result(refused)


POLL_INTERVAL_S = 0.2
"""Period of status updates."""


class PoseKeeper:
    """Writes the newest estimate at `amcl.save_pose_rate`, and once at the end.

    An ambiguous estimate is not written, because a restart would treat it as certain.

    Args:
        path: of the file.
        snapshot: the newest.
        amcl: the settings in force.
        clock: Unix time, nanoseconds.
        events: where a failure to save is logged.
    """

    def __init__(
        self,
        path: Path,
        snapshot: Callable[[], LocalizationSnapshot | None],
        amcl: Callable[[], AmclConfig],
        clock: Callable[[], int],
        events: EventLog | None = None,
    ) -> None:
        self._path = path
        self._snapshot = snapshot
        self._amcl = amcl
        self._clock = clock
        self._events = events
        self._written: int | None = None
        self._stuck = False

    async def run(self) -> None:
        """Save until cancelled."""
        pace = SavePace(self._amcl().save_pose_rate)
        while True:
            rate_hz = self._amcl().save_pose_rate
            await asyncio.sleep(
                min(POLL_INTERVAL_S, 1 / rate_hz) if rate_hz > 0 else POLL_INTERVAL_S
            )
            pace = SavePace(rate_hz, pace.last_s)
            if pace.is_due(time.monotonic()):
                await asyncio.to_thread(self.save)
                pace = pace.saved(time.monotonic())

    def save(self) -> None:
        """Write the newest estimate, if there is a new one; not in an event loop."""
        snapshot, amcl = self._snapshot(), self._amcl()
        if snapshot is None or snapshot.belief is None or snapshot.belief.ambiguous:
            return
        if not amcl.save_pose_rate > 0 or snapshot.stamp_ns == self._written:
            return
        try:
            save_pose(self._path, snapshot.belief.best, amcl.global_frame_id, self._clock())
        except ExportError as error:
            self._report_stuck(str(error))
        else:
            self._written, self._stuck = snapshot.stamp_ns, False

    def _report_stuck(self, problem: str) -> None:
        if self._events is not None and not self._stuck:
            text = f"the estimated pose is not saved: {problem}"
            self._events.add(Severity.WARNING, "pose_not_saved", text)
        self._stuck = True
