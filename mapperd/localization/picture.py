"""Localization as a picture: the map, the scan, particles, the best pose and where it came from.

x to the right, y up. The map is cut to what is known of it, and made coarser until it fits.
"""

import math
from collections import deque
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mapperd.geometry.gaussian import PlanarGaussian
from mapperd.localization.maps import OCCUPIED, UNKNOWN, GridMap
from mapperd.localization.status import LocalizationSnapshot

__all__ = ["Trail", "localization_picture"]

Floats = NDArray[np.float64]
Picture = NDArray[np.uint8]
Colour = tuple[int, int, int]

MAX_PIXELS: Final = 800
"""Along the longer side."""

MIN_PIXELS: Final = 400
"""Along it, where cells are few: a cell is then several pixels."""

MAX_STEPS: Final = 2 * MAX_PIXELS
"""Of a line from one point to the next."""

WATER, WALL, NOWHERE = (238, 238, 238), (40, 40, 40), (190, 190, 190)
PARTICLE, SCAN, PATH, POSE = (60, 110, 220), (30, 150, 60), (230, 150, 20), (210, 30, 30)

SIGMAS = 2.0
HEADING_M = 1.0
TURN = np.linspace(0.0, 2 * math.pi, 181)


class Trail:
    """Where the vehicle was believed to be, the newest places.

    Args:
        max_places: places that are kept.
    """

    def __init__(self, max_places: int = 1000) -> None:
        self._places: deque[tuple[float, float]] = deque(maxlen=max_places)

    def add(self, pose: PlanarGaussian) -> None:
        """Add a position, unless it has not moved."""
        place = (pose.x_m, pose.y_m)
        if not self._places or place != self._places[-1]:
            self._places.append(place)

    def points_m(self) -> Floats:
        """(N, 2), oldest first."""
        return np.array(self._places, dtype=np.float64).reshape(-1, 2)


def localization_picture(snapshot: LocalizationSnapshot, trail_m: Floats) -> Picture | None:
    """Draw; (rows, columns, 3) with row 0 the far end of y. None without a map.

    Args:
        snapshot: what there is.
        trail_m: (N, 2) places before, map frame.
    """
    if snapshot.known is None:
        return None
    canvas = _Canvas(snapshot.known.grid)
    canvas.line(trail_m, PATH)
    canvas.dots(snapshot.particles[:, :2], PARTICLE, 1)
    if snapshot.scan_points_m is not None:
        canvas.dots(snapshot.scan_points_m[:, :2], SCAN, 2)
    if snapshot.belief is not None:
        best = snapshot.belief.best
        canvas.line(_ellipse(best), POSE)
        canvas.line(_heading(best), POSE)
        canvas.dots(np.array([[best.x_m, best.y_m]]), POSE, 5)
    return np.ascontiguousarray(canvas.image[::-1])


class _Canvas:
    """A map's cells as pixels, row 0 at its origin, to be drawn upon in the map's frame."""

    def __init__(self, grid: GridMap) -> None:
        known = grid.occupancy != UNKNOWN
        rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
        row, column = (int(part[0]) if len(part) else 0 for part in (rows, columns))
        cut = grid.occupancy
        if len(rows):
            cut = cut[row : rows[-1] + 1, column : columns[-1] + 1]
        coarser = max(1, -(-max(cut.shape) // MAX_PIXELS))
        finer = max(1, MIN_PIXELS // max(cut.shape)) if coarser == 1 else 1
        self.image = _coloured(_coarse(cut, coarser)).repeat(finer, 0).repeat(finer, 1)
        self._grid = grid
        self._first = np.array([column, row], dtype=np.float64)
        self._pixel_m = grid.resolution_m * coarser / finer

    def dots(self, points_m: Floats, colour: Colour, size: int) -> None:
        """Draw squares around points (N, 2)."""
        pixels = np.floor(self._pixels(points_m[np.isfinite(points_m).all(axis=1)]))
        reach = np.arange(size) - size // 2
        for d_row in reach:
            for d_column in reach:
                self._set(pixels + np.array([d_column, d_row]), colour)

    def line(self, points_m: Floats, colour: Colour) -> None:
        """Draw from point to point, at least two of (N, 2)."""
        steps = np.diff(points_m, axis=0)
        count = np.hypot(steps[:, 0], steps[:, 1]) / self._pixel_m
        count = np.clip(np.ceil(count), 1, MAX_STEPS).astype(np.int64)
        piece = np.repeat(np.arange(len(steps)), count)
        along = np.arange(len(piece)) - (np.cumsum(count) - count)[piece]
        share = (along / count[piece])[:, None]
        self.dots(points_m[piece] + share * steps[piece], colour, 2)

    def _pixels(self, points_m: Floats) -> Floats:
        """Columns and rows (N, 2)."""
        grid = self._grid
        c, s = math.cos(grid.origin_yaw_rad), math.sin(grid.origin_yaw_rad)
        offset = points_m - (grid.origin_x_m, grid.origin_y_m)
        local = offset @ np.array([[c, -s], [s, c]])
        shifted: Floats = (local - self._first * grid.resolution_m) / self._pixel_m
        return shifted

    def _set(self, pixels: Floats, colour: Colour) -> None:
        rows, columns = self.image.shape[:2]
        inside = ((pixels >= 0) & (pixels < (columns, rows))).all(axis=1)
        column, row = pixels[inside].astype(np.int64).T
        self.image[row, column] = colour


def _coarse(cells: NDArray[np.int8], by: int) -> NDArray[np.int8]:
    """Blocks of cells as one: the most occupied counts, so that thin walls stay."""
    rows, columns = (-(-length // by) * by for length in cells.shape)
    padded = np.full((rows, columns), UNKNOWN, np.int8)
    padded[: cells.shape[0], : cells.shape[1]] = cells
    blocks: NDArray[np.int8] = padded.reshape(rows // by, by, columns // by, by).max(axis=(1, 3))
    return blocks


def _coloured(cells: NDArray[np.int8]) -> Picture:
    """Unknown grey; from water to wall by how occupied it is."""
    share = np.clip(cells, 0, OCCUPIED)[:, :, None] / OCCUPIED
    image = np.asarray(WATER) * (1 - share) + np.asarray(WALL) * share
    image[cells == UNKNOWN] = NOWHERE
    return image.astype(np.uint8)


def _ellipse(pose: PlanarGaussian) -> Floats:
    """Of `SIGMAS` standard deviations of the place, a closed line (N, 2)."""
    variances, axes = np.linalg.eigh(pose.covariance[:2, :2])
    reach = SIGMAS * np.sqrt(np.maximum(variances, 0.0))
    circle = np.stack([np.cos(TURN), np.sin(TURN)], axis=1)
    points: Floats = (circle * reach) @ axes.T + (pose.x_m, pose.y_m)
    return points


def _heading(pose: PlanarGaussian) -> Floats:
    ahead = HEADING_M * np.array([math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)])
    place = np.array([pose.x_m, pose.y_m])
    return np.stack([place, place + ahead])
