import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from demo.map_truth import TrueSurface, compare, main, read_voxels

FLOOR = np.array(
    [[[0, 0, 0], [4, 0, 0], [4, 4, 0]], [[0, 0, 0], [4, 4, 0], [0, 4, 0]]], dtype=np.float64
)


def write_map(path: Path, centres_m: np.ndarray, edge_m: float = 0.1) -> None:
    dtype = [("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("probability", "<f4"), ("count", "<u2")]
    vertices = np.zeros(len(centres_m), dtype=dtype)
    for axis, name in enumerate("xyz"):
        vertices[name] = centres_m[:, axis]
    kinds = ["double"] * 3 + ["float", "ushort"]
    lines = ["ply", "format binary_little_endian 1.0", f"comment occupied voxels, edge {edge_m} m"]
    lines += [f"element vertex {len(vertices)}"]
    lines += [f"property {k} {n}" for k, (n, _) in zip(kinds, dtype, strict=True)] + ["end_header"]
    path.write_bytes(("\n".join(lines) + "\n").encode() + vertices.tobytes())


def test_distance_is_exact() -> None:
    generator = np.random.default_rng(1)
    mesh = trimesh.creation.icosphere(subdivisions=1, radius=1.0)
    points = generator.normal(size=(300, 3)) * 1.2
    found = TrueSurface(np.asarray(mesh.triangles)).distance_m(points)
    for point, distance in zip(points, found, strict=True):
        each = np.broadcast_to(point, (len(mesh.triangles), 3))
        closest = trimesh.triangles.closest_point(mesh.triangles, each)  # type: ignore[no-untyped-call]
        assert distance == pytest.approx(np.linalg.norm(closest - point, axis=1).min(), abs=1e-9)


def test_distance_to_a_large_triangle_far_from_its_middle() -> None:
    points = np.array([[3.9, 3.95, 0.02], [2.0, 2.0, -1.0], [5.0, 2.0, 0.0]])
    assert TrueSurface(FLOOR).distance_m(points) == pytest.approx([0.02, 1.0, 1.0], abs=1e-9)


def test_perfect_map_is_perfect_and_half_a_map_covers_half() -> None:
    step = np.arange(0.05, 4.0, 0.1)
    x, y = (part.ravel() for part in np.meshgrid(step, step))
    centres = np.stack([x, y, np.full_like(x, 0.05)], axis=1)
    seen = np.stack([x, y, np.zeros_like(x)], axis=1)
    surface = TrueSurface(FLOOR)
    whole = compare(centres, 0.1, surface, seen)
    assert whole.median_m == pytest.approx(0.05)
    assert whole.p95_m == pytest.approx(0.05)
    assert whole.coverage == whole.coverage_one_voxel == 1.0
    half = compare(centres[x < 2.0], 0.1, surface, seen)
    assert half.coverage == pytest.approx(0.5, abs=0.03)


def test_nothing_to_compare_is_an_error() -> None:
    with pytest.raises(ValueError, match="0 occupied voxels"):
        compare(np.empty((0, 3)), 0.1, TrueSurface(FLOOR), np.zeros((1, 3)))


def test_command_reads_the_files_and_writes_the_numbers(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_map(tmp_path / "map.ply", np.array([[1.05, 1.05, 0.15], [2.05, 1.05, 0.05]]))
    trimesh.Trimesh(FLOOR.reshape(-1, 3), [[0, 1, 2], [3, 4, 5]]).export(tmp_path / "scene.ply")
    np.savez(tmp_path / "seen.npz", points_m=np.array([[1.0, 1.0, 0.0], [2.0, 1.0, 0.0]]))
    files = [str(tmp_path / name) for name in ("map.ply", "scene.ply", "seen.npz")]
    assert main([*files, "--json", str(tmp_path / "accuracy.json")]) == 0
    numbers = json.loads((tmp_path / "accuracy.json").read_text())
    assert numbers["median_m"] == pytest.approx(0.1)
    assert numbers["coverage"] == pytest.approx(0.5)
    assert "median 0.100 m" in capsys.readouterr().out


@pytest.mark.parametrize("content", [b"", b"ply\nformat ascii 1.0\nend_header\n", b"\x00" * 64])
def test_other_files_are_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "map.ply"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"map\.ply"):
        read_voxels(path)
