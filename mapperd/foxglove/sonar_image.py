"""The sonar image for Foxglove: polar, and as a fan with range rings and detections over it."""

import math
from typing import Final

import numpy as np
from foxglove.messages import (
    Color,
    ImageAnnotations,
    Point2,
    PointsAnnotation,
    PointsAnnotationType,
    RawImage,
    TextAnnotation,
)
from numpy.typing import NDArray

from mapperd.foxglove.geometry import stamp
from mapperd.wire.messages import ImageMessage, ReturnsMessage
from oculus_driver.fan import ring_ranges_m

__all__ = ["FanShape", "annotations", "colour_image", "polar_image"]

GAMMA = 0.6
_LEVELS = 3.0 * (np.arange(256) / 255) ** GAMMA
COLOURS: Final = (np.clip(_LEVELS[:, None] - np.arange(3), 0.0, 1.0) * 255).astype(np.uint8)
"""Colours of the samples 0 to 255, (256, 3): black, red, yellow, white."""

RING = Color(r=0.6, g=0.7, b=0.8, a=0.6)
INK = Color(r=0.9, g=0.95, b=1.0, a=1.0)
BACKGROUND = Color(r=0.0, g=0.0, b=0.0, a=0.5)
DETECTION = Color(r=0.3, g=0.9, b=0.5, a=1.0)
RING_POINTS = 49
DETECTION_PX = 4.0
LETTERS_PX = 16.0


def polar_image(pixels: NDArray[np.uint8], frame: str, stamp_ns: int) -> RawImage:
    """Grey image message."""
    height, width = pixels.shape
    return RawImage(
        timestamp=stamp(stamp_ns),
        frame_id=frame,
        width=width,
        height=height,
        encoding="mono8",
        step=width,
        data=pixels.tobytes(),
    )


class FanShape:
    """Converts polar images to fan images; caches the lookup table of one shape."""

    def __init__(self) -> None:
        self._shape: tuple[int, int, bytes] | None = None
        self._source = np.zeros((0, 0), np.intp)

    def fan_image(self, image: ImageMessage, pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the image seen from above: sonar at the bottom centre, port left, black outside.

        Args:
            image: gives the bearings.
            pixels: (rows, beams).
        """
        shape = (image.rows, image.beams, image.bearings_rad)
        if shape != self._shape:
            self._source = _source(image)
            self._shape = shape
        return np.append(pixels.ravel(), np.uint8(0))[self._source]


def _source(image: ImageMessage) -> NDArray[np.intp]:
    """Index of the polar value of each pixel; one past the last is outside."""
    rows, beams = image.rows, image.beams
    bearings = np.frombuffer(image.bearings_rad, "<f4").astype(np.float64)
    low, high = _edges(bearings)
    half_width = _half_width(image)
    across = np.arange(-half_width, half_width) + 0.5
    ahead = (np.arange(rows) + 0.5)[::-1, None]
    row = np.floor(np.hypot(across, ahead)).astype(np.intp)
    bearing = np.arctan2(across, ahead)
    between = (bearings[1:] + bearings[:-1]) / 2
    beam = np.searchsorted(between, bearing)
    seen = (row < rows) & (bearing >= low) & (bearing <= high)
    return np.where(seen, row * beams + beam, rows * beams)


def _edges(bearings: NDArray[np.float64]) -> tuple[float, float]:
    """Bearings of the image's edges: half a beam spacing beyond the outer beams."""
    if len(bearings) == 1:
        return float(bearings[0]) - 0.01, float(bearings[0]) + 0.01
    low = bearings[0] - (bearings[1] - bearings[0]) / 2
    high = bearings[-1] + (bearings[-1] - bearings[-2]) / 2
    return float(low), float(high)


def _half_width(image: ImageMessage) -> int:
    """Half the width of the fan image, pixels; its height is the number of rows."""
    bearings = np.frombuffer(image.bearings_rad, "<f4").astype(np.float64)
    widest = min(max(map(abs, _edges(bearings))), math.pi / 2)
    return max(math.ceil(image.rows * math.sin(widest)), 1)


def colour_image(pixels: NDArray[np.uint8], frame: str, stamp_ns: int) -> RawImage:
    """Image message in the colours of `COLOURS`."""
    height, width = pixels.shape
    return RawImage(
        timestamp=stamp(stamp_ns),
        frame_id=frame,
        width=width,
        height=height,
        encoding="rgb8",
        step=3 * width,
        data=COLOURS[pixels].tobytes(),
    )


def annotations(image: ImageMessage, returns: ReturnsMessage) -> ImageAnnotations:
    """Return range rings with metres, and detections, in pixels of the fan image.

    Args:
        image: gives the geometry.
        returns: detections, in the sonar's frame.
    """
    low, high = _edges(np.frombuffer(image.bearings_rad, "<f4").astype(np.float64))
    bearings = np.linspace(low, high, RING_POINTS)
    rings, texts = [], []
    for range_m in ring_ranges_m(image.rows * image.range_resolution_m):
        arc = _pixels(image, range_m * np.cos(bearings), -range_m * np.sin(bearings))
        rings.append(_points(PointsAnnotationType.LineStrip, arc, RING, 1.0))
        text = TextAnnotation(
            position=arc[-1],
            text=f"{range_m:g} m",
            font_size=LETTERS_PX,
            text_color=INK,
            background_color=BACKGROUND,
        )
        texts.append(text)
    points_m = np.frombuffer(returns.points, "<f4").reshape(-1, 3).astype(np.float64)
    echoes = _pixels(image, points_m[:, 0], points_m[:, 1])
    detections = _points(PointsAnnotationType.Points, echoes, DETECTION, DETECTION_PX)
    return ImageAnnotations(
        timestamp=stamp(returns.stamp_ns), points=[*rings, detections], texts=texts
    )


def _pixels(
    image: ImageMessage, forward_m: NDArray[np.float64], port_m: NDArray[np.float64]
) -> list[Point2]:
    """Places in the fan image."""
    across = _half_width(image) - port_m / image.range_resolution_m
    down = image.rows - forward_m / image.range_resolution_m
    return [Point2(x=x, y=y) for x, y in zip(across.tolist(), down.tolist(), strict=True)]


def _points(
    kind: PointsAnnotationType, points: list[Point2], colour: Color, thickness_px: float
) -> PointsAnnotation:
    return PointsAnnotation(
        type=kind,
        points=points,
        outline_color=colour,
        outline_colors=[],
        fill_color=colour,
        thickness=thickness_px,
    )
