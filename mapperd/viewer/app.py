"""`mapperctl view`: the map of a running daemon as a page in the browser."""

import asyncio
import contextlib
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from mapperd.client.changes import ClientChange, LinkChanged, MapChanged, MapReset
from mapperd.viewer.actors import Actors
from mapperd.viewer.health import Health
from mapperd.viewer.map_layer import MapLayer
from mapperd.viewer.panel import Panel
from mapperd.viewer.settings import SettingsPanel
from mapperd.viewer.sonar_panel import IMAGE_S, SonarPanel
from mapperd.viewer.tools import (
    CameraMode,
    Cameras,
    MapRecorder,
    SaveControls,
    Tools,
    pick,
    whole_view,
)
from mapperd.wire.messages import (
    ImageMessage,
    PoseMessage,
    ReturnsMessage,
    SettingsMessage,
    StatusMessage,
    Want,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from viser import ClientHandle, ViserServer

    from mapperd.client import MapClient

__all__ = ["VIEW_WANTS", "ViewerPage"]

VIEW_WANTS: tuple[Want, ...] = (
    "map",
    "pose",
    "path",
    "fan",
    "returns",
    "robots",
    "localization",
    "status",
    "settings",
    "events",  # for recordings
)

IMAGE: tuple[Want, ...] = ("image",)

READ_ONLY = (
    "This page may not change settings: it shows a file or a replay, or is open to other computers "
    "(--allow-changes permits them)."
)

MAP_S = 0.25
"""Period of map updates in browsers."""

MAX_BYTES = 2_000_000
"""Maximum size of one update; a browser on the daemon's computer receives it in `MAP_S`."""

AT_ONCE = 4
"""Chunks drawn before the event loop continues."""

POSE_S = 0.1
STATUS_PERIOD_S = 0.5
OLDER_S = 10.0
NOTE_S = 6.0


class ViewerPage:
    """A page that shows the state of one client; it runs in one event loop.

    Args:
        server: server of the page.
        client: running client of the map stream.
        may_change: browsers may change settings if the daemon allows it.
        folder: folder of exports and recordings.
        recorder: makes recordings; None hides the button.
    """

    def __init__(
        self,
        server: "ViserServer",
        client: "MapClient",
        *,
        may_change: bool = True,
        folder: Path = Path(),
        recorder: "Callable[[MapClient, Path], MapRecorder] | None" = None,
    ) -> None:
        self._server = server
        self._client = client
        self._may_change = may_change
        self._blocks = 0
        self._loop = asyncio.get_running_loop()
        self._tasks: set[asyncio.Task[None]] = set()
        self.health = Health()
        self._cameras = Cameras()
        self._actors = Actors(server.scene)
        self._panel = Panel(server, self._post, self._look_changed, self._show)
        self.map = MapLayer(server.scene, self._panel.look)
        self._tools = Tools(self._panel.view_tab, self._post, self._choose_camera, self._pick)
        self._save = SaveControls(
            server,
            self._panel.view_tab,
            client,
            folder=folder,
            recorder=recorder,
            begin=lambda work: self._post(lambda: self._begin(work())),
        )
        self._sonar = SonarPanel(
            server,
            self._panel.tabs.add_tab("Sonar"),
            self._panel.sonar_window,
            post=self._post,
            apply=self._apply,
            shown=self._want_images,
        )
        self._wants: tuple[Want, ...] = VIEW_WANTS
        tab = self._panel.tabs.add_tab("Settings")
        self._settings = SettingsPanel(server, tab, self._apply)
        self._pose: PoseMessage | None = None
        self._posed_s = 0.0
        self._low_m, self._high_m = np.full(3, np.inf), np.full(3, -np.inf)
        self._placed: set[int] = set()
        self._session = ""
        server.on_client_connect(lambda one: self._post(lambda: self._welcome(one)))
        server.on_client_disconnect(lambda one: self._post(lambda: self._farewell(one.client_id)))

    async def run(self) -> None:
        """Show the client's state until the client is closed."""
        works = (self._draw(), self._update_status(), self._draw_sonar())
        others = [asyncio.create_task(work) for work in works]
        try:
            async for change in self._client.changes():
                self.take(change)
        finally:
            await self._save.stop()
            for task in (*others, *self._tasks):
                task.cancel()
            await asyncio.gather(*others, *self._tasks, return_exceptions=True)

    def take(self, change: ClientChange) -> None:
        """Show a change."""
        match change:
            case LinkChanged():
                self._link_changed(change)
            case MapReset():
                self._map_reset()
            case MapChanged():
                self._map_changed(change)
            case PoseMessage():
                self._take_pose(change)
            case StatusMessage():
                self.health.heartbeat(change.stamp_ns, time.time_ns())
                self.health.take_status(change.status, change.link, time.monotonic())
                self._sonar.take_status(change.status)
                self._actors.changes(change.status.get("changes") or [])
            case SettingsMessage():
                self._settings.take(change.facts)
                self._sonar.take_settings(change.facts)
            case ImageMessage():
                self._sonar.take_image(change)
            case _:
                if isinstance(change, ReturnsMessage):
                    self._sonar.take_returns(change)
                self._actors.take(change, self._client.path, float(self._vehicle_m[2]))

    @property
    def _vehicle_m(self) -> NDArray[np.float64]:
        return np.zeros(3) if self._pose is None else np.array(self._pose.position_m)

    @property
    def _yaw(self) -> float:
        if self._pose is None:
            return 0.0
        x, y, z, w = self._pose.orientation_xyzw
        return float(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))

    def _link_changed(self, change: LinkChanged) -> None:
        self.health.take_link(change.link)
        if change.link.state == "connected":
            self.health.reconnected()
            welcome = self._client.welcome
            if welcome is not None and welcome.session != self._session:
                self._actors.forget()  # the daemon restarted
                self._session = welcome.session
            allowed = welcome is not None and welcome.may_change and self._may_change
            self._settings.may_change(allowed)

    def _map_reset(self) -> None:
        self.map.forget()
        self._low_m, self._high_m = np.full(3, np.inf), np.full(3, -np.inf)
        mirror = self._client.mirror
        if mirror is not None:
            odds = np.exp(mirror.info.occupied_log_odds)
            self._panel.new_map(float(odds / (1 + odds)))
            self.map.change(self._panel.look)

    def _map_changed(self, change: MapChanged) -> None:
        self.map.touch(change.keys)
        self.health.map_ns = change.stamp_ns
        self.health.left = change.left
        self._blocks += len(change.keys)

    def _take_pose(self, pose: PoseMessage) -> None:
        self._pose = pose
        self.health.pose_ns = pose.stamp_ns
        self.health.position_m, self.health.yaw_rad = pose.position_m, self._yaw
        now_s = time.monotonic()
        if now_s - self._posed_s < POSE_S:
            return
        self._posed_s = now_s
        with self._server.atomic():
            self._actors.pose(pose)
        self._cameras.follow(list(self._server.get_clients().values()), self._vehicle_m, self._yaw)

    async def _draw(self) -> None:
        """Send changes of the map, a few times a second."""
        older_s = time.monotonic()
        while True:
            await asyncio.sleep(MAP_S)
            mirror = self._client.mirror
            if mirror is None:
                continue
            if time.monotonic() - older_s > OLDER_S:
                older_s = time.monotonic()
                self.map.grow_older()
            now_ns = self.health.map_ns or time.time_ns()
            self.map.refine(self._vehicle_m, mirror.cell_m)
            sent = 0
            while self.map.stale and sent < MAX_BYTES:
                left = MAX_BYTES - sent
                with self._server.atomic():  # a chunk's places and colours arrive together
                    sent += self.map.draw(mirror, self._vehicle_m, now_ns, left, AT_ONCE)
                await asyncio.sleep(0)
            self.map.tidy()
            if sent:
                self._measure_map()

    def _measure_map(self) -> None:
        bounds = self.map.bounds_m
        if bounds is None:
            return
        self._low_m, self._high_m = bounds
        self._panel.heights(float(bounds[0][2]), float(bounds[1][2]))
        self._actors.floor(float(bounds[0][2]))
        for client in self._server.get_clients().values():
            self._place(client)

    async def _draw_sonar(self) -> None:
        """Send the newest sonar image while somebody watches."""
        while True:
            await asyncio.sleep(IMAGE_S)
            if self._server.get_clients():
                self._sonar.draw()

    def _want_images(self) -> None:
        """Request images only while a browser shows them."""
        shown = self._sonar.is_live and bool(self._server.get_clients())
        wants = (*VIEW_WANTS, *IMAGE) if shown else VIEW_WANTS
        if wants != self._wants:
            self._wants = wants
            self._begin(self._client.change(wants=wants))

    async def _update_status(self) -> None:
        """Show the status twice a second, with or without a connection."""
        health = self.health
        while True:
            now_s = time.monotonic()
            link = self._client.link
            health.take_link(link)
            health.blocks.add(now_s, self._blocks)
            health.kilobytes.add(now_s, link.bytes / 1e3)
            health.page_cells, health.page_nodes = self.map.cells, self.map.nodes
            health.page_bytes, health.page_waiting = self.map.sent_bytes, self.map.stale
            self._panel.update(health, now_s, time.time_ns())
            await self._save.update()
            await asyncio.sleep(STATUS_PERIOD_S)

    def _welcome(self, client: "ClientHandle") -> None:
        self._want_images()
        self._tools.add(client, "follow")
        self._place(client)

    def _place(self, client: "ClientHandle") -> None:
        """Show the whole map first while there is no vehicle to follow."""
        if client.client_id in self._placed or not np.isfinite(self._low_m).all():
            return
        self._placed.add(client.client_id)
        if self._pose is None or self._cameras.mode(client) == "free":
            at_m, towards_m = whole_view(self._low_m, self._high_m)
            client.camera.position, client.camera.look_at = at_m, towards_m

    def _farewell(self, client_id: int) -> None:
        self._want_images()
        self._tools.forget(client_id)
        self._cameras.forget(client_id)
        self._placed.discard(client_id)

    def _choose_camera(self, client: "ClientHandle", mode: CameraMode) -> None:
        vehicle_m = None if self._pose is None else self._vehicle_m
        self._cameras.choose(client, mode, vehicle_m, self._yaw)

    def _pick(self, origin_m: Any, towards: Any) -> NDArray[np.float64] | None:  # noqa: ANN401
        return pick(self.map.drawn, origin_m, towards)

    def _look_changed(self) -> None:
        look = self._panel.look
        mirror = self._client.mirror
        if look.scale.mode == "count" and mirror and mirror.interest.detail != "counts":
            interest = msgspec.structs.replace(mirror.interest, detail="counts")
            self._begin(self._client.change(interest=interest))
        self.map.change(look)

    def _begin(self, work: "Coroutine[Any, Any, None]") -> None:
        task = self._loop.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _show(self, name: str, shown: bool) -> None:  # noqa: FBT001 of a checkbox
        self._actors.show(name, shown=shown)

    def _apply(self, client: "ClientHandle | None", changes: dict[str, Any]) -> None:
        """Change settings; called in a thread of viser."""

        def begin() -> None:
            if not self._may_change:
                self._settings.reset(changes)
                self._sonar.reset(changes)
                self._note(client, "Refused", READ_ONLY, "red")
                return
            self._begin(self._set(client, changes))

        self._post(begin)

    async def _set(self, client: "ClientHandle | None", changes: dict[str, Any]) -> None:
        from mapperd.client import AskError  # noqa: PLC0415

        try:
            changed = await self._client.set(changes)
        except AskError as error:
            reasons = error.details.get("reasons")
            text = (
                "\n".join(f"{k}: {v}" for k, v in reasons.items())
                if isinstance(reasons, dict)
                else str(error)
            )
            self._settings.reset(changes)
            self._sonar.reset(changes)
            self._note(client, "Refused", text, "red")
            return
        text = "\n".join(f"{name}: {was} is now {now}" for name, (was, now) in changed.items())
        self._note(client, "Changed", text or "nothing changed", "green")

    def _note(self, client: "ClientHandle | None", title: str, text: str, colour: Any) -> None:  # noqa: ANN401
        for one in [client] if client else self._server.get_clients().values():
            one.add_notification(title, text, auto_close_seconds=NOTE_S, color=colour)

    def _post(self, do: "Callable[[], object]") -> None:
        """Run a function in the event loop if it is still running; call from any thread."""
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(do)
