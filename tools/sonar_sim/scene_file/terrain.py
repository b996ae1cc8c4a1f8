"""The floor: its height at any place, and its triangles."""

import math
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from sonar_sim.errors import SceneError
from sonar_sim.scene_file import schema
from sonar_sim.scene_file.shapes import sheet

Floats = NDArray[np.float64]
HeightOf = Callable[[Floats, Floats], Floats]
OCTAVE_WAVES = 12
MOST_OCTAVES = 12
"""Between the longest and the shortest waves: each costs as many sines of all points again."""
MOST_CELLS = 20_000_000


def height_of(terrain: schema.TerrainSection, folder: Path) -> HeightOf:
    """The floor's height, z up, as a function of x and y.

    Args:
        terrain: what the file says.
        folder: where its files are.

    Raises:
        SceneError: the terrain cannot be.
    """
    match terrain.relief:
        case schema.Flat(depth_m=depth_m):
            return lambda x_m, y_m: np.full(np.broadcast_shapes(x_m.shape, y_m.shape), -depth_m)
        case schema.Procedural() as relief:
            return _waves(relief)
        case schema.HeightField() as field:
            return _table(field, terrain, folder)


def floor_of(terrain: schema.TerrainSection, height_m: HeightOf) -> trimesh.Trimesh:
    """The floor's triangles.

    Raises:
        SceneError: the terrain has no area, or too many cells.
    """
    axes = [_steps(span, terrain.cell_m) for span in (terrain.x_m, terrain.y_m)]
    if len(axes[0]) * len(axes[1]) > MOST_CELLS:
        raise SceneError(f"{len(axes[0])} x {len(axes[1])} points: cell_m is too small")
    x, y = np.meshgrid(*axes, indexing="ij")
    return sheet(np.stack([x, y, height_m(x, y)], axis=-1))


def _steps(span_m: tuple[float, float], cell_m: float) -> Floats:
    low, high = span_m
    if not low < high:
        raise SceneError(f"a span from {low:g} to {high:g} m has no length")
    return np.linspace(low, high, max(1, round((high - low) / cell_m)) + 1)


def _waves(relief: schema.Procedural) -> HeightOf:
    """Sum of plane waves with random directions and phases, some an octave of length.

    Their amplitudes go as length^hurst, which makes a self-affine surface (Saupe 1988).
    """
    if relief.shortest_m > relief.longest_m:
        raise SceneError("the shortest waves are longer than the longest")
    least_m = relief.longest_m / 2.0**MOST_OCTAVES
    if relief.shortest_m < least_m:
        raise SceneError(
            f"shortest_m is {relief.shortest_m:g} m; with longest_m of {relief.longest_m:g} m it "
            f"must be at least {least_m:g} m"
        )
    octaves = math.log2(relief.longest_m / relief.shortest_m)
    count = OCTAVE_WAVES * (math.floor(octaves) + 1)
    generator = np.random.Generator(np.random.PCG64(relief.seed))
    length_m = relief.longest_m * 2.0 ** (-octaves * (np.arange(count) + 0.5) / count)
    direction = generator.uniform(0.0, 2.0 * math.pi, count)
    phase = generator.uniform(0.0, 2.0 * math.pi, count)
    amplitude_m = length_m**relief.hurst
    amplitude_m *= relief.relief_m / math.sqrt(np.sum(amplitude_m**2) / 2.0)
    waves = list(zip(2.0 * math.pi / length_m, direction, phase, amplitude_m, strict=True))
    if relief.ripples is not None:
        ripples = relief.ripples
        turn = math.radians(ripples.direction_deg)
        waves.append((2.0 * math.pi / ripples.length_m, turn, 0.0, ripples.height_m / 2.0))

    def height_m(x_m: Floats, y_m: Floats) -> Floats:
        east, north = relief.slope
        height: Floats = -relief.depth_m + east * x_m + north * y_m
        for k, turn, phase, amplitude in waves:
            along = math.cos(turn) * x_m + math.sin(turn) * y_m
            height = height + amplitude * np.sin(k * along + phase)
        return height

    return height_m


def _table(field: schema.HeightField, terrain: schema.TerrainSection, folder: Path) -> HeightOf:
    """Heights between the points of a table that fills the terrain's spans."""
    path = folder / field.file
    heights_m = _read_table(path) * field.scale + field.offset_m
    y_m, x_m = (
        np.linspace(*span, count)
        for span, count in zip((terrain.y_m, terrain.x_m), heights_m.shape, strict=True)
    )
    between = RegularGridInterpolator((y_m, x_m), heights_m, bounds_error=False, fill_value=None)
    return lambda x_m, y_m: np.asarray(between((y_m, x_m)), dtype=np.float64)


def _read_table(path: Path) -> Floats:
    try:
        if path.suffix == ".npy":
            table = np.load(path, allow_pickle=False)
        elif path.suffix == ".csv":
            with warnings.catch_warnings(action="error"):  # an empty file is no table
                table = np.loadtxt(path, delimiter=",", ndmin=2)
        else:
            raise SceneError(f"{path}: heights are read from .npy and .csv")
        heights = np.asarray(table, dtype=np.float64)
    except (OSError, ValueError, TypeError, EOFError, UserWarning) as error:
        raise SceneError(f"{path}: no table of heights: {error}") from error
    if heights.ndim != 2 or min(heights.shape) < 2 or not np.isfinite(heights).all():  # noqa: PLR2004 a table
        raise SceneError(f"{path}: heights must be a table of at least 2 x 2 finite numbers")
    return heights
