"""Build a scene's objects: shapes and mesh files, placed and moving."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
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
from sonar_sim.scene_file.height_maps import HeightOf
from sonar_sim.scene_file.mesh_files import read_parts
from sonar_sim.scene_file.shapes import triangles_of

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
        surfaces: what echoes, one for each material.
        whole: its mesh in the map, with the parts that the floor hides; None if it moves.
    """

    surfaces: tuple[Surface, ...]
    whole: trimesh.Trimesh | None


def place(
    section: schema.ObjectSection,
    materials: Mapping[str, Material],
    floor_m: HeightOf | None,
    folder: Path,
) -> Iterator[Placed]:
    """Build an object and its copies.

    Args:
        section: the object's section of the file.
        materials: all of the scene, by name.
        floor_m: height of the floor, None without a floor.
        folder: where its files are.

    Raises:
        SceneError: the object cannot be.
    """
    meshes = _meshes(section, materials, floor_m, folder)
    repeat = section.repeat or schema.Repeat(count=1, step_m=(0.0, 0.0, 0.0))
    for k in range(repeat.count):
        name = section.name if section.repeat is None else f"{section.name} {k + 1}"
        position_m = np.array(section.position_m) + k * np.array(repeat.step_m)
        one = msgspec.structs.replace(section, name=name, position_m=tuple(position_m.tolist()))
        yield _at(one, meshes, materials, floor_m)


def named_material(name: str, materials: Mapping[str, Material]) -> Material:
    """Return the material of a name.

    Raises:
        SceneError: there is none.
    """
    if name not in materials:
        raise SceneError(f"no material is called {name}; there are {', '.join(materials)}")
    return materials[name]


def _at(
    section: schema.ObjectSection,
    meshes: Mapping[str, trimesh.Trimesh],
    materials: Mapping[str, Material],
    floor_m: HeightOf | None,
) -> Placed:
    position_m = np.array(section.position_m)
    if section.on_floor:
        if floor_m is None:
            raise SceneError("nothing can stand on_floor where there is no terrain")
        position_m[2] += float(floor_m(position_m[:1], position_m[1:2])[0])
        if not math.isfinite(position_m[2]):
            raise SceneError("nothing can stand on_floor where the terrain has no data")
    attitude_deg = (section.roll_deg, section.pitch_deg, section.yaw_deg)
    x, y, z = (float(p) for p in position_m)
    motion = motion_of(section.motion, (x, y, z), attitude_deg)
    wholes = dict(meshes)
    if motion is None:
        wholes = {key: _turned(mesh, position_m, attitude_deg) for key, mesh in meshes.items()}
    seen = wholes
    if motion is None:
        seen = {key: _in_water(mesh, floor_m) for key, mesh in wholes.items()}
        seen = {key: mesh for key, mesh in seen.items() if len(mesh.faces)}
    if not seen:
        raise SceneError("nothing of it is between the floor and the water's surface")
    surfaces = tuple(
        surface_of(
            section.name if len(meshes) == 1 else f"{section.name}: {key}",
            mesh,
            materials[key],
            smooth=section.smooth,
            motion=motion,
        )
        for key, mesh in seen.items()
    )
    return Placed(surfaces, _whole(wholes.values()) if motion is None else None)


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


def _meshes(
    section: schema.ObjectSection,
    materials: Mapping[str, Material],
    floor_m: HeightOf | None,
    folder: Path,
) -> dict[str, trimesh.Trimesh]:
    """Build an object's triangles by the names of their materials, in the object's frame."""
    pieces: dict[str, list[trimesh.Trimesh]] = {}
    made = _shaped(
        section.shape, section.material, materials, floor_m, folder, cell_m=section.cell_m
    )
    for material, mesh in made:
        named_material(material, materials)
        pieces.setdefault(material, []).append(mesh)
    meshes = {material: _joined(parts) for material, parts in pieces.items()}
    if section.cell_m is None:
        return meshes
    return {material: _cut(mesh, section.cell_m) for material, mesh in meshes.items()}


def _cut(mesh: trimesh.Trimesh, cell_m: float) -> trimesh.Trimesh:
    vertices, faces = trimesh.remesh.subdivide_to_size(  # type: ignore[no-untyped-call]
        mesh.vertices, mesh.faces, cell_m, max_iter=MAX_ROUNDS
    )
    fine = trimesh.Trimesh(vertices, faces, process=False)
    fine.merge_vertices()
    return fine


_Piece = tuple[str, trimesh.Trimesh]
"""Name of a material, and triangles of it."""


def _shaped(
    shape: schema.Shape,
    material: str,
    materials: Mapping[str, Material],
    floor_m: HeightOf | None,
    folder: Path,
    *,
    cell_m: float | None,
) -> Iterator[_Piece]:
    match shape:
        case schema.Mesh():
            yield from _of_file(shape, material, materials, folder)
        case schema.ShapeGroup(parts=parts):
            for part in parts:
                place_m = np.array(part.position_m)
                attitude_deg = (part.roll_deg, part.pitch_deg, part.yaw_deg)
                own = part.material or material
                for key, mesh in _shaped(
                    part.shape, own, materials, floor_m, folder, cell_m=cell_m
                ):
                    yield key, _turned(mesh, place_m, attitude_deg)
        case _:
            yield material, triangles_of(shape, floor_m, cell_m)


def _of_file(
    shape: schema.Mesh, material: str, materials: Mapping[str, Material], folder: Path
) -> Iterator[_Piece]:
    """Read a file's parts with the materials that the section, or their own names, give them."""
    parts = read_parts(folder / shape.file, shape.scale, shape.up)
    named = {name for part in parts for name in (part.name, part.material) if name}
    for pattern in shape.materials:
        if not any(fnmatchcase(name, pattern) for name in named):
            known = ", ".join(sorted(named)) or "no names"
            raise SceneError(f"{shape.file}: materials: nothing is named {pattern}; it has {known}")
    for part in parts:
        own = part.material if part.material in materials else material
        given = (
            name
            for pattern, name in shape.materials.items()
            if fnmatchcase(part.material, pattern) or fnmatchcase(part.name, pattern)
        )
        chosen = next(given, own)
        if chosen is not None:
            yield chosen, part.mesh


def _joined(meshes: Iterable[trimesh.Trimesh]) -> trimesh.Trimesh:
    """Join meshes to one."""
    parts = list(meshes)
    return parts[0] if len(parts) == 1 else cast("trimesh.Trimesh", trimesh.util.concatenate(parts))


def _whole(meshes: Iterable[trimesh.Trimesh]) -> trimesh.Trimesh:
    """Join the meshes of an object's materials, closed where they touch."""
    parts = list(meshes)
    if len(parts) == 1:
        return parts[0]
    whole = _joined(parts)
    whole.merge_vertices()
    return whole


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
