"""Pings into small maps, as the core takes them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mapperd import _core

Floats = NDArray[np.float64]


def fan(beams: int = 33, half_rad: float = 0.9) -> Floats:
    """Bearings."""
    return np.linspace(-half_rad, half_rad, beams)


def wall(rows: int = 60, beams: int = 33, at: int = 40) -> NDArray[np.float32]:
    """An image of something across the fan, uneven."""
    image = np.zeros((rows, beams), np.float32)
    image[at : at + 2] = np.random.default_rng(3).uniform(0, 255, (2, beams))
    return image


@dataclass(frozen=True)
class Look:
    """One ping and how it is integrated."""

    image: NDArray[np.float32] = field(default_factory=wall)
    bearings_rad: Floats = field(default_factory=fan)
    row_m: float = 0.05
    pose: Floats = field(default_factory=lambda: at(0.013, 0.021, -0.034))
    aperture_rad: float = 0.35
    min_range_m: float = 0.3
    aggregation: str = "occupied_first"
    detail: float = 1.0
    carve_no_return: bool = False

    def into(self, voxels: _core.VoxelMap) -> _core.VoxelMap:
        """Integrate it."""
        voxels.integrate_evidence_grid(
            self.image,
            self.bearings_rad,
            self.row_m,
            self.pose,
            vertical_aperture_rad=self.aperture_rad,
            min_range_m=self.min_range_m,
            aggregation=self.aggregation,
            detail=self.detail,
            carve_no_return=self.carve_no_return,
        )
        return voxels

    def but(self, **changes: object) -> Look:
        """Another one."""
        return replace(self, **changes)  # type: ignore[arg-type]


def at(x: float, y: float, z: float, rotation: Floats | None = None) -> Floats:
    """A pose."""
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    if rotation is not None:
        pose[:3, :3] = rotation
    return pose


def empty(resolution_m: float = 0.1, **rule: float) -> _core.VoxelMap:
    """A map."""
    return _core.VoxelMap(resolution_m, _core.IwloParams(**rule))  # type: ignore[arg-type]


def cells(voxels: _core.VoxelMap) -> dict[tuple[int, int, int], float]:
    """Log-odds by the voxels' indices."""
    centres, log_odds, _ = voxels.voxels()
    index = np.floor(centres / voxels.resolution_m).astype(np.int64)
    return {(x, y, z): value for (x, y, z), value in zip(index.tolist(), log_odds, strict=True)}


def same(a: _core.VoxelMap, b: _core.VoxelMap) -> bool:
    """To the bit, whatever their resolution."""
    ours, theirs = a.blocks(), b.blocks()
    return all(np.array_equal(ours[i], theirs[i]) for i in range(3))
