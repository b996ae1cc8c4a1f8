"""The picture of localization: everything at its place of the map."""

import math

import numpy as np
import pytest

from mapperd.geometry.gaussian import PlanarGaussian
from mapperd.localization.known_map import KnownMap
from mapperd.localization.maps import FREE, OCCUPIED, GridMap
from mapperd.localization.picture import (
    MAX_PIXELS,
    NOWHERE,
    PARTICLE,
    PATH,
    POSE,
    SCAN,
    WALL,
    WATER,
    Trail,
    localization_picture,
)
from tests.mapperd.localization.believed import snapshot

EMPTY = np.zeros((0, 2))
PIXELS_A_M = 50
"""Of the tank of `believed`: 80 cells of 0.1 m, each 5 pixels."""


def at(picture: np.ndarray, x_m: float, y_m: float) -> tuple[int, ...]:
    """Colour at a point of the map, whose known part begins at (-1, -1)."""
    column, row = int((x_m + 1) * PIXELS_A_M), int((y_m + 1) * PIXELS_A_M)
    return tuple(int(part) for part in picture[len(picture) - 1 - row, column])


def drawn(trail: np.ndarray = EMPTY, **more: object) -> np.ndarray:
    picture = localization_picture(snapshot(**more), trail)  # type: ignore[arg-type]
    assert picture is not None
    return picture


def test_map_is_cut_to_what_is_known() -> None:
    picture = drawn(elsewhere=None, particles=np.zeros((0, 4)), scan_points_m=None)
    assert picture.shape == (300, 400, 3)
    assert at(picture, 3.0, 3.0) == WATER
    assert at(picture, -0.95, 3.0) == at(picture, 3.0, -0.95) == WALL


def test_everything_is_drawn_at_its_place() -> None:
    particles = np.array([[0.5, 4.5, 0.0, 1.0], [np.nan, 0.0, 0.0, 1.0], [1e9, -1e300, 0.0, 1.0]])
    picture = drawn(trail=np.array([[4.0, 4.0], [6.0, 4.0]]), particles=particles)
    assert at(picture, 0.5, 4.5) == PARTICLE
    assert at(picture, 5.0, 2.0) == SCAN
    assert all(at(picture, x, 4.0) == PATH for x in (4.0, 4.77, 5.5))
    assert at(picture, 1.0, 2.0) == POSE
    ahead = (1 + 0.8 * math.cos(0.5), 2 + 0.8 * math.sin(0.5))
    assert at(picture, *ahead) == POSE
    assert at(picture, 1.0, 2.4) == POSE  # two sigma of 0.2 m up
    assert at(picture, 1.2, 2.0) == POSE  # and of 0.1 m to the right
    assert at(picture, 0.9, 2.3) == WATER


def test_turned_map_is_drawn_in_its_own_axes() -> None:
    cells = np.full((40, 40), FREE, np.int8)
    turned = KnownMap("m", "00", GridMap(cells, 0.1, 10.0, 5.0, math.pi / 2))
    picture = drawn(
        known=turned,
        elsewhere=None,
        particles=np.array([[10.0 - 1.0, 5.0 + 3.0, 0, 1]]),  # 3 m along its x, 1 m along its y
        scan_points_m=None,
    )
    row, column = np.argwhere((picture == PARTICLE).all(axis=2))[0]
    cell = len(picture) / 40
    assert (column / cell, (len(picture) - 1 - row) / cell) == pytest.approx((30, 10), abs=0.3)


def test_large_map_is_made_coarser_and_keeps_thin_walls() -> None:
    cells = np.full((300, 4000), FREE, np.int8)
    cells[150, :] = OCCUPIED
    large = KnownMap("m", "00", GridMap(cells, 0.1))
    picture = drawn(known=large, elsewhere=None, particles=np.zeros((0, 4)), scan_points_m=None)
    assert picture.shape == (60, MAX_PIXELS, 3)
    assert (picture == WALL).all(axis=2).sum() == MAX_PIXELS


def test_map_of_which_nothing_is_known_is_grey() -> None:
    blank = KnownMap("m", "00", GridMap(np.full((7, 9), -1, np.int8), 1.0))
    picture = drawn(known=blank, elsewhere=None)
    assert (picture[0, 0] == NOWHERE).all()


def test_without_a_map_nothing_is_drawn() -> None:
    assert localization_picture(snapshot(known=None), EMPTY) is None


def test_trail_keeps_the_newest_places() -> None:
    trail = Trail(max_places=3)
    assert trail.points_m().shape == (0, 2)
    for x_m in (0.0, 0.0, 1.0, 2.0, 3.0):
        trail.add(PlanarGaussian(x_m, 0.0, 0.0, np.eye(3)))
    assert trail.points_m()[:, 0].tolist() == [1.0, 2.0, 3.0]
