"""The bearing table and the borders between beams."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from oculus_driver.errors import EncodeError
from oculus_driver.fan import bearing_table_cdeg, edges_rad
from oculus_driver.wire import PING_RESULT_V1

if TYPE_CHECKING:
    from oculus_driver.stream import Message


def test_the_formula_gives_the_captured_table(captured: list[Message]) -> None:
    for message in captured:
        table = np.frombuffer(message.data, "<i2", 256, PING_RESULT_V1.size)
        np.testing.assert_array_equal(bearing_table_cdeg(256, math.radians(30.0)), table)


@pytest.mark.parametrize("beams", [2, 3, 256, 512])
@pytest.mark.parametrize("half_deg", [15.0, 20.0, 30.0, 35.0, 45.0, 60.0, 65.0, 90.0])
def test_the_outermost_beams_look_along_the_aperture(beams: int, half_deg: float) -> None:
    table = bearing_table_cdeg(beams, math.radians(half_deg))
    assert table.dtype == np.int16
    assert (table[0], table[-1]) == (-100 * half_deg, 100 * half_deg)
    assert (np.diff(table) > 0).all()
    np.testing.assert_array_equal(table, -table[::-1])


def test_hundredths_of_a_degree_are_cut_off_as_sonars_do() -> None:
    table = bearing_table_cdeg(256, math.radians(30.0))
    assert table[[3, 4, 6, 7]].tolist() == [-2922, -2896, -2845, -2819]  # -2896.75 and -2819.99


def test_one_beam_looks_straight_ahead() -> None:
    assert bearing_table_cdeg(1, 0.5).tolist() == [0]


@pytest.mark.parametrize(("beams", "half"), [(0, 0.5), (256, 0.0), (256, 2.0), (256, math.nan)])
def test_an_impossible_fan_is_refused(beams: int, half: float) -> None:
    with pytest.raises(EncodeError):
        bearing_table_cdeg(beams, half)


def test_edges_lie_half_way_in_sine() -> None:
    bearings = np.radians([-30.0, 0.0, 30.0])
    expected = np.degrees(np.arcsin([-0.75, -0.25, 0.25, 0.75]))
    np.testing.assert_allclose(np.degrees(edges_rad(bearings)), expected)


def test_edges_do_not_pass_a_right_angle() -> None:
    edges = edges_rad(np.radians([-90.0, 0.0, 90.0]))
    assert (edges[0], edges[-1]) == (-math.pi / 2, math.pi / 2)


def test_a_single_beam_has_edges_around_it() -> None:
    np.testing.assert_allclose(np.degrees(edges_rad(np.array([0.1]))), [5.2296, 6.2296], atol=1e-4)
