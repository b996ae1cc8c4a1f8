"""The directions into which a ping is traced, and the cell of directions that each stands for.

A line array measures the component of a direction along itself, which is cos(e) sin(b) and not
sin(b): an echo off the fan's plane shows at the bearing of its cone. So directions are counted in
s = -y (starboard) and w = z (up), and a cell covers ds dw / x of solid angle.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sonar_sim.scene.sonar import SonarSettings

MAX_ELEVATION_RAD = math.radians(40.0)
"""Out to the vertical pattern's first side lobe and a little beyond."""
USUAL_ELEVATIONS_RAD = (-MAX_ELEVATION_RAD, MAX_ELEVATION_RAD)
ALL_ELEVATIONS_RAD = (-math.pi / 2.0, math.pi / 2.0)
STEEP_STEP_RAD = math.radians(2.0)
"""Between rays of a column beyond `MAX_ELEVATION_RAD`, where few fans look."""
ELEVATIONS = 64
CENTRE_SINE = 0.3
"""Half of a column would reach so high if all its rays were as close as on the fan's plane."""
MARGIN_BEAMS = 12
"""Columns traced beyond each outermost beam: their main lobes reach out there."""
STRIPS = 4
MAX_FLAT_CELL = 0.05
"""A cell neither wider nor higher than this part of x² has the solid angle ds dw / x, to 0.03 %."""
MIN_CELL_SINE = 1e-5
"""A cell whose part of directions is narrower than this is left out."""


@dataclass(frozen=True, slots=True, eq=False)
class FanCells:
    """The cells of a fan before it was refined.

    Attributes:
        row_edges: sines of elevation between the rows, ascending, (rows + 1,).
        rays: of each cell; -1 where it holds no direction, (columns, rows).
    """

    row_edges: NDArray[np.float64]
    rays: NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class RayFan:
    """Rays, column after column, each column from below upwards.

    Attributes:
        directions: unit vectors in the sonar frame, (N, 3), float32.
        cell: s from, s to, w from, w to of each ray's cell, (N, 4), float32.
        column: of the echo grid, (N,), from 0.
        columns: beams and a margin on both sides.
        sine_pitch: of the columns.
        grid: of its cells.
        lean: by which a cell's s grows with w from its middle, and its w with s, (N, 2); None
            before the fan was refined: all cells are upright.
    """

    directions: NDArray[np.float32]
    cell: NDArray[np.float32]
    column: NDArray[np.int32]
    columns: int
    sine_pitch: float
    grid: FanCells
    lean: NDArray[np.float32] | None = None

    @property
    def first_sine(self) -> float:
        """Sine of the bearing of column 0."""
        return -0.5 * (self.columns - 1) * self.sine_pitch

    @property
    def solid_angle_sr(self) -> NDArray[np.float64]:
        """Solid angle of each ray's cell, (N,)."""
        return solid_angle_sr(*self.cell.T.astype(np.float64))


def solid_angle_sr(
    s_from: NDArray[np.float64],
    s_to: NDArray[np.float64],
    w_from: NDArray[np.float64],
    w_to: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Solid angle of cells, that part of them where s² + w² < 1, (N,).

    ds dw / x integrates to an arc sine over s, which stays right where x becomes 0; over w it is
    taken at the middles of `STRIPS`. Most cells are small and far from there: see `MAX_FLAT_CELL`.
    """
    wide, high = s_to - s_from, w_to - w_from
    s, w = (s_from + s_to) / 2.0, (w_from + w_to) / 2.0
    square = 1.0 - np.square(s) - np.square(w)
    angle = wide / np.sqrt(np.maximum(square, 1e-12))
    curved = np.maximum(wide, high) > MAX_FLAT_CELL * square
    if curved.any():
        angle[curved] = _swept_rad(s_from[curved], s_to[curved], w_from[curved], w_to[curved])
    whole: NDArray[np.float64] = angle * high
    return whole


def _swept_rad(
    s_from: NDArray[np.float64],
    s_to: NDArray[np.float64],
    w_from: NDArray[np.float64],
    w_to: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Angle about the axis of w that cells sweep, the mean over their w, (N,)."""
    angle = np.zeros(len(s_from))
    for part in (np.arange(STRIPS) + 0.5) / STRIPS:
        w = w_from + part * (w_to - w_from)
        most = np.sqrt(np.maximum(1.0 - w**2, 1e-12))
        sweep = np.arcsin(np.clip(s_to / most, -1.0, 1.0))
        angle += sweep - np.arcsin(np.clip(s_from / most, -1.0, 1.0))
    return angle / STRIPS


@lru_cache(maxsize=64)
def ray_fan(
    sonar: SonarSettings,
    elevations: int = ELEVATIONS,
    limits_rad: tuple[float, float] = USUAL_ELEVATIONS_RAD,
) -> RayFan:
    """Lay the rays: one a beam pitch across, closest in the vertical pattern's main lobe.

    Args:
        sonar: its beams.
        elevations: rays of a column up to `MAX_ELEVATION_RAD` on both sides of the fan's plane.
        limits_rad: lowest and highest elevation that rays cover. They cover no less than
            `USUAL_ELEVATIONS_RAD`, and beyond it whole steps of `STEEP_STEP_RAD`.
    """
    columns = sonar.beams + 2 * MARGIN_BEAMS
    column = np.arange(columns, dtype=np.int32)
    s = (column - (columns - 1) / 2.0) * sonar.sine_pitch
    edges = _up_sines(elevations)
    below, above = (_steep_sines(limit) for limit in (-limits_rad[0], limits_rad[1]))
    edges = np.concatenate([-below[::-1], edges, above])
    w, w_half = (edges[1:] + edges[:-1]) / 2.0, np.diff(edges) / 2.0
    ss, ww = (grid.ravel() for grid in np.meshgrid(s, w, indexing="ij"))
    # Cones near the array's axis hold no direction at high elevation: the last cells of a row are
    # cut, and looked into where they hold some.
    half = sonar.sine_pitch / 2.0
    halves = np.tile(w_half, columns)
    lowest = np.maximum(np.abs(ww) - halves, 0.0)
    real = np.abs(ss) - half < np.sqrt(1.0 - lowest**2) - MIN_CELL_SINE
    ss, ww, halves = ss[real], ww[real], halves[real]
    most = np.sqrt(1.0 - ww**2)
    middle = (np.clip(ss - half, -most, most) + np.clip(ss + half, -most, most)) / 2.0
    rays = np.where(real, np.cumsum(real, dtype=np.int32) - 1, -1).astype(np.int32)
    directions, cell = _rays(middle, ww, (ss - half, ss + half), halves)
    ray_column = np.repeat(column, len(w))[real]
    for shared in (directions, cell, ray_column, edges, rays):
        shared.setflags(write=False)
    grid = FanCells(edges, rays.reshape(columns, len(w)))
    return RayFan(directions, cell, ray_column, columns, sonar.sine_pitch, grid)


def _up_sines(elevations: int) -> NDArray[np.float64]:
    """Edges of a column's cells, sines of elevation, (elevations + 1,)."""
    part = np.linspace(-1.0, 1.0, elevations + 1)
    sines: NDArray[np.float64] = (
        CENTRE_SINE * part + (math.sin(MAX_ELEVATION_RAD) - CENTRE_SINE) * part**5
    )
    return sines


def _steep_sines(limit_rad: float) -> NDArray[np.float64]:
    """Upper edges of the cells from `MAX_ELEVATION_RAD` to a limit, sines of elevation."""
    rows = math.ceil((limit_rad - MAX_ELEVATION_RAD) / STEEP_STEP_RAD - 1e-6)
    sines: NDArray[np.float64] = np.sin(
        MAX_ELEVATION_RAD + STEEP_STEP_RAD * (np.arange(max(rows, 0)) + 1.0)
    )
    return sines


def _rays(
    s: NDArray[np.float64],
    w: NDArray[np.float64],
    edges: tuple[NDArray[np.float64], NDArray[np.float64]],
    half_w: NDArray[np.float64],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Directions and cells of rays at given sines, the cells between edges in s."""
    most = np.sqrt(1.0 - w**2) * (1.0 - MIN_CELL_SINE)
    s = np.clip(s, -most, most)
    ahead = np.sqrt(1.0 - s**2 - w**2)
    directions = np.stack([ahead, -s, w], axis=1).astype(np.float32)
    cell = np.stack([*edges, w - half_w, w + half_w], axis=1)
    return directions, cell.astype(np.float32)
