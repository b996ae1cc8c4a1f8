"""What each browser has for itself: its camera, measuring, pictures."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from mapperd.export.png import png_bytes
from mapperd.viewer.camera import VIEWS, CameraMode
from mapperd.viewer.view_measure import Measuring

if TYPE_CHECKING:
    from viser import ClientHandle, GuiTabHandle

__all__ = ["Tools"]

PICTURE_S = 20.0
MARK = (250, 250, 250)


@dataclass(slots=True)
class _Browser:
    """What one browser has.

    Attributes:
        client: it.
        mode: control of its camera.
        said: text of what it measured.
        measuring: the points that it picked.
        marks: nodes of those.
    """

    client: "ClientHandle"
    mode: Any
    said: Any
    measuring: Measuring = field(default_factory=Measuring)
    marks: list[Any] = field(default_factory=list)


class Tools:
    """Tools of all browsers; of the thread that draws.

    Args:
        tab: where they stand.
        post: has something done in that thread.
        camera: somebody chose another camera.
        pick: the point of the map that a ray meets first, from its origin and direction.
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
        """A browser came; its camera is this one."""
        gui = client.gui
        with self._tab:
            chosen = gui.add_button_group(
                "Camera", VIEWS, hint="follow and top move with the vehicle"
            )
            measure = gui.add_checkbox(
                "Measure", initial_value=False, hint="Click two points of the map"
            )
            said = gui.add_markdown("", visible=False)
            picture = gui.add_button("Screenshot", hint="The map as a PNG")
        browser = self._browsers[client.client_id] = _Browser(client, chosen, said)
        chosen.on_click(
            lambda _: self._post(lambda: self._choose(browser, cast("CameraMode", chosen.value)))
        )
        measure.on_update(
            lambda event: self._post(lambda: self._measure(browser, event.target.value))
        )
        picture.on_click(lambda _: self._take_picture(client))
        self._choose(browser, mode)

    def forget(self, client_id: int) -> None:
        """A browser went."""
        self._browsers.pop(client_id, None)

    def _choose(self, browser: _Browser, mode: CameraMode) -> None:
        browser.mode.label = f"Camera: {mode}"  # its buttons all look the same
        self._camera(browser.client, mode)

    def _measure(self, browser: _Browser, on: bool) -> None:  # noqa: FBT001 of a checkbox
        scene = browser.client.scene
        browser.measuring = Measuring()
        self._unmark(browser)
        browser.said.visible = on
        browser.said.content = "Click a point of the map." if on else ""
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
            browser.said.content = "There is nothing of the map."
            return
        text = browser.measuring.add(point_m)
        browser.said.content = f"**{text}**"
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
        """Of a thread of viser: the browser draws it, and gets it back to keep."""
        camera = client.camera
        try:
            image = client.get_render(
                camera.image_height, camera.image_width, transport_format="png", timeout=PICTURE_S
            )
        except (RuntimeError, TimeoutError) as error:
            client.add_notification("No picture", str(error), color="red")
            return
        name = time.strftime("map-%Y%m%d-%H%M%S.png")
        client.send_file_download(name, png_bytes(image[..., :3]), save_immediately=True)
