"""Walls without their insides: what a sonar sees of them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mapperd.config.loader import config_from_text
from mapperd.config.tree import Config
from mapperd.errors import MapError
from mapperd.localization.known_map import load_known_map
from mapperd.localization.maps import VolumeMap, keep_boundaries
from mapperd.mapping.queries import UNKNOWN, MapQueries
from mapperd.mapping.sonar_map import SonarMap

VOXEL_M = 0.1
FRONT_X_M, DEPTH = 1.05, 4
"""Centre of a wall's front, and how many voxels deep it is."""


def config_of(*, boundaries_only: bool) -> Config:
    only = str(boundaries_only).lower()
    return config_from_text(
        f"octree: {{voxel_resolution: {VOXEL_M}}}\n"
        f"localization: {{mode: track, boundaries_only: {only}}}\n"
        "mapping: {occupied_threshold: 0.4, free_threshold: 0.2}\n"
    )


def block(x_m: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    y_m = z_m = np.arange(-0.95, 1.0, VOXEL_M)
    return np.stack(np.meshgrid(x_m, y_m, z_m, indexing="ij"), axis=-1).reshape(-1, 3)


def walled(config: Config, *, water: bool = True) -> SonarMap:
    """Water from 0 to 1 m, then a deep wall, nothing known behind it."""
    sonar_map = SonarMap(config)
    wall_m = block(np.arange(DEPTH) * VOXEL_M + FRONT_X_M)
    sonar_map.core.set_log_odds(wall_m, np.full(len(wall_m), 3.0))
    if water:
        water_m = block(np.arange(0.05, 1.0, VOXEL_M))
        sonar_map.core.set_log_odds(water_m, np.full(len(water_m), -3.0))
    return sonar_map


def test_front_stays_and_what_is_behind_it_is_uncertain() -> None:
    sonar_map = walled(config_of(boundaries_only=True))
    assert keep_boundaries(sonar_map) == 20 * 20
    assert np.unique(sonar_map.voxels("occupied").centres_m[:, 0]) == pytest.approx([FRONT_X_M])
    queries = MapQueries(sonar_map.core, occupied_threshold=0.4, free_threshold=0.2)
    assert queries.classify([[FRONT_X_M + VOXEL_M, 0.05, 0.05]])[0] == UNKNOWN
    assert len(sonar_map.voxels("free").centres_m) == 10 * 20 * 20


@pytest.mark.parametrize(("only", "behind_m"), [(False, 0.0), (True, 2 * VOXEL_M)])
def test_distances_are_to_the_front(tmp_path: Path, only: bool, behind_m: float) -> None:  # noqa: FBT001
    config = config_of(boundaries_only=only)
    walled(config).save(tmp_path / "wall.map")
    known = load_known_map(tmp_path / "wall.map", config)
    assert isinstance(known.map, VolumeMap)
    row = round((FRONT_X_M + 2 * VOXEL_M - known.map.first_centre_m[0]) / VOXEL_M)
    assert known.map.distances_m[row, 10, 10] == pytest.approx(behind_m, abs=1e-6)
    assert known.map.distances_m[row - 2, 10, 10] == 0.0


def test_map_is_reported_by_what_the_file_holds(tmp_path: Path) -> None:
    config = config_of(boundaries_only=False)
    walled(config).save(tmp_path / "wall.map")
    path = tmp_path / "wall.map"
    marks = {load_known_map(path, config_of(boundaries_only=only)).sha256 for only in (False, True)}
    assert len(marks) == 1


def test_map_of_insides_alone_is_refused(tmp_path: Path) -> None:
    config = config_of(boundaries_only=True)
    walled(config, water=False).save(tmp_path / "wall.map")
    with pytest.raises(MapError, match="beside free space") as refused:
        load_known_map(tmp_path / "wall.map", config)
    assert refused.value.reason == "empty_map"
