"""The sonar on the page: its live image, and the controls of its settings."""

import asyncio
import html
from collections.abc import Callable, Mapping
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mapperd.client.validation import image_of
from mapperd.viewer.settings import control_of
from mapperd.wire.messages import ImageMessage, ReturnsMessage
from oculus_driver.fan import FanGeometry, fit_fan, ring_ranges_m

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw
    from viser import GuiTabHandle, ViserServer


__all__ = ["SonarPanel", "SonarPicture"]

WATER = (20, 20, 20)
"""Outside the fan: the background of the page's panels."""

RING = (148, 163, 184)
INK = (226, 232, 240)
DETECTION = (74, 222, 128)
DETECTION_PX = 2
LETTERS_PX = 22
MARGINS_PX = (64, 14, 64, 14)
MIN_HEIGHT_PX = 160
GAMMA = 0.6
DIM = 0.45
"""Brightness of samples at or below the threshold, which the map ignores."""


class SonarPicture:
    """Draws polar images as fans in true geometry, with range rings and detections.

    It keeps the geometry of the last shape.

    Args:
        width_px: width of the pictures.
    """

    def __init__(self, width_px: int = 760) -> None:
        self._width_px = width_px
        self._shape: tuple[object, ...] = ()
        self._source = np.zeros((0, 0), np.intp)
        self._fan: FanGeometry | None = None
        self._edges_rad = (0.0, 0.0)

    def draw(
        self, image: ImageMessage, returns: ReturnsMessage | None, threshold: float
    ) -> NDArray[np.uint8]:
        """Return the picture, uint8 (height, width, 3): ahead is up, starboard is right.

        Args:
            image: the polar image; its bearings rise.
            returns: detections, of the same or a neighbouring ping; None draws none.
            threshold: samples above it are in full colours, the others in grey.
        """
        from PIL import Image, ImageDraw  # noqa: PLC0415 of the extra `topside`

        fan = self._geometry(image)
        samples = np.append(image_of(image).ravel(), np.uint8(0))
        colours = np.append(_colours(threshold), [WATER], axis=0).astype(np.uint8)
        inside = self._source < samples.size - 1
        index = np.where(inside, samples[self._source].astype(np.intp), len(colours) - 1)
        picture = Image.fromarray(colours[index])
        pen = ImageDraw.Draw(picture)
        self._draw_rings(pen, fan, image.rows * image.range_resolution_m)
        if returns is not None:
            _draw_detections(pen, fan, np.frombuffer(returns.points, "<f4").reshape(-1, 3))
        return np.asarray(picture)

    def _geometry(self, image: ImageMessage) -> FanGeometry:
        shape = (image.rows, image.beams, image.bearings_rad, image.range_resolution_m)
        if self._fan is None or shape != self._shape:
            bearings = np.frombuffer(image.bearings_rad, "<f4").astype(np.float64)
            max_range_m = image.rows * image.range_resolution_m
            left, top, right, bottom = MARGINS_PX
            half = max(float(np.abs(np.sin(bearings)).max()), 0.2)
            height_px = round((self._width_px - left - right) / (2 * half)) + top + bottom
            size = (self._width_px, max(min(height_px, self._width_px), MIN_HEIGHT_PX))
            self._fan = fit_fan(bearings, max_range_m, size, MARGINS_PX)
            row = np.minimum(self._fan.row_share * image.rows, image.rows - 1).astype(np.intp)
            beam = np.rint(self._fan.beam).astype(np.intp)
            index = row * image.beams + beam
            self._source = np.where(self._fan.outside, image.rows * image.beams, index)
            self._edges_rad = (float(bearings[0]), float(bearings[-1]))
            self._shape = shape
        return self._fan

    def _draw_rings(self, pen: "ImageDraw", fan: FanGeometry, max_range_m: float) -> None:
        from PIL import ImageFont  # noqa: PLC0415

        font = ImageFont.load_default(LETTERS_PX)
        first, last = self._edges_rad
        bearings = np.linspace(first, last, 61)
        for range_m in ring_ranges_m(max_range_m):
            pen.line([fan.pixel(range_m, float(one)) for one in bearings], fill=RING, width=1)
            x, y = fan.pixel(range_m, last)
            text = f"{range_m:g} m"
            pen.text((x + 4, y + 2), text, fill=INK, font=font, stroke_width=2, stroke_fill=0)
        for bearing in (first, 0.0, last):
            if first <= bearing <= last:
                pen.line([fan.pixel(0.0, 0.0), fan.pixel(max_range_m, bearing)], fill=RING)


def _draw_detections(pen: "ImageDraw", fan: FanGeometry, points_m: NDArray[np.floating]) -> None:
    for forward_m, port_m, _ in points_m.astype(np.float64).tolist():
        away_m, bearing = float(np.hypot(forward_m, port_m)), float(np.arctan2(-port_m, forward_m))
        x, y = fan.pixel(away_m, bearing)
        box = (x - DETECTION_PX, y - DETECTION_PX, x + DETECTION_PX, y + DETECTION_PX)
        pen.ellipse(box, fill=DETECTION)


@cache
def _colours(threshold: float) -> NDArray[np.float64]:
    """Return colours of the samples 0 to 255, (256, 3)."""
    from matplotlib import colormaps  # noqa: PLC0415 of the extra `topside`

    level = (np.arange(256) / 255) ** GAMMA
    loud = colormaps["inferno"](0.15 + 0.85 * level)[:, :3] * 255
    grey = np.repeat(255 * DIM * level[:, None], 3, axis=1)
    return np.where(np.arange(256)[:, None] > threshold, loud, grey)


LABELS: Mapping[str, str] = {
    "device.range": "Range (m)",
    "device.gain": "Gain (%)",
    "filtering.intensity_threshold": "Threshold",
    "device.gamma": "Gamma",
    "device.mode": "Mode",
    "device.ping_rate": "Ping rate",
    "device.standby": "Standby",
    "water.salinity": "Salinity (ppt)",
}
"""Label of each setting of the pilot; the other ones are in the tab of all settings."""

SLIDERS = ("device.gain", "filtering.intensity_threshold", "device.gamma")
THRESHOLD = "filtering.intensity_threshold"

WAITING = "Waiting for the daemon's settings."
NO_SONAR = "No sonar to control: this is a file or a replay."

SETTLE_S = 0.5
"""A value that a user stops changing for this long is sent."""

MAX_RETURNS = 8
"""Detections that are kept until the image of their ping comes, or before it."""

IMAGE_S = 0.15
"""Shortest time between two images in browsers."""


class SonarPanel:
    """Image and controls; use from the drawing thread.

    A control sends its value once the user leaves it alone; a refused one returns to the value in
    force.

    Args:
        server: server of the page.
        tab: parent of the controls.
        window: parent of the image.
        post: runs a function in the drawing thread.
        apply: requests changes for a browser.
        shown: called when the image is shown or hidden.
    """

    def __init__(
        self,
        server: "ViserServer",
        tab: "GuiTabHandle",
        window: Any,  # noqa: ANN401 of viser
        *,
        post: Callable[[Callable[[], object]], None],
        apply: Callable[[Any, dict[str, Any]], object],
        shown: Callable[[], object],
    ) -> None:
        self._server = server
        self._tab = tab
        self._post = post
        self._apply = apply
        self._picture = SonarPicture()
        self._image: ImageMessage | None = None
        self._returns: dict[int, ReturnsMessage] = {}
        self._is_new = False
        self._facts: dict[str, Any] = {}
        self._handles: dict[str, Any] = {}
        self._timers: dict[str, asyncio.TimerHandle] = {}
        self._there = True
        with window:
            blank = np.full((330, 760, 3), 20, np.uint8)
            self._view = server.gui.add_image(blank, format="jpeg", jpeg_quality=85)
            self._caption = server.gui.add_html(caption_html({}))
        with tab:
            self._live = server.gui.add_checkbox(
                "Live image", initial_value=True, hint="Without it the link carries no images"
            )
            self._note = server.gui.add_markdown(WAITING)
        self._live.on_update(lambda _: post(shown))

    @property
    def is_live(self) -> bool:
        """Whether images are shown."""
        return bool(self._live.value)

    def take_image(self, image: ImageMessage) -> None:
        """Keep the newest image for the next drawing."""
        self._image, self._is_new = image, True

    def take_returns(self, returns: ReturnsMessage) -> None:
        """Keep the newest detections; they are drawn over the image of their ping."""
        self._returns[returns.ping_id] = returns
        while len(self._returns) > MAX_RETURNS:
            del self._returns[next(iter(self._returns))]
        self._is_new = True

    def take_status(self, status: Mapping[str, Any]) -> None:
        """Show the state of the sonar, and controls only where there is one: a file has none."""
        sonar = status.get("sonar")
        shown = sonar if isinstance(sonar, Mapping) else {}
        self._show_controls(there=isinstance(sonar, Mapping))
        text = caption_html(shown)
        if self._caption.content != text:
            self._caption.content = text

    def take_settings(self, facts: Mapping[str, Any]) -> None:
        """Show the settings in force."""
        for name in LABELS:
            if name in facts:
                self._facts[name] = facts[name]
                self._show(name)
        self._show_controls(there=self._there)

    def reset(self, names: Mapping[str, Any]) -> None:
        """Show the values in force of settings that were not changed."""
        for name in names:
            if name in self._facts:
                self._show(name)

    def draw(self) -> None:
        """Draw the newest image, if there is one."""
        if not (self._is_new and self.is_live) or self._image is None:
            return
        self._is_new = False
        bearings = np.frombuffer(self._image.bearings_rad, "<f4")
        if len(bearings) > 1 and (np.diff(bearings) > 0).all():
            returns = self._returns.get(self._image.ping_id)
            self._view.image = self._picture.draw(self._image, returns, self._threshold)

    def _show_controls(self, *, there: bool) -> None:
        self._there = there
        for handle in self._handles.values():
            if handle.visible != there:
                handle.visible = there
        note = WAITING if there else NO_SONAR
        if self._note.content != note:
            self._note.content = note
        self._note.visible = not (there and self._handles)

    @property
    def _threshold(self) -> float:
        """The threshold on the slider, which the image shows before it is in force."""
        handle = self._handles.get(THRESHOLD)
        return float(handle.value) if handle is not None else 0.0

    def _show(self, name: str) -> None:
        value = self._facts[name]["value"]
        if name in self._handles:
            shown = str(value) if isinstance(self._handles[name].value, str) else value
            if self._handles[name].value != shown:
                self._handles[name].value = shown
            return
        with self._tab:
            handle = self._handles[name] = self._added(name, list(LABELS).index(name))
        handle.on_update(
            lambda event: (
                None
                if event.client is None
                else self._post(lambda: self._changed(name, event.client))
            )
        )

    def _added(self, name: str, order: int) -> Any:  # noqa: ANN401 of viser
        gui, control, label = self._server.gui, control_of(name, self._facts[name]), LABELS[name]
        more: dict[str, Any] = {"hint": control.hint, "order": 1000.0 + order}
        if control.kind == "switch":
            return gui.add_checkbox(label, control.value, **more)
        choices = str(self._facts[name]["allowed"]).split(" or ")
        if str(control.value) in choices:
            return gui.add_dropdown(label, choices, initial_value=str(control.value), **more)
        if name in SLIDERS:
            low, high = control.low or 0.0, control.high or 255.0
            return gui.add_slider(label, low, high, 1.0, float(control.value), **more)
        return gui.add_number(label, float(control.value), step=1.0, **more)

    def _changed(self, name: str, client: Any) -> None:  # noqa: ANN401 of viser
        """Send a value after a pause; the image shows a threshold at once."""
        self._is_new = True
        if name in self._timers:
            self._timers[name].cancel()
        loop = asyncio.get_running_loop()
        self._timers[name] = loop.call_later(SETTLE_S, lambda: self._send(name, client))

    def _send(self, name: str, client: Any) -> None:  # noqa: ANN401 of viser
        del self._timers[name]
        before, entered = self._facts[name]["value"], self._handles[name].value
        value = type(before)(float(entered)) if type(before) in (int, float) else entered
        if value != before:
            self._apply(client, {name: value})


def caption_html(sonar: Mapping[str, Any]) -> str:
    """Return a line about the sonar under its image."""
    requested = sonar.get("requested")
    words = [str(sonar.get("model") or "sonar"), str(sonar.get("state") or "no image yet")]
    rate = sonar.get("ping_rate_hz")
    if isinstance(rate, int | float) and not (requested or {}).get("standby"):
        words.append(f"{rate:.1f} pings/s")
    if isinstance(requested, Mapping):
        words += [f"{requested.get('range_m'):g} m", f"gain {requested.get('gain_percent'):g} %"]
    detail = "; ".join(html.escape(str(one)) for one in sonar.get("differences") or ())
    line = " &middot; ".join(map(html.escape, words))
    return (
        f'<div data-sonar style="font-size:13px;padding:2px 10px 8px;color:#e2e8f0">{line}'
        + (f'<div style="color:#f59e0b">{detail}</div>' if detail else "")
        + "</div>"
    )
