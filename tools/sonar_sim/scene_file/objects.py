"""Build a scene's objects: shapes and mesh files, placed and moving."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import msgspec
import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.ray.ray_util import contains_points

from sonar_sim.errors import SceneError
from sonar_sim.geometry.pose import rotation_of
from sonar_sim.geometry.trajectory import Drift, Motion, ObjectMotion, Tour, Trajectory, Waypoint
from sonar_sim.scene.material import Material
from sonar_sim.scene.scene import Surface
from sonar_sim.scene_file import schema
from sonar_sim.scene_file.shapes import HeightOf, triangles_of

FORMATS = {".stl", ".obj", ".ply", ".glb"}
SLIVER_M = 1e-9
"""Triangles less high than this have no area worth the name."""


def read_mesh(path: Path, scale: float = 1.0) -> trimesh.Trimesh:
    """Read a mesh; triangles without an area are left out, and all parts become one.

    Args:
        path: of an STL, OBJ, PLY or GLB file.
        scale: metres a unit of the file.

    Raises:
        SceneError: no such file or format, not finite, or nothing left of it.
    """
    if path.suffix.lower() not in FORMATS:
        raise SceneError(f"{path}: meshes are read from {', '.join(sorted(FORMATS))}")
    if not path.is_file():
        raise SceneError(f"{path}: there is no such file")
    try:
        mesh = trimesh.load_mesh(path, process=False)
        if isinstance(mesh, trimesh.Scene):
            mesh = mesh.to_mesh()
        vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3) * scale
        faces = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    except Exception as error:  # its readers raise whatever their formats' bytes lead them to
        raise SceneError(f"{path}: not a mesh: {error}") from error
    return clean_mesh(vertices, faces, str(path))


def clean_mesh(vertices: np.ndarray, faces: np.ndarray, name: str) -> trimesh.Trimesh:
    """Leave out triangles without an area.

    Raises:
        SceneError: a vertex is not finite, an index is out of range, or nothing is left.
    """
    if faces.size and not 0 <= faces.min() <= faces.max() < len(vertices):
        raise SceneError(f"{name}: a triangle names a vertex that does not exist")
    used = vertices[np.unique(faces)]
    if not np.isfinite(used).all():
        raise SceneError(f"{name}: {np.sum(~np.isfinite(used).all(axis=1))} vertices not finite")
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.remove_unreferenced_vertices()
    if len(mesh.faces):
        mesh.update_faces(mesh.nondegenerate_faces(height=SLIVER_M))
    if not len(mesh.faces):
        raise SceneError(f"{name}: no triangle with an area")
    return mesh


Triple = tuple[float, float, float]


def path_of(section: schema.PathSection) -> Trajectory:
    """Build a path.

    Raises:
        SceneError: it has no two waypoints that differ.
    """
    waypoints = [Waypoint(*w.position_m, w.yaw_deg, w.roll_deg) for w in section.waypoints]
    if len(set(waypoints)) < 2:  # noqa: PLR2004 a path has two ends
        raise SceneError("a path needs two waypoints that differ")
    motion = Motion(
        section.speed_mps,
        section.turn_rate_dps,
        section.smoothing_s,
        section.sway_deg,
        section.heave_m,
    )
    return Trajectory(waypoints, motion)


def motion_of(
    section: schema.DriftMotion | schema.TourMotion | None,
    position_m: Triple,
    roll_pitch_yaw_deg: Triple,
) -> ObjectMotion | None:
    """Build a motion that begins at a place; a tour has its own.

    Raises:
        SceneError: its path cannot be.
    """
    match section:
        case None:
            return None
        case schema.TourMotion(path=path):
            return Tour(path_of(path))
        case schema.DriftMotion():
            return Drift(
                position_m,
                *roll_pitch_yaw_deg,
                velocity_mps=section.velocity_mps,
                yaw_rate_dps=section.yaw_rate_dps,
                swing_m=section.swing_m,
                swing_deg=section.swing_deg,
                period_s=section.period_s,
                phase_deg=section.phase_deg,
            )


MAX_ROUNDS = 20
"""Of cutting triangles in halves."""
SIGHT_LINES = ((0.44, 0.62, 0.65), (-0.27, 0.83, 0.48), (0.71, -0.19, 0.67))
"""Directions in which a body's walls are counted from a point."""


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """One object.

    Attributes:
        surface: what echoes.
        whole: its mesh in the map, with the parts that the floor hides; None if it moves.
    """

    surface: Surface
    whole: trimesh.Trimesh | None


def place(
    section: schema.ObjectSection, material: Material, floor_m: HeightOf | None, folder: Path
) -> Iterator[Placed]:
    """Build an object and its copies.

    Args:
        section: the object's section of the file.
        material: of its name.
        floor_m: height of the floor, None without a floor.
        folder: where its files are.

    Raises:
        SceneError: the object cannot be.
    """
    mesh = _mesh(section, floor_m, folder)
    repeat = section.repeat or schema.Repeat(count=1, step_m=(0.0, 0.0, 0.0))
    for k in range(repeat.count):
        name = section.name if section.repeat is None else f"{section.name} {k + 1}"
        position_m = np.array(section.position_m) + k * np.array(repeat.step_m)
        one = msgspec.structs.replace(section, name=name, position_m=tuple(position_m.tolist()))
        yield _at(one, mesh, material, floor_m)


def _at(
    section: schema.ObjectSection,
    mesh: trimesh.Trimesh,
    material: Material,
    floor_m: HeightOf | None,
) -> Placed:
    position_m = np.array(section.position_m)
    if section.on_floor:
        if floor_m is None:
            raise SceneError("nothing can stand on_floor where there is no terrain")
        position_m[2] += float(floor_m(position_m[:1], position_m[1:2])[0])
    attitude_deg = (section.roll_deg, section.pitch_deg, section.yaw_deg)
    x, y, z = (float(p) for p in position_m)
    motion = motion_of(section.motion, (x, y, z), attitude_deg)
    if motion is not None:
        return Placed(
            surface_of(section.name, mesh, material, smooth=section.smooth, motion=motion), None
        )
    whole = _turned(mesh, position_m, attitude_deg)
    seen = _in_water(whole, floor_m)
    if not len(seen.faces):
        raise SceneError("nothing of it is between the floor and the water's surface")
    return Placed(surface_of(section.name, seen, material, smooth=section.smooth), whole)


def without_hidden(floor: trimesh.Trimesh, objects: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    """The floor without the triangles that lie inside closed objects: nothing ever sees them."""
    inside = np.zeros(len(floor.vertices), dtype=bool)
    for body in objects:
        low, high = body.bounds
        near = np.flatnonzero(np.all((floor.vertices >= low) & (floor.vertices <= high), axis=1))
        if len(near) and body.is_watertight:
            inside[near] |= _inside(body, floor.vertices[near])
    floor.update_faces(~np.all(inside[floor.faces], axis=1))
    return floor


def _inside(body: trimesh.Trimesh, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which points lie inside, (N,).

    A ray along an edge may count a crossing twice; `body.contains` asks again in a direction drawn
    at random then, and a scene would have other triangles at each loading.
    """
    votes = np.zeros(len(points), dtype=np.int64)
    for direction in SIGHT_LINES:
        votes += contains_points(body.ray, points, direction)
    most: NDArray[np.bool_] = 2 * votes > len(SIGHT_LINES)
    return most


def surface_of(
    name: str,
    mesh: trimesh.Trimesh,
    material: Material,
    *,
    smooth: bool = False,
    motion: ObjectMotion | None = None,
) -> Surface:
    """Make a mesh a surface; points that no triangle uses are left out."""
    used, faces = np.unique(mesh.faces, return_inverse=True)
    vertices_m = np.asarray(mesh.vertices, dtype=np.float64)[used]
    return Surface(
        name, vertices_m, faces.reshape(-1, 3).astype(np.int64), material, smooth, motion
    )


def _mesh(section: schema.ObjectSection, floor_m: HeightOf | None, folder: Path) -> trimesh.Trimesh:
    mesh = _shaped(section.shape, floor_m, folder)
    if section.cell_m is None:
        return mesh
    vertices, faces = trimesh.remesh.subdivide_to_size(  # type: ignore[no-untyped-call]
        mesh.vertices, mesh.faces, section.cell_m, max_iter=MAX_ROUNDS
    )
    fine = trimesh.Trimesh(vertices, faces, process=False)
    fine.merge_vertices()
    return fine


def _shaped(shape: schema.Shape, floor_m: HeightOf | None, folder: Path) -> trimesh.Trimesh:
    match shape:
        case schema.Mesh(file=file, scale=scale):
            mesh = read_mesh(folder / file, scale)
        case schema.ShapeGroup(parts=parts):
            meshes = [_part(part, floor_m, folder) for part in parts]
            mesh = cast("trimesh.Trimesh", trimesh.util.concatenate(meshes))
        case _:
            mesh = triangles_of(shape, floor_m)
    return mesh


def _part(part: schema.ShapePart, floor_m: HeightOf | None, folder: Path) -> trimesh.Trimesh:
    mesh = _shaped(part.shape, floor_m, folder)
    return _turned(mesh, np.array(part.position_m), (part.roll_deg, part.pitch_deg, part.yaw_deg))


def _turned(
    mesh: trimesh.Trimesh, position_m: NDArray[np.float64], attitude_deg: Triple
) -> trimesh.Trimesh:
    transform = np.eye(4)
    transform[:3, :3] = rotation_of(*(math.radians(angle) for angle in attitude_deg))
    transform[:3, 3] = position_m
    moved = mesh.copy()
    moved.apply_transform(transform)
    return moved


def _in_water(whole: trimesh.Trimesh, floor_m: HeightOf | None) -> trimesh.Trimesh:
    """What of a mesh is above the floor and under the water's surface, by whole triangles."""
    x, y, z = whole.vertices.T
    below = np.zeros(len(z), dtype=bool) if floor_m is None else z < floor_m(x, y)
    hidden = np.all(below[whole.faces], axis=1) | np.all((z >= 0.0)[whole.faces], axis=1)
    seen = whole.copy()
    seen.update_faces(~hidden)
    return seen
