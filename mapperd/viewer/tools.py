"""Tools of each browser: camera, distance measurement, screenshots; buttons that save files.

The camera is behind the vehicle, above it, or free.
"""

import asyncio
import io
import time
from collections.abc import Callable, Coroutine, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd.errors import MapperdError
from mapperd.export.formats import FORMATS, write_map
from mapperd.viewer.chunks import ChunkSurface

if TYPE_CHECKING:
    from viser import ClientHandle, GuiTabHandle, ViserServer

    from mapperd.client import MapClient

__all__ = [
    "VIEWS",
    "CameraMode",
    "Cameras",
    "MapRecorder",
    "Measuring",
    "SaveControls",
    "Tools",
    "distance_text",
    "pick",
    "whole_view",
]

CameraMode = Literal["follow", "top", "free"]
VIEWS: tuple[CameraMode, ...] = ("follow", "top", "free")

BEHIND_M = np.array([-7.0, -4.0, 5.0])
"""Initial offset of a following camera from the vehicle, base frame without roll and pitch."""

ABOVE_M = 25.0
MOVED_M = 0.005


class Cameras:
    """Moves the cameras of browsers; use from one thread."""

    def __init__(self) -> None:
        self._modes: dict[int, CameraMode] = {}
        self._at: dict[int, NDArray[np.float64]] = {}

    def mode(self, client: "ClientHandle") -> CameraMode:
        """Camera mode of a browser."""
        return self._modes.get(client.client_id, "free")

    def choose(
        self, client: "ClientHandle", mode: CameraMode, vehicle_m: ArrayLike | None, yaw: float
    ) -> None:
        """Change the camera mode of a browser.

        Args:
            client: the browser.
            mode: the new mode.
            vehicle_m: (3,) map frame; None if unknown.
            yaw: heading of the vehicle, radians from x counter-clockwise.
        """
        self._modes[client.client_id] = mode
        self._at.pop(client.client_id, None)
        if mode == "free":
            client.camera.up_direction = (0.0, 0.0, 1.0)
        elif vehicle_m is not None:
            self._begin(client, mode, np.asarray(vehicle_m, np.float64), yaw)

    def follow(self, clients: list["ClientHandle"], vehicle_m: ArrayLike, yaw: float) -> None:
        """Move following cameras with the vehicle; they keep direction and distance.

        The position of a slow browser is that of some time ago.
        """
        vehicle = np.asarray(vehicle_m, np.float64)
        for client in clients:
            mode = self.mode(client)
            if mode == "free":
                continue
            before = self._at.get(client.client_id)
            if before is None:
                self._begin(client, mode, vehicle, yaw)
            elif float(np.linalg.norm(vehicle - before)) > MOVED_M:
                offset = client.camera.position - client.camera.look_at
                self._at[client.client_id] = vehicle
                _place(client, vehicle, offset)

    def forget(self, client_id: int) -> None:
        """Remove a browser."""
        self._modes.pop(client_id, None)
        self._at.pop(client_id, None)

    def _begin(
        self, client: "ClientHandle", mode: CameraMode, vehicle: NDArray[np.float64], yaw: float
    ) -> None:
        self._at[client.client_id] = vehicle
        if mode == "top":
            up, offset = (0.0, 1.0, 0.0), np.array([0.0, 0.0, ABOVE_M])
        else:
            c, s = np.cos(yaw), np.sin(yaw)
            up = (0.0, 0.0, 1.0)
            offset = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ BEHIND_M
        with client.atomic():
            client.camera.up_direction = up
            _place(client, vehicle, offset)


def _place(
    client: "ClientHandle", vehicle: NDArray[np.float64], offset: NDArray[np.float64]
) -> None:
    """Have the camera look at the vehicle from an offset."""
    with client.atomic():
        client.camera.position = vehicle + offset
        client.camera.look_at = vehicle


def whole_view(
    low_m: ArrayLike, high_m: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Position and target of a camera that shows a box (3,), (3,)."""
    low, high = np.asarray(low_m, np.float64), np.asarray(high_m, np.float64)
    middle = (low + high) / 2
    away = max(4.0, float(np.linalg.norm(high - low))) * np.array([-0.42, -0.62, 0.55])
    return middle + away, middle


def pick(
    drawn: Iterable[ChunkSurface], origin_m: ArrayLike, towards: ArrayLike
) -> NDArray[np.float64] | None:
    """Return the centre of the first cell that a ray hits, (3,) map frame, or None.

    Args:
        drawn: the cells.
        origin_m: (3,) origin of the ray, map frame.
        towards: (3,) direction of the ray, of any length.
    """
    origin = np.asarray(origin_m, np.float64)
    direction = np.asarray(towards, np.float64)
    direction = direction / np.linalg.norm(direction)
    best_m, found = np.inf, None
    for part in drawn:
        if len(part) == 0:
            continue
        low = part.origin_m + part.local.min(axis=0) * part.cell_m
        high = part.origin_m + (part.local.max(axis=0) + 1.0) * part.cell_m
        if not _entry_m(low[None], high[None], origin, direction)[0] < best_m:
            continue
        corners = part.origin_m + part.local * part.cell_m
        at_m = _entry_m(corners, corners + part.cell_m, origin, direction)
        first = int(np.argmin(at_m))
        if at_m[first] < best_m:
            best_m, found = at_m[first], corners[first] + part.cell_m / 2
    return found


def _entry_m(
    low_m: NDArray[np.float64],
    high_m: NDArray[np.float64],
    origin: NDArray[np.float64],
    direction: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Distance along a ray to boxes (N, 3), (N,); infinite for boxes it misses."""
    with np.errstate(divide="ignore", invalid="ignore"):
        one = (low_m - origin) / direction
        other = (high_m - origin) / direction
    parallel = np.isnan(one) | np.isnan(other)  # along a face: inside this pair of planes
    near = np.where(parallel, -np.inf, np.minimum(one, other)).max(axis=1)
    far = np.where(parallel, np.inf, np.maximum(one, other)).min(axis=1)
    return np.where((near <= far) & (far >= 0), np.maximum(near, 0.0), np.inf)


def distance_text(first_m: ArrayLike, second_m: ArrayLike) -> str:
    """Distance of two points of the map, with its components."""
    dx, dy, dz = (float(one) for one in np.subtract(second_m, first_m))
    total = float(np.linalg.norm((dx, dy, dz)))
    return f"{total:.2f} m   dx {dx:+.2f}  dy {dy:+.2f}  dz {dz:+.2f}"


@dataclass(slots=True)
class Measuring:
    """Two points that a user picks; a third starts again."""

    points_m: list[NDArray[np.float64]] = field(default_factory=list)

    def add(self, point_m: NDArray[np.float64]) -> str:
        """Add a point; return the text to show."""
        if len(self.points_m) == 2:  # noqa: PLR2004 a distance has two ends
            self.points_m.clear()
        self.points_m.append(point_m)
        if len(self.points_m) == 1:
            x, y, z = point_m
            return f"({x:.2f}, {y:.2f}, {z:.2f}) m; pick the other point"
        return distance_text(*self.points_m)


PICTURE_S = 20.0
MARK = (250, 250, 250)


@dataclass(slots=True)
class _Browser:
    """State of one browser.

    Attributes:
        client: handle of viser.
        mode: camera control.
        measured: text of the measurement.
        measuring: the picked points.
        marks: their nodes in the scene.
    """

    client: "ClientHandle"
    mode: Any
    measured: Any
    measuring: Measuring = field(default_factory=Measuring)
    marks: list[Any] = field(default_factory=list)


class Tools:
    """Tools of all browsers; use from the drawing thread.

    Args:
        tab: parent of the controls.
        post: runs a function in the drawing thread.
        camera: called with the camera that a user chose.
        pick: returns the first point of the map on a ray, from its origin and direction.
    """

    def __init__(
        self,
        tab: "GuiTabHandle",
        post: Callable[[Callable[[], object]], None],
        camera: Callable[["ClientHandle", CameraMode], object],
        pick: Callable[[Any, Any], Any],
    ) -> None:
        self._tab = tab
        self._post = post
        self._camera = camera
        self._pick = pick
        self._browsers: dict[int, _Browser] = {}

    def add(self, client: "ClientHandle", mode: CameraMode) -> None:
        """Add a browser with a camera mode."""
        gui = client.gui
        with self._tab:
            chosen = gui.add_button_group(
                "Camera", VIEWS, hint="follow and top move with the vehicle"
            )
            measure = gui.add_checkbox(
                "Measure", initial_value=False, hint="Click two points of the map"
            )
            measured = gui.add_markdown("", visible=False)
            picture = gui.add_button("Screenshot", hint="The map as a PNG")
        browser = self._browsers[client.client_id] = _Browser(client, chosen, measured)
        chosen.on_click(
            lambda _: self._post(lambda: self._choose(browser, cast("CameraMode", chosen.value)))
        )
        measure.on_update(
            lambda event: self._post(lambda: self._measure(browser, event.target.value))
        )
        picture.on_click(lambda _: self._take_picture(client))
        self._choose(browser, mode)

    def forget(self, client_id: int) -> None:
        """Remove a browser."""
        self._browsers.pop(client_id, None)

    def _choose(self, browser: _Browser, mode: CameraMode) -> None:
        browser.mode.label = f"Camera: {mode}"  # its buttons all look the same
        self._camera(browser.client, mode)

    def _measure(self, browser: _Browser, on: bool) -> None:  # noqa: FBT001 of a checkbox
        scene = browser.client.scene
        browser.measuring = Measuring()
        self._unmark(browser)
        browser.measured.visible = on
        browser.measured.content = "Click a point of the map." if on else ""
        scene.remove_click_callback("all")
        if on:
            scene.on_click()(
                lambda event: self._post(
                    lambda: self._clicked(browser, event.ray_origin, event.ray_direction)
                )
            )

    def _clicked(self, browser: _Browser, origin_m: Any, towards: Any) -> None:  # noqa: ANN401 vectors
        point_m = self._pick(origin_m, towards)
        if point_m is None:
            browser.measured.content = "No cell here. Click a point of the map."
            return
        text = browser.measuring.add(point_m)
        browser.measured.content = f"**{text}**"
        points = browser.measuring.points_m
        scene = browser.client.scene
        if len(points) == 1:
            self._unmark(browser)
        size_m = max(0.05, 0.008 * float(np.linalg.norm(point_m - browser.client.camera.position)))
        browser.marks.append(
            scene.add_icosphere(
                f"/measure/{len(points)}", radius=size_m, color=MARK, position=point_m
            )
        )
        if len(points) == 2:  # noqa: PLR2004 both ends
            line = np.array([points], np.float32)
            browser.marks += [
                scene.add_line_segments(
                    "/measure/line", line, MARK, thickness=3.0, thickness_units="screen"
                ),
                scene.add_label(
                    "/measure/text",
                    f"{np.linalg.norm(points[1] - points[0]):.2f} m",
                    position=np.mean(points, axis=0),
                    font_screen_scale=1.3,
                    anchor="bottom-center",
                ),
            ]

    def _unmark(self, browser: _Browser) -> None:
        for mark in browser.marks:
            mark.remove()
        browser.marks.clear()

    def _take_picture(self, client: "ClientHandle") -> None:
        """Have the browser render a picture and download it; called in a thread of viser."""
        camera = client.camera
        try:
            image = client.get_render(
                camera.image_height, camera.image_width, transport_format="png", timeout=PICTURE_S
            )
        except (RuntimeError, TimeoutError) as error:
            client.add_notification("No picture", str(error), color="red")
            return
        from PIL import Image  # noqa: PLC0415 an extra

        picture = io.BytesIO()
        Image.fromarray(np.ascontiguousarray(image[..., :3])).save(picture, "png")
        name = time.strftime("map-%Y%m%d-%H%M%S.png")
        client.send_file_download(name, picture.getvalue(), save_immediately=True)


NOTE_S = 8.0
RECORD = "\N{BLACK CIRCLE} Record"
MAX_DOWNLOAD = 64 << 20
"""Larger files are not sent to the browser."""


class MapRecorder(Protocol):
    """A recording in the background, from `start` to `stop`."""

    @property
    def path(self) -> Path: ...  # noqa: D102

    @property
    def bytes(self) -> int: ...  # noqa: D102

    @property
    def ended(self) -> bool: ...  # noqa: D102

    def start(self) -> None: ...  # noqa: D102

    async def stop(self) -> None: ...  # noqa: D102


class SaveControls:
    """Record and export; use from the drawing thread.

    Args:
        server: server of the page.
        tab: parent of the buttons.
        client: client of the map stream.
        folder: folder for files, on the computer that serves the page.
        recorder: makes a recording of a client; None hides the button.
        begin: runs a coroutine in the drawing thread; callable from any thread.
    """

    def __init__(
        self,
        server: "ViserServer",
        tab: "GuiTabHandle",
        client: "MapClient",
        *,
        folder: Path,
        recorder: Callable[["MapClient", Path], MapRecorder] | None,
        begin: Callable[[Callable[[], Coroutine[Any, Any, None]]], None],
    ) -> None:
        self._server = server
        self._client = client
        self._folder = folder
        self._make = recorder
        self._running: MapRecorder | None = None
        with tab, server.gui.add_folder("Save"):
            if recorder is not None:
                self._button = server.gui.add_button(RECORD, color="red")
                self._button.on_click(lambda event: begin(lambda: self._record(event.client)))
            self._format = server.gui.add_dropdown("Format", tuple(FORMATS), initial_value=".ply")
            export = server.gui.add_button("Export map")
            export.on_click(lambda event: begin(lambda: self._export(event.client)))

    async def update(self) -> None:
        """Show the size of the recording; notify all browsers if it ended by itself."""
        if self._running is None:
            return
        if self._running.ended:
            await self.stop()
        else:
            self._button.label = f"Stop recording ({self._running.bytes / 1e6:.1f} MB)"

    async def stop(self, who: "ClientHandle | None" = None) -> None:
        """Stop the recording, if any, and show the result."""
        running, self._running = self._running, None
        if running is None:
            return
        self._button.label = RECORD
        try:
            await running.stop()
        except MapperdError as error:
            self._note(who, "Recording ended", f"{running.path}: {error}", "red")
        else:
            self._note(who, "Recorded", f"{running.path}: {running.bytes / 1e6:.1f} MB", "green")

    async def _record(self, who: "ClientHandle | None") -> None:
        if self._running is not None:
            await self.stop(who)
            return
        assert self._make is not None  # noqa: S101 otherwise there is no button
        begun = self._make(self._client, self._folder / _named("dive", ".mcap"))
        try:
            begun.start()
        except MapperdError as error:
            self._note(who, "Not recorded", str(error), "red")
            return
        self._running = begun
        self._note(who, "Recording", f"into {begun.path}", "red")

    async def _export(self, who: "ClientHandle | None") -> None:
        mirror = self._client.mirror
        if mirror is None:
            self._note(who, "Not exported", "there is no map yet", "red")
            return
        path = self._folder / _named("map", self._format.value)
        try:
            files = await asyncio.to_thread(lambda: write_map(mirror.to_map(), path))
        except MapperdError as error:
            self._note(who, "Not exported", str(error), "red")
            return
        for file in files:
            data = await asyncio.to_thread(file.read_bytes)
            if who is not None and len(data) <= MAX_DOWNLOAD:
                who.send_file_download(file.name, data, save_immediately=True)
        self._note(who, "Exported", ", ".join(map(str, files)), "green")

    def _note(self, who: "ClientHandle | None", title: str, text: str, colour: Any) -> None:  # noqa: ANN401
        for one in [who] if who else self._server.get_clients().values():
            one.add_notification(title, text, auto_close_seconds=NOTE_S, color=colour)


def _named(what: str, suffix: str) -> str:
    return time.strftime(f"{what}-%Y%m%d-%H%M%S{suffix}")
