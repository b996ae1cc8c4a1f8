"""Meshes from files: mended where that changes nothing, refused otherwise."""

from pathlib import Path

import numpy as np
import trimesh

from sonar_sim.errors import SceneError

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
