"""Build shapes and terrain as meshes."""

import itertools
import math
from pathlib import Path
from typing import cast

import numpy as np
import trimesh

from sonar_sim.errors import SceneError
from sonar_sim.scene_file import schema
from sonar_sim.scene_file.height_maps import Floats, HeightOf, measured_height

HULL_STATIONS, HULL_LINES = 64, 24
WIDEST_FACET = 0.87
"""Of a cell: a facet as wide leaves its rings half a cell."""


def triangles_of(
    shape: schema.BuiltShape, floor_m: HeightOf | None, cell_m: float | None = None
) -> trimesh.Trimesh:
    """Build a shape that needs no file.

    Args:
        shape: the shape's section of the file.
        floor_m: for pipes that follow the floor.
        cell_m: edges will be halved until none is longer. Cylinders and discs get rings for that,
            so that halving leaves fewer triangles.

    Raises:
        SceneError: the shape cannot be.
    """
    match shape:
        case schema.Box():
            mesh = _solid(trimesh.creation.box(extents=shape.size_m))
        case schema.Cylinder():
            mesh = _cylinder(shape, cell_m)
        case schema.Sphere():
            mesh = _sphere(shape)
        case schema.Capsule():
            mesh = _capsule(shape)
        case schema.Pipe():
            mesh = _pipe(shape, floor_m)
        case schema.Sheet():
            mesh = _rectangle(shape)
        case schema.Disc():
            mesh = _turned(((0.0, 0.0), (shape.radius_m, 0.0)), shape.facets, cell_m)
        case schema.Hull():
            mesh = _hull(shape)
    return mesh


def sheet(points_m: Floats) -> trimesh.Trimesh:
    """Triangles between the points of a grid, (M, N, 3); those without an area are left out."""
    m, n = points_m.shape[:2]
    index = np.arange(m * n).reshape(m, n)
    a, b = index[:-1, :-1].ravel(), index[1:, :-1].ravel()
    c, d = index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    mesh = trimesh.Trimesh(points_m.reshape(-1, 3), faces, process=False)
    mesh.update_faces(mesh.nondegenerate_faces(height=1e-9))
    return mesh


def _rectangle(shape: schema.Sheet) -> trimesh.Trimesh:
    half = np.array(shape.size_m) / 2.0
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]]) * half
    return sheet(np.pad(corners, ((0, 0), (0, 1))).reshape(2, 2, 3))


def _turned(
    profile: tuple[tuple[float, float], ...], facets: int, cell_m: float | None = None
) -> trimesh.Trimesh:
    """Turn a profile of (radius, z) about the z axis; seam and poles are closed.

    With `cell_m` each straight part of it has so many rings that halving all edges, as often as
    the facets' width needs it, leaves no diagonal longer.
    """
    if cell_m is not None:
        profile = _with_rings(profile, facets, cell_m)
    angle = np.linspace(0.0, 2.0 * math.pi, facets, endpoint=False)
    angle = np.append(angle, 0.0)  # the seam's points are the first ones, to the bit
    radius, z = np.array(profile).T
    x, y = radius[:, None] * np.cos(angle), radius[:, None] * np.sin(angle)
    mesh = sheet(np.stack([x, y, np.broadcast_to(z[:, None], x.shape)], axis=-1))
    mesh.merge_vertices()
    return mesh


def _with_rings(
    profile: tuple[tuple[float, float], ...], facets: int, cell_m: float
) -> tuple[tuple[float, float], ...]:
    points = [profile[0]]
    for start, end in itertools.pairwise(profile):
        facet_m = 2.0 * max(start[0], end[0]) * math.sin(math.pi / facets)
        halvings = max(0, math.ceil(math.log2(max(facet_m, 1e-9) / (WIDEST_FACET * cell_m))))
        part_m = facet_m / 2.0**halvings
        step_m = 2.0**halvings * math.sqrt(cell_m**2 - part_m**2) * (1.0 - 1e-9)
        count = max(1, math.ceil(math.dist(start, end) / step_m))
        points += [tuple(row) for row in np.linspace(start, end, count + 1)[1:].tolist()]
    return tuple(points)


def _cylinder(shape: schema.Cylinder, cell_m: float | None) -> trimesh.Trimesh:
    top_m = shape.radius_m if shape.top_radius_m is None else shape.top_radius_m
    half_m = shape.height_m / 2.0
    side = ((shape.radius_m, -half_m), (top_m, half_m))
    if shape.open:
        return _turned(side, shape.facets, cell_m)
    return _turned(((0.0, -half_m), *side, (0.0, half_m)), shape.facets, cell_m)


def _sphere(shape: schema.Sphere) -> trimesh.Trimesh:
    radii = np.broadcast_to(np.asarray(shape.radius_m, dtype=np.float64), 3)
    if not np.all((radii > 0.0) & (radii <= 1e4)):  # noqa: PLR2004 the message states it
        raise SceneError(f"radius_m {radii.tolist()} is not 0 to 10000 m")
    mesh = _solid(trimesh.creation.icosphere(subdivisions=shape.subdivisions, radius=1.0))
    mesh.vertices *= radii
    return mesh


def _capsule(shape: schema.Capsule) -> trimesh.Trimesh:
    start, end = np.array(shape.start_m), np.array(shape.end_m)
    length_m = float(np.linalg.norm(end - start))
    if length_m == 0.0:
        raise SceneError("a capsule's ends are the same point")
    arcs = np.linspace(0.0, math.pi / 2.0, max(3, shape.facets // 4))
    foot = [(shape.radius_m * math.sin(a), -shape.radius_m * math.cos(a)) for a in arcs]
    head = [(radius, length_m - z) for radius, z in reversed(foot)]
    mesh = _turned((*foot, *head), shape.facets)
    turn = trimesh.geometry.align_vectors([0, 0, 1], end - start)  # type: ignore[no-untyped-call]
    transform = np.asarray(turn)
    transform[:3, 3] = start
    mesh.apply_transform(transform)
    return mesh


def _pipe(shape: schema.Pipe, floor_m: HeightOf | None) -> trimesh.Trimesh:
    """Rings about the axis, carried along it without twist."""
    axis = np.array(shape.points_m, dtype=np.float64)
    if len(axis) < 2:  # noqa: PLR2004 a line has two ends
        raise SceneError("a pipe needs at least two points")
    if shape.follow_floor:
        if floor_m is None:
            raise SceneError("a pipe can only follow a terrain")
        axis[:, 2] += floor_m(axis[:, 0], axis[:, 1])
    if np.any(np.linalg.norm(np.diff(axis, axis=0), axis=1) == 0.0):
        raise SceneError("a pipe passes the same point twice in a row")
    tangent = np.gradient(axis, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent[0], [0.0, 0.0, 1.0])
    if np.linalg.norm(side) < 1e-6:  # noqa: PLR2004 an upright pipe
        side = np.array([1.0, 0.0, 0.0])
    angle = np.append(np.linspace(0.0, 2.0 * math.pi, shape.facets, endpoint=False), 0.0)
    rings = []
    for point, along in zip(axis, tangent, strict=True):
        side = side - along * (side @ along)
        side /= np.linalg.norm(side)
        up = np.cross(side, along)
        rings.append(
            point + shape.radius_m * (np.outer(np.cos(angle), side) + np.outer(np.sin(angle), up))
        )
    ends = [np.broadcast_to(axis[k], (len(angle), 3)) for k in (0, -1)]
    mesh = sheet(np.stack([ends[0], *rings, ends[1]]))
    mesh.merge_vertices()
    return mesh


def _hull(shape: schema.Hull) -> trimesh.Trimesh:
    """Y = ± B/2 (1 - (2x/L)²)(1 - (z/T)²) below the water line, upright above (Wigley 1934)."""
    x = np.linspace(-shape.length_m / 2.0, shape.length_m / 2.0, HULL_STATIONS)
    z = np.linspace(-shape.draught_m, 0.0, HULL_LINES)
    if shape.freeboard_m > 0.0:
        z = np.append(z, shape.freeboard_m)
    gx, gz = np.meshgrid(x, z, indexing="ij")
    below = np.minimum(gz / shape.draught_m, 0.0)
    half_m = shape.beam_m / 2.0 * (1.0 - (2.0 * gx / shape.length_m) ** 2) * (1.0 - below**2)
    port = np.stack([gx, half_m, gz], axis=-1)
    starboard = port * (1.0, -1.0, 1.0)
    sides = [starboard[:, ::-1], port[:, 1:]]  # over the keel from deck to deck
    if shape.freeboard_m > 0.0:
        sides.append(starboard[:, -1:])  # and back over the deck
    mesh = sheet(np.concatenate(sides, axis=1))
    mesh.merge_vertices()
    return mesh


def _solid(made: object) -> trimesh.Trimesh:
    return cast("trimesh.Trimesh", made)


OCTAVE_WAVES = 12
MAX_OCTAVES = 12
"""Between the longest and the shortest waves: each costs as many sines of all points again."""
MAX_CELLS = 20_000_000


def height_of(terrain: schema.TerrainSection, folder: Path) -> HeightOf:
    """The floor's height, z up, as a function of x and y.

    Args:
        terrain: the terrain's section of the file.
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
            return measured_height(field, terrain, folder)


def floor_of(terrain: schema.TerrainSection, height_m: HeightOf) -> trimesh.Trimesh:
    """The floor's triangles.

    Raises:
        SceneError: the terrain has no area, or too many cells.
    """
    axes = [_steps(span, terrain.cell_m) for span in (terrain.x_m, terrain.y_m)]
    if len(axes[0]) * len(axes[1]) > MAX_CELLS:
        raise SceneError(f"{len(axes[0])} x {len(axes[1])} points: cell_m is too small")
    x, y = np.meshgrid(*axes, indexing="ij")
    z = height_m(x, y)
    if np.isfinite(z).all():
        return sheet(np.stack([x, y, z], axis=-1))
    floor = sheet(np.stack([x, y, np.nan_to_num(z)], axis=-1))
    floor.update_faces(np.isfinite(z).ravel()[floor.faces].all(axis=1))
    if not len(floor.faces):
        raise SceneError("there are no heights between x_m and y_m")
    return floor


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
    min_m = relief.longest_m / 2.0**MAX_OCTAVES
    if relief.shortest_m < min_m:
        raise SceneError(
            f"shortest_m is {relief.shortest_m:g} m; with longest_m of {relief.longest_m:g} m it "
            f"must be at least {min_m:g} m"
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
