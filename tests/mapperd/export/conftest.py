"""Maps of known voxels, and their files in every format."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mapperd.export.cells import Heights
from mapperd.export.formats import write_map
from mapperd.mapping.sonar_map import SonarMap
from tests.support.maps import FREE, OCCUPIED, UNSURE, map_of


@pytest.fixture
def sonar_map() -> SonarMap:
    """Of three occupied, three free voxels and one that is neither."""
    return map_of(OCCUPIED, FREE, UNSURE)


@pytest.fixture
def large_map() -> SonarMap:
    """A thousand occupied and as many free voxels, at random."""
    rng = np.random.default_rng(7)
    places = rng.permutation(40 * 30 * 20)[:2000]
    points = np.stack(np.unravel_index(places, (40, 30, 20)), axis=1) * 0.25 - 2.375
    rows = [tuple(row) for row in points.tolist()]
    return map_of(rows[:1000], rows[1000:])


@pytest.fixture
def saved(tmp_path: Path) -> Callable[..., Path]:
    def save(sonar_map: SonarMap, name: str, heights: Heights | None = None) -> Path:
        path = tmp_path / name
        files = write_map(sonar_map, path, heights or Heights())
        assert files[0] == path
        assert sorted(tmp_path.iterdir()) == sorted(files)
        return path

    return save
