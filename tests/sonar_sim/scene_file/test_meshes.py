from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from sonar_sim.errors import SceneError
from sonar_sim.scene.scenario import Scenario
from sonar_sim.scene_file.objects import clean_mesh, read_mesh

Load = Callable[..., Scenario]


@pytest.mark.parametrize("ending", ["stl", "obj", "ply", "glb"])
def test_mesh_of_every_format_is_read_to_scale(tmp_path: Path, load: Load, ending: str) -> None:
    trimesh.creation.box(extents=(1000.0, 2000.0, 3000.0)).export(tmp_path / f"box.{ending}")
    made = load(
        f"objects: [{{name: m, shape: {{kind: mesh, file: box.{ending}, scale: 0.001}}, "
        "material: rock, position_m: [0, 0, -5]}]"
    )
    corners = made.scene.surfaces[0].vertices_m
    assert len(made.scene.surfaces[0].faces) == 12
    assert corners.min(axis=0) == pytest.approx([-0.5, -1.0, -6.5], abs=1e-6)
    assert corners.max(axis=0) == pytest.approx([0.5, 1.0, -3.5], abs=1e-6)


def test_parts_of_a_file_become_one_mesh(tmp_path: Path) -> None:
    parts = trimesh.Scene()
    parts.add_geometry(trimesh.creation.box(extents=(1, 1, 1)))
    moved = np.eye(4)
    moved[0, 3] = 5.0
    parts.add_geometry(trimesh.creation.box(extents=(1, 1, 1)), transform=moved)
    parts.export(tmp_path / "two.glb")  # type: ignore[no-untyped-call]
    mesh = read_mesh(tmp_path / "two.glb")
    assert len(mesh.faces) == 24
    assert mesh.bounds[1] == pytest.approx([5.5, 0.5, 0.5])


def test_triangles_without_an_area_are_left_out() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [np.nan, 0, 0]], dtype=float)
    faces = np.array([[0, 1, 2], [0, 1, 3], [1, 1, 2]])
    mesh = clean_mesh(vertices, faces, "m")
    assert len(mesh.faces) == 1
    assert np.isfinite(mesh.vertices).all()  # the point that is not a number was no triangle's


@pytest.mark.parametrize(
    ("content", "ending"),
    [
        (b"", "stl"),
        (b"solid x\nendsolid x\n", "stl"),
        (b"garbage" * 30, "stl"),
        (b"v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n", "obj"),
        (b"v 0 0 0\nv 1 0 0\nv 0 1e999 0\nf 1 2 3\n", "obj"),
        (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "obj"),
        (b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "obj"),
        (b"ply\nformat ascii 1.0\n", "ply"),
        (b"glTF\x02\x00\x00\x00", "glb"),
        (b"\x00" * 500, "glb"),
    ],
)
def test_broken_mesh_is_refused_by_name(
    tmp_path: Path, load: Load, content: bytes, ending: str
) -> None:
    (tmp_path / f"odd.{ending}").write_bytes(content)
    with pytest.raises(SceneError, match=rf"\$\.objects\[0\] \(m\): .*odd\.{ending}"):
        load(
            f"objects: [{{name: m, shape: {{kind: mesh, file: odd.{ending}}}, material: rock, "
            "position_m: [0, 0, -5]}]"
        )


def test_missing_file_and_foreign_format_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="no such file"):
        read_mesh(tmp_path / "none.stl")
    with pytest.raises(SceneError, match=r"\.glb, \.obj, \.ply, \.stl"):
        read_mesh(tmp_path / "model.dae")
