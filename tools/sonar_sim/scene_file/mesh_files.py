"""Read meshes of files: STL, PLY, OBJ, glTF, COLLADA, and those of robots and worlds.

A file's parts keep the names of their materials, so that each face can get its own.
"""

import io
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
import trimesh
from numpy.typing import NDArray

from oculus_driver.errors import missing_extra
from sonar_sim.errors import SceneError
from sonar_sim.scene_file.robot_files import Geometry, read_sdf, read_urdf

SLIVER_M = 1e-9
"""Triangles less high than this have no area worth the name."""

UP_TURN: Mapping[str, NDArray[np.float64]] = MappingProxyType(
    {
        "x": np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]),
        "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
        "z": np.eye(3),
    }
)
"""Turns a file's axes so that z is up, by the axis that is up in it (COLLADA 1.4.1, `up_axis`)."""
FILE_UP = MappingProxyType({".glb": "y", ".gltf": "y"})
"""Axis that is up by the format (glTF 2.0, 3.4 Coordinate System and Units)."""


@dataclass(frozen=True, slots=True, eq=False)
class NamedMesh:
    """Triangles of one material.

    Attributes:
        name: of the part in its file: an object, a node, a link; empty if it has none.
        material: its name in the file; empty if it has none.
        mesh: in metres, in the file's frame.
    """

    name: str
    material: str
    mesh: trimesh.Trimesh


def read_parts(path: Path, scale: float = 1.0, up: str | None = None) -> list[NamedMesh]:
    """Read a file's meshes; triangles without an area are left out.

    Robots (URDF) stand with all joints at 0; worlds (SDF) as they begin.

    Args:
        path: of the file; its ending names the format.
        scale: metres a unit of the file; of COLLADA, on top of the unit that it declares.
        up: the file's axis that points up, x, y or z; None is what COLLADA declares, y of glTF as
            its specification says, z elsewhere.

    Returns:
        Its parts, in an order that depends on the file alone; at least one.

    Raises:
        SceneError: no such file or format, not finite, or nothing left of it.
    """
    ending = path.suffix.lower()
    if ending not in READERS:
        raise SceneError(f"{path}: meshes are read from {', '.join(sorted(READERS))}")
    if not path.is_file():
        raise SceneError(f"{path}: there is no such file")
    try:
        up = up or (_collada_up(path) if ending == ".dae" else FILE_UP.get(ending, "z"))
        found = sorted(READERS[ending](path), key=lambda part: (part[1], part[0]))
    except SceneError:
        raise
    except ModuleNotFoundError as error:
        raise SceneError(f"{path}: {missing_extra(str(error.name), 'worlds')}") from error
    except Exception as error:  # its readers raise whatever their formats' bytes lead them to
        raise SceneError(f"{path}: not a mesh: {error}") from error
    parts = []
    for name, material, vertices, faces in found:
        mesh = clean_mesh(vertices @ UP_TURN[up].T * scale, faces, str(path))
        if len(mesh.faces):
            parts.append(NamedMesh(name, material, mesh))
    if not parts:
        raise SceneError(f"{path}: no triangle with an area")
    return parts


def clean_mesh(vertices: np.ndarray, faces: np.ndarray, name: str) -> trimesh.Trimesh:
    """Leave out triangles without an area; perhaps none is left.

    Raises:
        SceneError: a vertex is not finite, or an index is out of range.
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
    return mesh


_Part = tuple[str, str, NDArray[np.float64], NDArray[np.int64]]
"""Name, material, vertices (V, 3) and faces (F, 3) in the file's own units."""


def _bare(path: Path) -> Iterator[_Part]:
    """Triangles without names."""
    mesh = trimesh.load_mesh(path, process=False)
    yield "", "", *_arrays(mesh)


def _gltf(path: Path) -> Iterator[_Part]:
    yield from _of_scene(trimesh.load_scene(path, process=False))


def _obj(path: Path) -> Iterator[_Part]:
    """Read objects and materials by name alone: colours and pictures make no echo."""
    lines = path.read_bytes().splitlines()
    named = [line.split(maxsplit=1) for line in lines if line.startswith(b"usemtl")]
    used = {words[1].strip() for words in named if len(words) == 2}  # noqa: PLR2004
    kept = [line for line in lines if not line.startswith(b"mtllib")]
    materials = b"".join(b"newmtl %s\n" % name for name in sorted(used))
    scene = trimesh.load_scene(
        io.BytesIO(b"\n".join([b"mtllib named", *kept, b""])),
        file_type="obj",
        resolver={"named": materials},
        process=False,
        split_objects=bool(used),
    )
    yield from _of_scene(scene)


def _of_scene(scene: trimesh.Scene) -> Iterator[_Part]:
    """Each node's triangles at their place."""
    for node in sorted(scene.graph.nodes_geometry):
        transform, geometry = scene.graph[node]
        mesh = scene.geometry[geometry]
        if not isinstance(mesh, trimesh.Trimesh):
            continue  # lines and points
        vertices, faces = _arrays(mesh)
        material = getattr(getattr(mesh.visual, "material", None), "name", None)
        placed = vertices @ transform[:3, :3].T + transform[:3, 3]
        if np.linalg.det(transform[:3, :3]) < 0.0:
            faces = faces[:, ::-1]
        yield str(node), str(material or ""), placed, faces


def _collada_up(path: Path) -> str:
    """Return the axis that a COLLADA file declares as up."""
    import collada  # noqa: PLC0415 of the extra `worlds`

    return str(collada.Collada(str(path)).assetInfo.upaxis or "Y_UP")[0].lower()


def _collada(path: Path) -> Iterator[_Part]:
    """Read all geometry of a COLLADA scene, in metres as the file declares them."""
    import collada  # noqa: PLC0415 of the extra `worlds`

    document = collada.Collada(str(path))
    unit_m = document.assetInfo.unitmeter or 1.0
    for bound in document.scene.objects("geometry"):
        for primitive in bound.primitives():
            triangles = getattr(primitive, "triangleset", lambda same=primitive: same)()
            if not isinstance(triangles, collada.triangleset.BoundTriangleSet):
                continue  # lines
            material = primitive.material
            name = "" if material is None else str(material.name or material.id)
            vertices = np.asarray(triangles.vertex, dtype=np.float64) * unit_m
            faces = np.asarray(triangles.vertex_index, dtype=np.int64).reshape(-1, 3)
            yield str(bound.original.name or bound.original.id), name, vertices, faces


def _robot(read: Callable[[Path], Iterator[Geometry]]) -> Callable[[Path], Iterator[_Part]]:
    """Read a file of links, whose meshes are in files of their own.

    Like RViz, it ignores what COLLADA declares as up: such files are drawn for that.
    """

    def parts(path: Path) -> Iterator[_Part]:
        for one in read(path):
            if one.mesh is not None:
                found = [("", "", *_arrays(one.mesh))]
            else:
                inner = read_parts(one.file, up="z") if one.file is not None else []
                found = [(p.name, p.material, *_arrays(p.mesh)) for p in inner]
            for _, material, vertices, faces in found:
                placed = vertices @ one.transform[:3, :3].T + one.transform[:3, 3]
                turned = faces if np.linalg.det(one.transform[:3, :3]) > 0.0 else faces[:, ::-1]
                yield one.name, one.material or material, placed, turned

    return parts


def _arrays(mesh: trimesh.Trimesh) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    return (
        np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3),
        np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3),
    )


READERS: Mapping[str, Callable[[Path], Iterator[_Part]]] = MappingProxyType(
    {
        ".stl": _bare,
        ".ply": _bare,
        ".obj": _obj,
        ".glb": _gltf,
        ".gltf": _gltf,
        ".dae": _collada,
        ".urdf": _robot(read_urdf),
        ".sdf": _robot(read_sdf),
        ".world": _robot(read_sdf),
    }
)
"""Reader of each format, by the file's ending."""
