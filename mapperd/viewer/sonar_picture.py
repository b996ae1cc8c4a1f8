"""Draws a polar image of the sonar as a fan in true geometry, with range rings and detections."""

from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mapperd.client.validation import image_of
from mapperd.wire.messages import ImageMessage, ReturnsMessage
from oculus_driver.fan import FanGeometry, fit_fan, ring_ranges_m

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

__all__ = ["SonarPicture"]

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
    """Draws images; keeps the geometry of the last shape.

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
