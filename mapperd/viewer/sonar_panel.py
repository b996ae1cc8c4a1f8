"""The sonar on the page: its live image, and the controls of its settings."""

import asyncio
import html
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from mapperd.viewer.settings import control_of
from mapperd.viewer.sonar_picture import SonarPicture
from mapperd.wire.messages import ImageMessage, ReturnsMessage

if TYPE_CHECKING:
    from viser import GuiTabHandle, ViserServer

__all__ = ["SonarPanel"]

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
