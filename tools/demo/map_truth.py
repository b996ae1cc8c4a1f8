"""Compare a finished map with the known scene.

Two questions, each with its own direction:
- accuracy: how far is each occupied voxel's centre from the nearest true surface?
- coverage: how much of the surface that the sonar had in sight has an occupied voxel near it?

A voxel that holds a surface has its centre up to 0.87 edges away from it; "near" is therefore 1.5
edges from the surface point to the centre, and the stricter 1 edge is reported beside it.
"""

import argparse
import json
import math
import re
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

_DTYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "<i2",
    "ushort": "<u2",
    "int": "<i4",
    "uint": "<u4",
    "float": "<f4",
    "double": "<f8",
}
END = b"end_header\n"


@dataclass(frozen=True, slots=True, eq=False)
class OccupiedVoxels:
    """Occupied voxels.

    Attributes:
        centres_m: (N, 3), map frame.
        edge_m: of one voxel.
    """

    centres_m: NDArray[np.float64]
    edge_m: float


def read_voxels(path: Path) -> OccupiedVoxels:
    """Read a binary PLY of voxel centres, whose comment states the voxels' edge.

    Raises:
        ValueError: it is no such file.
    """
    data = path.read_bytes()
    head, mark, body = data.partition(END)
    lines = head.decode("ascii", "replace").splitlines()
    if not mark or lines[:2] != ["ply", "format binary_little_endian 1.0"]:
        raise ValueError(f"{path}: not a binary little-endian PLY")
    count = re.search(r"^element vertex (\d+)$", "\n".join(lines), re.MULTILINE)
    edge = re.search(r"edge (\S+) m", "\n".join(lines))
    if count is None or edge is None:
        raise ValueError(f"{path}: states neither the number of voxels nor their size")
    fields = [line.split()[1:] for line in lines if line.startswith("property ")]
    dtype = np.dtype([(name, _DTYPES[kind]) for kind, name in fields])
    vertices = np.frombuffer(body, dtype, int(count[1]))
    centres = np.stack([vertices[axis] for axis in "xyz"], axis=1).astype(np.float64)
    return OccupiedVoxels(centres, float(edge[1]))


MAX_EDGE_M = 0.12
POINTS_A_TURN = 2000
"""Bounds the memory: each point brings some tens of triangles."""


class TrueSurface:
    """A mesh cut into small triangles, which a tree of their middles finds.

    A triangle nearer than a known upper bound has its middle within that bound plus the largest
    triangle's reach: so the search is exact, whatever the shape. Far from the surface that takes
    many triangles a point; there the triangle of the nearest middle may stand for all.

    Args:
        triangles_m: (F, 3, 3).
        exact_within_m: farther off, distances may be too large by a small triangle's reach, 7 cm.
    """

    def __init__(self, triangles_m: NDArray[np.float64], exact_within_m: float = math.inf) -> None:
        self._exact_within_m = exact_within_m
        faces = np.arange(3 * len(triangles_m)).reshape(-1, 3)
        vertices, small = trimesh.remesh.subdivide_to_size(  # type: ignore[no-untyped-call]
            triangles_m.reshape(-1, 3), faces, MAX_EDGE_M
        )
        self.triangles_m: NDArray[np.float64] = np.asarray(vertices[small], dtype=np.float64)
        middles = self.triangles_m.mean(axis=1)
        self._reach_m = float(
            np.linalg.norm(self.triangles_m - middles[:, None], axis=2).max(initial=0.0)
        )
        self._tree = cKDTree(middles)

    def distance_m(self, points_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance of each point (N, 3) to the nearest triangle, (N,)."""
        turns = range(0, len(points_m), POINTS_A_TURN)
        parts = [self._distance_m(points_m[i : i + POINTS_A_TURN]) for i in turns]
        return np.concatenate(parts) if parts else np.empty(0)

    def _distance_m(self, points_m: NDArray[np.float64]) -> NDArray[np.float64]:
        _, nearest = self._tree.query(points_m)
        bound = _to_triangles(points_m, self.triangles_m[nearest])
        close = bound <= self._exact_within_m
        bound[close] = self._smallest(points_m[close], bound[close])
        return bound

    def _smallest(
        self, points_m: NDArray[np.float64], bound: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Exact distance of points whose distance is at most `bound`."""
        if len(points_m) == 0:
            return bound
        near = self._tree.query_ball_point(points_m, bound + self._reach_m)
        counts = np.array([len(found) for found in near])
        triangles = self.triangles_m[np.concatenate([np.asarray(f, dtype=int) for f in near])]
        distance = _to_triangles(np.repeat(points_m, counts, axis=0), triangles)
        starts = np.cumsum(counts) - counts
        smallest: NDArray[np.float64] = np.minimum.reduceat(distance, starts)
        return smallest


def read_triangles(path: Path) -> NDArray[np.float64]:
    """Read the triangles (F, 3, 3) of a file that trimesh knows."""
    mesh = trimesh.load_mesh(path, process=False)
    return np.asarray(mesh.triangles, dtype=np.float64)


def _to_triangles(
    points_m: NDArray[np.float64], triangles_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    closest = trimesh.triangles.closest_point(triangles_m, points_m)  # type: ignore[no-untyped-call]
    distance: NDArray[np.float64] = np.linalg.norm(points_m - closest, axis=1)
    return distance


NEAR_VOXELS = 1.5


@dataclass(frozen=True, slots=True)
class MapAccuracy:
    """How well a map fits the truth.

    Attributes:
        voxel_m: edge of the map's voxels.
        occupied_voxels: in the map.
        median_m, p95_m, max_m: distance of occupied voxels' centres to the nearest true surface.
        share_within_voxel: of the occupied voxels, nearer than one edge.
        seen_points: of the surface that the sonar had in sight.
        coverage: share of them with an occupied centre within 1.5 edges.
        coverage_one_voxel: the same within 1 edge.
    """

    voxel_m: float
    occupied_voxels: int
    median_m: float
    p95_m: float
    max_m: float
    share_within_voxel: float
    seen_points: int
    coverage: float
    coverage_one_voxel: float

    def sentences(self) -> str:
        """The numbers for a person."""
        return (
            f"{self.occupied_voxels} occupied voxels of {self.voxel_m:g} m\n"
            f"distance to the nearest true surface: median {self.median_m:.3f} m, "
            f"95th percentile {self.p95_m:.3f} m\n"
            f"seen surface that is mapped: {self.coverage:.1%} within {NEAR_VOXELS} voxels, "
            f"{self.coverage_one_voxel:.1%} within 1 voxel"
        )


def compare(
    centres_m: NDArray[np.float64],
    voxel_m: float,
    surface: TrueSurface,
    seen_m: NDArray[np.float64],
) -> MapAccuracy:
    """Measure a map.

    Args:
        centres_m: of the occupied voxels, (N, 3).
        voxel_m: their edge.
        surface: the truth.
        seen_m: points of it that the sonar had in sight, (M, 3), about evenly spread.

    Raises:
        ValueError: the map or the seen surface is empty, so there is nothing to measure.
    """
    return accuracy_of(centres_m, voxel_m, surface.distance_m(centres_m), seen_m)


def accuracy_of(
    centres_m: NDArray[np.float64],
    voxel_m: float,
    distance_m: NDArray[np.float64],
    seen_m: NDArray[np.float64],
) -> MapAccuracy:
    """As `compare`, from the distances (N,) of the centres to the truth."""
    if len(centres_m) == 0 or len(seen_m) == 0:
        raise ValueError(f"{len(centres_m)} occupied voxels and {len(seen_m)} seen points")
    gap_m, _ = cKDTree(centres_m).query(seen_m, workers=-1)
    return MapAccuracy(
        voxel_m=voxel_m,
        occupied_voxels=len(centres_m),
        median_m=float(np.median(distance_m)),
        p95_m=float(np.percentile(distance_m, 95)),
        max_m=float(distance_m.max()),
        share_within_voxel=float(np.mean(distance_m <= voxel_m)),
        seen_points=len(seen_m),
        coverage=float(np.mean(gap_m <= NEAR_VOXELS * voxel_m)),
        coverage_one_voxel=float(np.mean(gap_m <= voxel_m)),
    )


def measure(map_ply: Path, scene_ply: Path, seen_npz: Path) -> MapAccuracy:
    """Compare files: a map of `mapperd --replay` with what the simulator left."""
    voxels = read_voxels(map_ply)
    with np.load(seen_npz) as archive:
        seen_m: NDArray[np.float64] = archive["points_m"]
    return compare(voxels.centres_m, voxels.edge_m, TrueSurface(read_triangles(scene_ply)), seen_m)


def main(argv: Sequence[str] | None = None) -> int:
    """Measure and print; `--json` also writes the numbers."""
    parser = argparse.ArgumentParser(prog="map_truth", description=__doc__.partition("\n")[0])
    parser.add_argument("map", type=Path, help="map.ply of a replay")
    parser.add_argument("scene", type=Path, help="scene.ply of the simulator")
    parser.add_argument("seen", type=Path, help="seen.npz of the simulator")
    parser.add_argument("--json", type=Path, help="file for the numbers")
    args = parser.parse_args(argv)
    accuracy = measure(args.map, args.scene, args.seen)
    print(accuracy.sentences())
    if args.json is not None:
        write_json(args.json, accuracy)
    return 0


def write_json(path: Path, accuracy: MapAccuracy) -> None:
    """Write the numbers."""
    path.write_text(json.dumps(asdict(accuracy), indent=2) + "\n")


if __name__ == "__main__":
    sys.exit(main())
