"""What a map holds, to be read: in memory or in its file, whole or part by part."""

from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mapperd import _core
from mapperd.config.tree import Config
from mapperd.mapping.sonar_map import MapCounts, Voxels

__all__ = ["MapContent", "VoxelCloud"]


class VoxelCloud(Protocol):
    """Voxels in the map's fixed order, of which a part is in memory at a time."""

    def __len__(self) -> int:
        """Return their number."""

    @property
    def box_m(self) -> NDArray[np.float64]:
        """(2, 3) float64, lowest and highest centre, map frame; zeros without voxels."""

    def batches(self) -> Iterator[Voxels]:
        """Yield all voxels; every call begins again."""


class MapContent(Protocol):
    """A map to be written as files; `SonarMap` in memory, `StoredMap` in its file."""

    config: Config

    @property
    def resolution_m(self) -> float:
        """Edge of a voxel."""

    @property
    def memory_bytes(self) -> int:
        """Memory that the map takes while it is read."""

    @property
    def bricks_lost(self) -> int:
        """Damaged bricks, whose space is unknown."""

    def occupied(self) -> VoxelCloud:
        """Return the occupied voxels."""

    def counts(self) -> MapCounts:
        """Count the observed voxels by class."""

    def sha256(self) -> str:
        """Return the fingerprint of the content; see `SonarMap.sha256`."""

    def parts(self) -> Iterator[_core.VoxelMap]:
        """Yield maps without common blocks that together are this one, in its fixed order.

        Each is valid until the next.
        """

    def save(self, path: Path) -> None:
        """Write the map without loss; see `SonarMap.save`."""

    def save_octomap(self, path: Path) -> None:
        """Write OctoMap's tree: `.bt` with classes, `.ot` with log-odds."""

    def close(self) -> None:
        """Close what is read from."""
