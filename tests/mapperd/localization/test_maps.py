import math

import numpy as np
import pytest

from mapperd.config.tree import Config
from mapperd.errors import MapError
from mapperd.localization import maps as module
from mapperd.localization.maps import beam_band_m, depth_slice
from mapperd.mapping.queries import MapQueries
from mapperd.mapping.sonar_map import SonarMap

Point = tuple[float, float, float]


def queries(occupied: list[Point], free: list[Point]) -> MapQueries:
    core = SonarMap(Config()).core
    core.set_log_odds(np.array(occupied).reshape(-1, 3), np.full(len(occupied), 3.0))
    core.set_log_odds(np.array(free).reshape(-1, 3), np.full(len(free), -3.0))
    return MapQueries(core, occupied_threshold=0.7, free_threshold=0.5)


OCCUPIED = [(0.12, 0.22, -1.97), (0.42, 0.02, -0.98)]
FREE = [(0.12, 0.22, -1.52), (0.32, 0.12, -1.52), (0.42, 0.02, -1.52)]


@pytest.mark.parametrize("at_once", [1 << 24, 300])
def test_slice_is_the_union_over_its_height(monkeypatch: pytest.MonkeyPatch, at_once: int) -> None:
    monkeypatch.setattr(module, "VOXELS_AT_ONCE", at_once)
    grid = depth_slice(
        queries(OCCUPIED, FREE), np.array([0.0, 0.0, -2.0]), np.array([0.5, 0.3, -1.0])
    )
    assert grid.occupancy.shape == (6, 10)
    assert (grid.origin_x_m, grid.origin_y_m, grid.resolution_m) == pytest.approx((0, 0, 0.05))
    at = np.array([[0.12, 0.22], [0.32, 0.12], [0.42, 0.02], [0.22, 0.22]])
    assert grid.cells_at(at).tolist() == [100, 0, 0, -1]
    assert (grid.occupancy != -1).sum() == 3


def test_a_higher_band_sees_what_is_higher() -> None:
    grid = depth_slice(
        queries(OCCUPIED, FREE), np.array([0.0, 0.0, -1.6]), np.array([0.5, 0.3, -0.9])
    )
    at = np.array([[0.12, 0.22], [0.42, 0.02]])
    assert grid.cells_at(at).tolist() == [0, 100]


@pytest.mark.parametrize(
    ("low", "high"),
    [
        ((0, 0, 0), (0, 1, 1)),
        ((0, 0, 0), (1, 1, -1)),
        ((0, 0, 0), (1e9, 1e9, 1)),
        ((0, 0, math.nan), (1, 1, 1)),
        ((0, 0), (1, 1)),
        ((0, 0, 0.001), (1, 1, 0.002)),
    ],
)
def test_slices_that_cannot_be_are_refused(low: tuple[float, ...], high: tuple[float, ...]) -> None:
    with pytest.raises(MapError) as caught:
        depth_slice(queries([], []), np.array(low), np.array(high))
    assert caught.value.reason == "bad_slice"


def test_band_is_what_the_aperture_covers_on_the_way() -> None:
    low, high = beam_band_m(-3.0, 20.0, math.radians(20))
    assert (low, high) == pytest.approx(
        (-3 - 20 * math.sin(math.radians(10)), -3 + 3.4730), abs=1e-3
    )
    down = beam_band_m(-3.0, 20.0, math.radians(20), math.radians(30))
    assert down == pytest.approx((-3 - 20 * math.sin(math.radians(40)), -3.0))
