"""The panels of the page: status, legend, and how the map is drawn."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from mapperd.viewer.actors import LAYERS
from mapperd.viewer.chunks import Filter
from mapperd.viewer.colours import MODES, Mode, Scale, legend_of
from mapperd.viewer.health import Health, banner_html, health_html, legend_html, summary_html
from mapperd.viewer.map_layer import MapStyle, Shape

if TYPE_CHECKING:
    from viser import GuiTabGroupHandle, GuiTabHandle, ViserServer

__all__ = ["Panel", "Span"]

SHAPES: tuple[Shape, ...] = ("auto", "cubes", "points")
STEP_M = 0.5
RANGES = {"probability": (0.5, 1.0), "age": (1.0, 1000.0), "count": (1.0, 128.0)}

STYLE = """<style>
:root { --mantine-color-dimmed: #cbd5e1 !important; }
label, .mantine-InputWrapper-label, .mantine-Text-root {
  color: #dbe3ec; letter-spacing: 0 !important;
}
.mantine-Slider-markLabel { color: #cbd5e1; font-size: 11px; }
.multi-slider { margin-bottom: 10px; }
.multi-slider-mark-label {
  color: #cbd5e1 !important; font-size: 11px; margin-top: 5px;
}
.mantine-Button-label { color: #f8fafc !important; }
[data-phone] { display: none; }
@media (max-width: 36em) {
  [data-phone] { display: block; }
  .mantine-Paper-root:has(> div > .mantine-ScrollArea-root) { width: 100% !important; }
  .mantine-ScrollArea-content > div { width: 100% !important; }
  .mantine-ScrollArea-content > div > div:has(> .mantine-Divider-root) {
    display: flex; flex-direction: column;
  }
  div:has(> .mantine-Tabs-root + .mantine-Tabs-root) { display: contents; }
  div > .mantine-Tabs-root:has(+ .mantine-Tabs-root) { order: -1; }
  div:has(canvas):has(+ .mantine-Paper-root) { height: 40% !important; }
  div:has(canvas):has(+ .mantine-Paper-root [style*="display: none"] > .mantine-Divider-root) {
    height: calc(100% - 3.5em) !important;
  }
}
</style>"""
"""Legible labels. On a phone the panels are a sheet below the map: sonar image, controls, link."""

GRID_TEXT = (
    '<div style="font-size:13px;padding:0 10px 10px;opacity:.85">grid 1 m and 10 m; axes: red x, '
    "green y, blue z</div>"
)

Post = Callable[[Callable[[], object]], None]


@dataclass(slots=True)
class Span:
    """Range of heights in the map, rounded to whole steps; it only grows.

    Attributes:
        low_m, high_m: None before there is a map.
    """

    low_m: float | None = None
    high_m: float | None = None

    def take(self, low_m: float, high_m: float) -> bool:
        """Include heights; return whether the span changed."""
        low = float(np.floor(low_m / STEP_M) * STEP_M)
        high = float(np.ceil(high_m / STEP_M) * STEP_M)
        new = (
            low if self.low_m is None else min(low, self.low_m),
            high if self.high_m is None else max(high, self.high_m),
        )
        changed = new != (self.low_m, self.high_m)
        self.low_m, self.high_m = new
        return changed

    @property
    def ends_m(self) -> tuple[float, float]:
        """Low and high end; ten metres of water before there is a map."""
        low = -10.0 if self.low_m is None else self.low_m
        return low, 0.0 if self.high_m is None else self.high_m


@dataclass(slots=True)
class _Handles:
    """Controls of viser."""

    health: Any = None
    summary: Any = None
    banner: Any = None
    legend: Any = None
    colour: Any = None
    shape: Any = None
    threshold: Any = None
    clip: Any = None
    shading: Any = None
    last: dict[str, str] = field(default_factory=dict)


class Panel:
    """The windows of the page.

    Args:
        server: of the page.
        post: has something done in the thread that draws.
        changed: the map is to look otherwise.
        show: one kind of things is shown, or not.
    """

    def __init__(
        self,
        server: "ViserServer",
        post: Post,
        changed: Callable[[], object],
        show: Callable[[str, bool], object],
    ) -> None:
        self._server = server
        self._post = post
        self._changed = changed
        self._handles = _Handles()
        self._span = Span()
        self._threshold: float | None = None
        window = server.gui.add_panel()  # first, as a phone stacks the panels in this order
        self._sonar = window
        self.sonar_window = window.add_tab("sonar")
        window.float(x=15, y=15, width=420)
        window.expand()  # a phone shows panels collapsed
        self._status = server.gui.add_panel()
        with self._status.add_tab("link"):
            self._handles.banner = server.gui.add_html("")
            self._handles.health = server.gui.add_html("")
            self._handles.legend = server.gui.add_html("")
        self._status.float(x=15, y=-15, width=330)
        server.gui.main_panel.float(x=-15, y=15, width=330)
        server.gui.add_html(STYLE)
        self._handles.summary = server.gui.add_html("")
        self.tabs: GuiTabGroupHandle = server.gui.add_tab_group()
        self.view_tab: GuiTabHandle = self.tabs.add_tab("View")
        with self.view_tab:
            self._add_map()
            self._add_layers(show)

    @property
    def look(self) -> MapStyle:
        """How to draw the map."""
        handles = self._handles
        mode: Mode = handles.colour.value
        low, high = self._range(mode)
        clip = (float(handles.clip.value[0]), float(handles.clip.value[1]))
        whole = (handles.clip.min, handles.clip.max)
        chosen = Filter(
            self._threshold,
            -np.inf if clip[0] <= whole[0] else clip[0],
            np.inf if clip[1] >= whole[1] else clip[1],
        )
        return MapStyle(chosen, Scale(mode, low, high), handles.shape.value, handles.shading.value)

    def heights(self, low_m: float, high_m: float) -> None:
        """Set the range of heights in the map."""
        if not self._span.take(low_m, high_m):
            return
        low, high = self._span.ends_m
        clip = self._handles.clip
        was = (clip.min, clip.max)
        chosen = clip.value
        new = (
            low if chosen[0] <= was[0] else max(chosen[0], low),
            high if chosen[1] >= was[1] else min(chosen[1], high),
        )
        clip.min, clip.max = low, max(high, low + STEP_M)
        clip.value = new
        self._update_legend()
        self._changed()

    def new_map(self, occupied_probability: float) -> None:
        """Start again with a new map and its threshold."""
        self._span = Span()
        if self._threshold is None:
            self._handles.threshold.value = round(occupied_probability, 2)

    def update(self, health: Health, now_s: float, unix_ns: int) -> None:
        """Show the state of the connection."""
        if health.connected is False and self._handles.last.get("up") != "no":
            self._status.expand()  # it may be collapsed
        self._handles.last["up"] = "yes" if health.connected else "no"
        has_sonar = health.phase != "file"
        if self._sonar.visible != has_sonar:
            self._sonar.visible = has_sonar
        self._write("health", health_html(health, now_s, unix_ns))
        self._write("summary", summary_html(health, now_s))
        self._write("banner", banner_html(health, now_s))

    def _add_map(self) -> None:
        gui, handles = self._server.gui, self._handles
        handles.colour = gui.add_dropdown("Colour", MODES, initial_value="height")
        handles.shape = gui.add_dropdown(
            "Draw as", SHAPES, hint="auto: cubes while there are few cells, else points"
        )
        handles.threshold = gui.add_slider(
            "Probability",
            min=0.01,
            max=0.99,
            step=0.01,
            initial_value=0.7,
            hint="Cells with a lower probability are hidden; starts at the daemon's threshold",
        )
        handles.clip = gui.add_multi_slider(
            "Height (m)",
            min=-10.0,
            max=0.0,
            step=0.1,
            initial_value=(-10.0, 0.0),
            hint="Only cells between these heights are drawn; depth is negative",
        )
        handles.shading = gui.add_checkbox("Shade points", initial_value=True)
        for handle in (handles.shape, handles.shading, handles.clip):
            handle.on_update(self._posting(self._changed))
        handles.colour.on_update(self._posting(self._new_colour))
        handles.threshold.on_update(self._by_hand)
        self._update_legend()

    def _add_layers(self, show: Callable[[str, bool], object]) -> None:
        def layer(label: str, name: str) -> None:
            box = self._server.gui.add_checkbox(label, initial_value=True)
            box.on_update(lambda _: self._post(lambda: show(name, box.value)))

        with self._server.gui.add_folder("Layers", expand_by_default=False):
            layer("grid", "grid")
            layer("fan", "sonar/fan")
            for name in LAYERS:
                layer(name, name)

    def _by_hand(self, event: Any) -> None:  # noqa: ANN401 of viser
        if event.client is None:  # moved by the program
            return
        value = float(event.target.value)

        def take() -> None:
            self._threshold = value
            self._changed()

        self._post(take)

    def _posting(self, do: Callable[[], object]) -> Callable[[Any], None]:
        return lambda event: self._post(do) if event.client is not None else None

    def _new_colour(self) -> None:
        self._update_legend()
        self._changed()

    def _range(self, mode: Mode) -> tuple[float, float]:
        if mode != "height":
            return RANGES[mode]
        return self._span.ends_m

    def _update_legend(self) -> None:
        mode: Mode = self._handles.colour.value
        self._write("legend", legend_html(legend_of(Scale(mode, *self._range(mode)))) + GRID_TEXT)

    def _write(self, name: str, text: str) -> None:
        if self._handles.last.get(name) != text:
            self._handles.last[name] = text
            getattr(self._handles, name).content = text
