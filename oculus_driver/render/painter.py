"""Paints a ping as a fan with range rings, bearing spokes and labels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from oculus_driver.errors import OculusError
from oculus_driver.fan import FanGeometry, edges_rad, fit_fan, ring_ranges_m
from oculus_driver.noise import is_echo
from oculus_driver.ping import caption_lines

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oculus_driver.ping import Ping


COLOURS: Final = {
    "inferno": cv2.COLORMAP_INFERNO,
    "viridis": cv2.COLORMAP_VIRIDIS,
    "grey": None,
}
BACKGROUND: Final = (34, 26, 20)  # blue, green, red
INK: Final = (222, 222, 214)
LINE: Final = (150, 140, 128)
MARK: Final = (60, 255, 60)
_LINE_SHARE: Final = 0.35
_MAX_BEAMS: Final = 4096
_BRIGHT_PERCENT: Final = 99.8
_MIN_PX: Final = 120
_MAX_PX: Final = 8192


@dataclass(frozen=True, slots=True)
class Style:
    """Style of images.

    Attributes:
        height_px: of the frame, even.
        colours: one of `COLOURS`.
        gamma: display exponent; below 1 brightens dark areas.
        gains_removed: show sample / sqrt(gain word) if rows have gain words.
        labels: draw rings, spokes and captions.
        echo_factor: mark samples above so many times the noise (`oculus_driver.noise`); 0: none.
    """

    height_px: int = 900
    colours: str = "inferno"
    gamma: float = 0.7
    gains_removed: bool = True
    labels: bool = True
    echo_factor: float = 0.0


class Painter:
    """Paints pings into frames of one size, set by the first ping.

    The mapping from pixels to samples is reused until bearings, rows or resolution change.

    Raises:
        OculusError: the style is invalid.
    """

    def __init__(self, style: Style | None = None) -> None:
        self.style = style or Style()
        if self.style.colours not in COLOURS or not self.style.gamma > 0.0:
            raise OculusError(
                f"invalid style: colours {self.style.colours}, gamma {self.style.gamma}"
            )
        if not _MIN_PX <= self.style.height_px <= _MAX_PX:
            raise OculusError(
                f"height {self.style.height_px} px: it must be from {_MIN_PX} to {_MAX_PX}"
            )
        self._size_px: tuple[int, int] | None = None
        self._key: tuple[object, ...] = ()
        self._fan: FanGeometry | None = None

    def paint(self, ping: Ping) -> NDArray[np.uint8]:
        """Return the image, uint8 (height, width, 3), BGR as in OpenCV."""
        order = np.argsort(ping.bearings_rad, kind="stable")[:: -(-ping.beams // _MAX_BEAMS)]
        fan = self._fan_for(ping, ping.bearings_rad[order])
        level = self._level(ping)[:, order]
        frame = self._coloured(warp_to_fan(level, fan), fan.outside)
        if self.style.echo_factor > 0:
            found = is_echo(ping.image, self.style.echo_factor)[:, order].astype(np.float32)
            marked = (warp_to_fan(found, fan) > 0.5) & ~fan.outside  # noqa: PLR2004 the nearest
            frame[marked] = frame[marked] // 2 + np.array(MARK, dtype=np.uint8) // 2
        if self.style.labels:
            self._draw_rings(frame, fan, ping)
            self._draw_spokes(frame, fan, ping)
            self._draw_caption(frame, ping)
        return frame

    @property
    def _unit_px(self) -> float:
        """Scale of lettering: 1 in a frame of 900 pixels."""
        return self.style.height_px / 900.0

    def _fan_for(self, ping: Ping, bearings_rad: NDArray[np.float64]) -> FanGeometry:
        key = (bearings_rad.tobytes(), ping.rows, ping.range_resolution_m)
        if self._fan is None or key != self._key:
            unit = self._unit_px
            margins = (0, 0, 0, 0)
            if self.style.labels:
                margins = (round(66 * unit), round(110 * unit), round(66 * unit), round(24 * unit))
            if self._size_px is None:
                self._size_px = _size_px(bearings_rad, self.style.height_px, margins)
            self._fan = fit_fan(bearings_rad, ping.max_range_m, self._size_px, margins)
            self._key = key
        return self._fan

    def _level(self, ping: Ping) -> NDArray[np.float32]:
        """Return float32 (rows, beams), normalised to 0 to 1 and clipped."""
        if self.style.gains_removed and ping.gains is not None:
            level = ping.amplitude()
            white = float(np.percentile(level, _BRIGHT_PERCENT)) or 1.0
        else:
            level = ping.image.astype(np.float32)
            white = float(ping.full_scale)
            if ping.bits_per_sample > 16:  # noqa: PLR2004 - far more depth than an image has
                white = float(np.percentile(level, _BRIGHT_PERCENT)) or 1.0
        share: NDArray[np.float32] = np.clip(level / np.float32(white), 0.0, 1.0)
        return share ** np.float32(self.style.gamma)

    def _coloured(
        self, level: NDArray[np.float32], outside: NDArray[np.bool_]
    ) -> NDArray[np.uint8]:
        grey = np.rint(level * 255.0).astype(np.uint8)
        colours = COLOURS[self.style.colours]
        frame: NDArray[Any] = (
            cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
            if colours is None
            else cv2.applyColorMap(grey, colours)
        )
        frame[outside] = BACKGROUND
        return frame

    def _draw_rings(self, frame: NDArray[np.uint8], fan: FanGeometry, ping: Ping) -> None:
        first, last = ping.beam_edges_rad()[[0, -1]]
        edges = np.linspace(float(first), float(last), 181)
        veil = frame.copy()
        for range_m in ring_ranges_m(ping.max_range_m):
            arc = np.array([fan.pixel(range_m, float(bearing)) for bearing in edges])
            _draw_line(veil, arc)
            x, y = fan.pixel(range_m, float(edges[-1]))
            position = (x + 6 * self._unit_px, y + 18 * self._unit_px)
            for picture in (frame, veil):
                self._write(picture, f"{range_m:g} m", position)
        frame[:] = cv2.addWeighted(veil, _LINE_SHARE, frame, 1.0 - _LINE_SHARE, 0.0)

    def _draw_spokes(self, frame: NDArray[np.uint8], fan: FanGeometry, ping: Ping) -> None:
        veil = frame.copy()
        bearings_deg = spoke_bearings_deg(ping.bearings_rad)
        for bearing_deg in bearings_deg:
            bearing_rad = float(np.radians(bearing_deg))
            ends = (0.0, ping.max_range_m)
            _draw_line(veil, np.array([fan.pixel(end, bearing_rad) for end in ends]))
        frame[:] = cv2.addWeighted(veil, _LINE_SHARE, frame, 1.0 - _LINE_SHARE, 0.0)
        for bearing_deg in bearings_deg:
            beyond_m = ping.max_range_m + 16 * self._unit_px * fan.metres_per_px
            x, y = fan.pixel(beyond_m, float(np.radians(bearing_deg)))
            self._write(frame, f"{bearing_deg:+d}" if bearing_deg else "0", (x, y), centred=True)

    def _draw_caption(self, frame: NDArray[np.uint8], ping: Ping) -> None:
        for index, line in enumerate(caption_lines(ping)):
            position = (16 * self._unit_px, (28 + 24 * index) * self._unit_px)
            self._write(frame, line, position)

    def _write(
        self,
        frame: NDArray[np.uint8],
        text: str,
        position: tuple[float, float],
        *,
        centred: bool = False,
    ) -> None:
        font, size = cv2.FONT_HERSHEY_SIMPLEX, 0.55 * self._unit_px
        x, y = position
        if centred:
            (width, height), _ = cv2.getTextSize(text, font, size, 1)
            x, y = x - width / 2, y + height / 2
        cv2.putText(frame, text, (round(x), round(y)), font, size, INK, 1, cv2.LINE_AA)


def _size_px(
    bearings_rad: NDArray[np.float64], height_px: int, margins: tuple[int, int, int, int]
) -> tuple[int, int]:
    """Return width and height, even as video codecs require, with the largest possible fan."""
    left, top, right, bottom = margins
    half = float(np.abs(np.sin(edges_rad(bearings_rad))).max())
    width = math.ceil(2.0 * (height_px - top - bottom) * half + left + right)
    least = height_px if left else 2
    return 2 * -(-max(width, least) // 2), 2 * (height_px // 2)


def warp_to_fan(level: NDArray[np.float32], fan: FanGeometry) -> NDArray[np.float32]:
    """Resample samples into a fan, bilinear. Rows too many for the image are averaged.

    Args:
        level: float32 (rows, beams), beams in order of bearing.
        fan: geometry of the image.

    Returns:
        float32 (fan.height_px, fan.width_px); outside the fan, the nearest sample.
    """
    rows, beams = level.shape
    most = max(1, 2 * fan.height_px)
    if rows > most:
        level = cv2.resize(level, (beams, most), interpolation=cv2.INTER_AREA).astype(np.float32)
        rows = most
    across = fan.beam
    down = np.clip(fan.row_share * rows - 0.5, 0.0, rows - 1.0).astype(np.float32)
    laid = cv2.remap(level, across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return laid.astype(np.float32, copy=False)


def _draw_line(frame: NDArray[np.uint8], points: NDArray[np.float64]) -> None:
    fixed = np.rint(points * 16.0).astype(np.int32).reshape(1, -1, 2)
    cv2.polylines(frame, [fixed[0]], False, LINE, 1, cv2.LINE_AA, 4)  # noqa: FBT003 - OpenCV's


_SPOKE_STEPS_DEG: Final = (5, 10, 15, 30, 45)
_MAX_SPOKES: Final = 9


def spoke_bearings_deg(bearings_rad: NDArray[np.float64]) -> list[int]:
    """Return at most nine integer bearings within the field of view, 0 among them if inside."""
    low, high = np.degrees(bearings_rad[[0, -1]])
    slack = 0.5
    for step in _SPOKE_STEPS_DEG:
        first = math.ceil((low - slack) / step)
        last = math.floor((high + slack) / step)
        if last - first < _MAX_SPOKES:
            return [step * index for index in range(first, last + 1)]
    return [0]
