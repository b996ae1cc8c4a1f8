"""Compare a finished map with the known scene.

Two questions, each with its own direction:
- accuracy: how far is each occupied voxel's centre from the nearest true surface?
- coverage: how much of the surface that the sonar had in sight has an occupied voxel near it?

A voxel that holds a surface has its centre up to 0.87 edges away from it; "near" is therefore 1.5
edges from the surface point to the centre, and the stricter 1 edge is reported beside it.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from demo.ply_points import read_voxels
from demo.true_surface import TrueSurface, read_triangles

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
    said = parser.parse_args(argv)
    accuracy = measure(said.map, said.scene, said.seen)
    print(accuracy.sentences())
    if said.json is not None:
        write_json(said.json, accuracy)
    return 0


def write_json(path: Path, accuracy: MapAccuracy) -> None:
    """Write the numbers."""
    path.write_text(json.dumps(asdict(accuracy), indent=2) + "\n")


if __name__ == "__main__":
    sys.exit(main())
