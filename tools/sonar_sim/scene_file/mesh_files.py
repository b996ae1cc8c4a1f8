"""Read meshes of files: STL, PLY, OBJ, glTF, COLLADA, and those of robots and worlds.

A file's parts keep the names of their materials, so that each face can get its own.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from oculus_driver.errors import missing_extra
from sonar_sim.errors import SceneError
from sonar_sim.scene_file.gltf import read_gltf
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
MAX_CORNERS = 500
"""Of a concave polygon."""
MAX_PATH = 300
"""Characters of a path in a message."""
ROBOTS = (".urdf", ".sdf", ".world")
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
    require_file(path)
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
        used, corners = used_vertices(vertices, faces, str(path))
        mesh = clean_mesh(used @ UP_TURN[up].T * scale, corners, str(path))
        if len(mesh.faces):
            parts.append(NamedMesh(name, material, mesh))
    if not parts:
        raise SceneError(f"{path}: no triangle with an area")
    return parts


def used_vertices(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], name: str
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Leave out vertices that no triangle has, as those of other parts of a file.

    Raises:
        SceneError: an index is out of range.
    """
    if faces.size and not 0 <= faces.min() <= faces.max() < len(vertices):
        raise SceneError(f"{name}: a triangle names a vertex that does not exist")
    used, corners = np.unique(faces, return_inverse=True)
    return vertices[used], corners.reshape(-1, 3)


def clean_mesh(vertices: np.ndarray, faces: np.ndarray, name: str) -> trimesh.Trimesh:
    """Join vertices at one place, and leave out triangles without an area; perhaps none is left.

    Many formats store a vertex once for each face that it belongs to. Joined, a body is closed, and
    can be round.

    Raises:
        SceneError: a vertex is not finite, or an index is out of range.
    """
    vertices, faces = used_vertices(vertices, faces, name)
    broken = np.sum(~np.isfinite(vertices).all(axis=1))
    if broken:
        raise SceneError(f"{name}: {broken} vertices not finite")
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.merge_vertices()
    if len(mesh.faces):
        mesh.update_faces(mesh.nondegenerate_faces(height=SLIVER_M))
    return mesh


def require_file(path: Path) -> None:
    """Check that a file is there.

    Raises:
        SceneError: it is not.
    """
    try:
        is_there = path.is_file()
    except (OSError, ValueError):  # its name is too long, or has a zero byte
        is_there = False
    if not is_there:
        raise SceneError(f"{str(path)[:MAX_PATH]}: there is no such file")


_Part = tuple[str, str, NDArray[np.float64], NDArray[np.int64]]
"""Name, material, vertices (V, 3) and faces (F, 3) in the file's own units."""


def _bare(path: Path) -> Iterator[_Part]:
    """Triangles without names."""
    mesh = trimesh.load_mesh(path, process=False)
    yield "", "", *_arrays(mesh)


def _obj(path: Path) -> Iterator[_Part]:
    """Read polygons by the names of their objects and materials.

    A file without objects (`o`) has groups (`g`). Indices below 0 count back from the vertices that
    were read so far. Source: Wavefront, The Advanced Visualizer, appendix B1.
    """
    text = path.read_bytes().replace(b"\r\n", b"\n").replace(b"\\\n", b" ")
    vertices: list[list[float]] = []
    polygons: dict[tuple[str, str], dict[int, list[list[int]]]] = {}
    name = group = material = ""
    for line in text.decode(errors="replace").splitlines():
        key, _, rest = line.strip().replace("\t", " ").partition(" ")
        try:
            match key:
                case "v":
                    x, y, z, *_ = map(float, rest.partition("#")[0].split())
                    vertices.append([x, y, z])
                case "f":
                    words = rest.partition("#")[0].split()
                    indices = [int(word.partition("/")[0]) for word in words]
                    corners = [k - 1 if k > 0 else len(vertices) + k if k else -1 for k in indices]
                    parts = polygons.setdefault((name or group, material), {})
                    parts.setdefault(len(corners), []).append(corners)
                case "o":
                    name = rest.strip()
                case "g":
                    group = rest.strip()
                case "usemtl":
                    material = rest.strip()
        except ValueError as error:
            raise SceneError(f"{path}: not a mesh: {line.strip()[:80]!r}: {error}") from error
    points = np.array(vertices, dtype=np.float64).reshape(-1, 3)
    for (part, of), by_corners in polygons.items():
        faces = [_triangulated(np.array(some), points, path) for some in by_corners.values()]
        yield part, of, points, np.concatenate(faces)


def _triangulated(
    polygons: NDArray[np.int64], points: NDArray[np.float64], path: Path
) -> NDArray[np.int64]:
    """Cut polygons of the same number of corners, (P, N), into triangles, (F, 3)."""
    if polygons.shape[1] < 3:  # noqa: PLR2004 no polygon
        return np.empty((0, 3), dtype=np.int64)
    if polygons.size and not 0 <= polygons.min() <= polygons.max() < len(points):
        raise SceneError(f"{path}: a face names a vertex that does not exist")
    first = np.broadcast_to(polygons[:, :1], (len(polygons), polygons.shape[1] - 2))
    fans = np.stack([first, polygons[:, 1:-1], polygons[:, 2:]], axis=2)
    corners = points[fans]
    normals = np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
    outward = normals.sum(axis=1)
    is_concave = np.any(np.einsum("pfi,pi->pf", normals, outward) < 0.0, axis=1)
    if is_concave.any() and polygons.shape[1] > MAX_CORNERS:
        raise SceneError(
            f"{path}: a face has {polygons.shape[1]} corners: triangulate it before the export"
        )
    cut = [
        one[_ears(points[one], normal)]
        for one, normal in zip(polygons[is_concave], outward[is_concave], strict=True)
    ]
    return np.concatenate([fans[~is_concave].reshape(-1, 3), *cut])


def _ears(corners: NDArray[np.float64], normal: NDArray[np.float64]) -> NDArray[np.int64]:
    """Cut a polygon, (N, 3), into triangles by its ears, (N - 2, 3).

    Source: Meisters (1975), Polygons have ears.
    """
    drop = int(np.argmax(np.abs(normal)))
    flat = corners[:, [(drop + 1) % 3, (drop + 2) % 3]] * [1.0, np.sign(normal[drop])]
    left = list(range(len(flat)))
    triangles = []
    while len(left) > 2:  # noqa: PLR2004 a triangle is the last ear
        ear = next((k for k in range(len(left)) if _is_ear(flat, left, k)), 0)
        triangles.append([left[ear - 1], left[ear], left[(ear + 1) % len(left)]])
        del left[ear]
    return np.array(triangles)


def _is_ear(flat: NDArray[np.float64], left: list[int], k: int) -> bool:
    """Whether the corner k of those left is convex, with no other in its triangle."""
    ends = flat[[left[k - 1], left[k], left[(k + 1) % len(left)]]]
    edges = np.roll(ends, -1, axis=0) - ends
    if edges[0, 0] * edges[1, 1] <= edges[0, 1] * edges[1, 0]:
        return False
    away = flat[left][:, None] - ends
    beside = edges[:, 0] * away[:, :, 1] - edges[:, 1] * away[:, :, 0]
    return not np.any(np.all(beside > 0.0, axis=1))


def _collada_up(path: Path) -> str:
    """Return the axis that a COLLADA file declares as up."""
    import collada  # noqa: PLC0415 of the extra `worlds`

    return str(collada.Collada(str(path)).assetInfo.upaxis or "Y_UP")[0].lower()


def _collada(path: Path) -> Iterator[_Part]:
    """Read all geometry of a COLLADA scene, in metres as the file declares them."""
    import collada  # noqa: PLC0415 of the extra `worlds`

    document = collada.Collada(str(path))
    if document.scene is None:
        raise SceneError(f"{path}: it shows no scene: its <scene> is missing")
    declared_m = document.assetInfo.unitmeter
    unit_m = 1.0 if declared_m is None else float(declared_m)
    checked: set[int] = set()
    if not unit_m > 0.0:
        raise SceneError(f"{path}: its unit is {unit_m} m; it must be more than 0")
    for node_name, transform, bound in _collada_geometry(document.scene.nodes, np.eye(4), ""):
        order = 1 if np.linalg.det(transform[:3, :3]) > 0.0 else -1
        for own, primitive in zip(bound.original.primitives, bound.primitives(), strict=True):
            triangles = getattr(primitive, "triangleset", lambda same=primitive: same)()
            if not isinstance(triangles, collada.triangleset.BoundTriangleSet):
                continue  # lines
            source = own.sources["VERTEX"][0][4]
            texts = (one.text or "" for one in source.xmlnode.iterfind("{*}float_array"))
            if id(source) not in checked and any("nan" in text.lower() for text in texts):
                raise SceneError(f"{path}: {node_name!r}: vertices not finite")
            checked.add(id(source))
            material = primitive.material
            name = "" if material is None else str(material.name or material.id)
            vertices = np.asarray(triangles.vertex, dtype=np.float64) * unit_m
            faces = np.asarray(triangles.vertex_index, dtype=np.int64).reshape(-1, 3)[:, ::order]
            yield node_name or str(bound.original.name or bound.original.id), name, vertices, faces


def _collada_geometry(
    nodes: Iterable[Any], above: NDArray[np.float64], name: str
) -> Iterator[tuple[str, NDArray[np.float64], Any]]:
    """Geometry with the name of its node, or of the nearest named one above, and its place."""
    for node in nodes:
        inner = getattr(node, "node", node)  # an instance of a node elsewhere
        if hasattr(inner, "children"):
            named = str(inner.name or inner.id or name)
            yield from _collada_geometry(inner.children, above @ inner.matrix, named)
        else:
            yield from ((name, above, bound) for bound in node.objects("geometry", above))


def _robot(read: Callable[[Path], Iterator[Geometry]]) -> Callable[[Path], Iterator[_Part]]:
    """Read a file of links, whose meshes are in files of their own.

    Like RViz, it ignores what COLLADA declares as up: such files are drawn for that.
    """

    def parts(path: Path) -> Iterator[_Part]:
        for one in read(path):
            found: list[_Part] = []
            if one.mesh is not None:
                found = [("", "", *_arrays(one.mesh))]
            elif one.file is not None:
                found = [(p.name, p.material, *_arrays(p.mesh)) for p in _inner(path, one)]
            for _, material, vertices, faces in found:
                placed = vertices @ one.transform[:3, :3].T + one.transform[:3, 3]
                turned = faces if np.linalg.det(one.transform[:3, :3]) > 0.0 else faces[:, ::-1]
                yield one.name, one.material or material, placed, turned

    return parts


def _inner(path: Path, one: Geometry) -> list[NamedMesh]:
    """Read the file of a link's mesh."""
    assert one.file is not None  # noqa: S101 it has one
    if one.file.suffix.lower() in ROBOTS:
        raise SceneError(f"{path}: {one.name}: a mesh cannot be a {one.file.suffix} file")
    try:
        return read_parts(one.file, up="z")
    except SceneError as error:
        raise SceneError(f"{path}: {one.name}: {error}") from error


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
        ".glb": read_gltf,
        ".gltf": read_gltf,
        ".dae": _collada,
        ".urdf": _robot(read_urdf),
        ".sdf": _robot(read_sdf),
        ".world": _robot(read_sdf),
    }
)
"""Reader of each format, by the file's ending."""
