"""Hard cases of the map's grid: where a point, a ray and a box are."""

from __future__ import annotations

import itertools
from fractions import Fraction
from math import floor, inf, nextafter

import numpy as np
import pytest
from numpy.typing import NDArray

from mapperd import _core

Floats = NDArray[np.float64]
UTM = np.array([566_000.0, 4_649_776.0, -31.0])
"""Metres of a harbour in its zone of the universal grid."""

AROUND = np.array(list(itertools.product((-1, 0, 1), repeat=3)), np.float64)


def empty(resolution_m: float = 0.05) -> _core.VoxelMap:
    return _core.VoxelMap(resolution_m, _core.IwloParams())


def holding(voxels: _core.VoxelMap, points_m: Floats) -> Floats:
    """Log-odds at points."""
    return voxels.query(np.ascontiguousarray(points_m))[0].astype(np.float64)


def test_voxels_of_5_cm_are_apart_4650_km_from_the_origin() -> None:
    """A survey in coordinates of the universal grid has its voxels millions of metres out.

    Naively points are held in single precision, whose step is half a metre there: three voxels in
    a row are one.
    """
    points = UTM + 0.05 * AROUND + 0.02
    voxels = empty()
    values = np.linspace(-5, 5, 27)
    voxels.set_log_odds(points, values)
    assert (holding(voxels, points) == np.round(values * 2**11) / 2**11).all()  # whole units
    centres = voxels.voxels()[0]
    away = np.abs(centres[:, None] - points[None]).max(axis=2).min(axis=1)
    assert (away <= 0.025 + 2e-9).all()
    assert len(np.unique(points[:, 1].astype(np.float32))) == 1


def test_water_on_both_sides_of_zero_is_not_one_voxel() -> None:
    """Beside the origin coordinates change their sign, and voxels must not change their size.

    Naively the quotient is cut off towards zero: -0.9 and 0.9 are both 0, and the voxel at the
    origin is twice as wide along each axis.
    """
    voxels = empty()
    points = 0.025 * np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    voxels.set_log_odds(points, np.arange(1.0, 9.0))
    assert voxels.known_count() == 8
    assert holding(voxels, points) == pytest.approx(np.arange(1.0, 9.0))
    tiny = np.full((1, 3), -5e-324)
    assert holding(voxels, tiny) == [1.0]
    assert holding(voxels, np.full((1, 3), -0.0)) == [8.0]


def test_a_point_on_a_face_lies_in_the_voxel_that_its_last_bit_selects() -> None:
    """Grids of points at whole multiples of the voxel lie on faces, give or take a last bit.

    Naively the coordinate is multiplied by 1 / 0.05, rounded once more, or a small number is added
    to be safe: points lie in a voxel that does not hold them.
    """
    voxels = empty()
    for at in (0.15, 0.3, -0.15, 1e3 + 0.35, -1e6 + 0.05):
        for x in (nextafter(at, -inf), at, nextafter(at, inf)):
            voxels.clear()
            voxels.set_log_odds(np.array([[x, 0.01, 0.01]]), np.ones(1))
            centre = float(voxels.voxels()[0][0, 0])
            index = floor(centre / 0.05)
            exact = floor(Fraction(x) / Fraction(0.05))
            # A quotient within half its last bit of a whole number is that number.
            rounded = Fraction(x) / Fraction(0.05)
            near = abs(rounded - round(rounded)) <= Fraction(abs(x / 0.05)) / 2**53
            assert index == exact or (near and index == round(rounded))


def test_neighbouring_doubles_never_skip_a_voxel() -> None:
    """A fine line of points through the map touches every voxel on its way.

    Naively the rounding of the quotient steps over a voxel far out, where a coordinate has few bits
    left below the voxel.
    """
    for start in (-1.0, 1e6, -4_649_776.0):
        x = start + np.arange(0, 2.0, 0.004)
        points = np.stack([x, np.full_like(x, 0.01), np.full_like(x, 0.01)], axis=1)
        voxels = empty()
        voxels.set_log_odds(points, np.ones(len(x)))
        index = np.floor(np.sort(voxels.voxels()[0][:, 0]) / 0.05).astype(np.int64)
        assert (np.diff(index) == 1).all()
        assert len(index) == pytest.approx(40, abs=1)


@pytest.mark.parametrize("length", [5e-324, 1e-200, 1e-160, 1.0, 1e160, 1.7e308])
def test_a_direction_of_any_length_gives_the_same_depth(length: float) -> None:
    """Callers need not make directions unit vectors, and lengths are what their arithmetic left.

    Naively the sum of squares is 0 below 1e-162 and infinite above 1e154: the direction becomes
    infinite, or nothing.
    """
    voxels = empty()
    voxels.set_log_odds(np.array([[1.02, 0.52, 0.02]]), np.array([5.0]))
    start = np.full((1, 3), 0.02)
    along = np.array([[length, length / 2 if length > 1e-300 else 0.0, 0.0]])
    if length < 1e-300:
        voxels.set_log_odds(np.array([[1.02, 0.02, 0.02]]), np.array([5.0]))
        assert voxels.ray_cast_depth(start, along, 10.0, 0.0) == pytest.approx(0.98)
        return
    assert voxels.ray_cast_depth(start, along, 10.0, 0.0) == pytest.approx(0.98 * np.sqrt(1.25))


def test_a_ray_all_but_along_a_face_meets_what_is_behind_it() -> None:
    """The cross-section of a direction may be 1e-300: its crossings are 1e298 m away.

    Naively 1 / 1e-320 is infinite and 0 times infinity NaN, with which no comparison holds: the
    walk stops, or never ends.
    """
    voxels = empty()
    voxels.set_log_odds(np.array([[5.02, 0.0, 0.0]]), np.array([5.0]))
    start = np.zeros((6, 3))
    along = np.zeros((6, 3))
    along[:, 0] = 1.0
    along[:, 1] = [0.0, -0.0, 1e-320, 1e-300, 1e-17, 5e-324]
    depth = voxels.ray_cast_depth(start, along, 10.0, 0.0)
    assert depth == pytest.approx(np.full(6, 5.0), abs=1e-12)


def test_a_ray_from_a_face_looks_to_its_own_side() -> None:
    """An origin on the face of an occupied voxel is in it, or right before it.

    Naively a ray that starts at a distance of 0 from a crossing takes it twice, or passes through
    the voxel without having been in it.
    """
    voxels = empty(0.0625)
    voxels.set_log_odds(np.array([[1.03, 0.03, 0.03]]), np.array([5.0]))
    cases = {1.0: 1.0, 1.0625: -1.0, nextafter(1.0, 0.0): 1.0}
    for x, ahead in cases.items():
        start = np.array([[x, 0.03, 0.03], [x, 0.03, 0.03]])
        depth = voxels.ray_cast_depth(start, np.array([[1.0, 0, 0], [-1.0, 0, 0]]), 5.0, 0.0)
        inside = 1.0 <= x < 1.0625
        assert depth[0] == pytest.approx(0.0 if ahead > 0 else -1.0, abs=1e-15)
        assert depth[1] == pytest.approx(0.0 if inside or x == 1.0625 else -1.0, abs=1e-15)


def test_a_box_beyond_all_coordinates_is_refused_and_not_wrapped() -> None:
    """Questions about "everything" come as boxes from -1e9 to 1e9, or beyond the map's reach.

    Naively the corners become whole numbers of 32 bits, and the answer is that of an empty box, or
    of one elsewhere.
    """
    voxels = empty()
    points = np.array([[-2e5, 0.0, 0.0], [3e5, 1.0, -1.0]])
    voxels.set_log_odds(points, np.array([5.0, 5.0]))
    centres, _, _ = voxels.occupied_in(np.full(3, -1e6), np.full(3, 1e6), 0.0)
    assert len(centres) == 2
    for reach in (1e9, 1e15, 1e300):
        with pytest.raises(ValueError, match="reach"):
            voxels.occupied_in(np.full(3, -reach), np.full(3, reach), 0.0)
