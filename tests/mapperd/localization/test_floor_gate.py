import math

import numpy as np
import pytest
from numpy.typing import NDArray

from mapperd.geometry.frames import rigid_transform, rotation_from_rpy
from mapperd.localization.extraction import floor_gate_m
from mapperd.localization.scan import beam_directions

APERTURE = math.radians(20)
AHEAD = np.array([0.0])


def level_from(roll: float, pitch: float) -> NDArray[np.float64]:
    return rigid_transform(np.zeros(3), rotation_from_rpy(roll, pitch, 0))


def test_level_sonar_three_metres_up_meets_the_floor_at_17_3() -> None:
    gate = floor_gate_m(AHEAD, np.eye(4), APERTURE, height_m=3.0, depth_m=None)
    assert gate[0] == pytest.approx(17.28, abs=0.01)


@pytest.mark.parametrize("tilt", [-30.0, -5.0, 0.0, 10.0, 45.0])
def test_floor_and_surface_follow_the_formula(tilt: float) -> None:
    level_T_sonar = level_from(0, tilt)  # noqa: N806 frames are named
    half, down = APERTURE / 2, math.radians(tilt)
    floor = floor_gate_m(AHEAD, level_T_sonar, APERTURE, height_m=3.0, depth_m=None)[0]
    surface = floor_gate_m(AHEAD, level_T_sonar, APERTURE, height_m=None, depth_m=2.0)[0]
    assert floor == pytest.approx(3 / math.sin(down + half) if down + half > 0 else math.inf)
    assert surface == pytest.approx(2 / math.sin(half - down) if half > down else math.inf)
    both = floor_gate_m(AHEAD, level_T_sonar, APERTURE, height_m=3.0, depth_m=2.0)[0]
    assert both == min(floor, surface)


@pytest.mark.parametrize(
    ("roll", "pitch"), [(0, 0), (20, 0), (-15, 10), (5, 85), (0, 90), (40, -60)]
)
def test_each_beam_s_gate_is_the_nearest_of_its_aperture(roll: float, pitch: float) -> None:
    bearing = np.radians(np.linspace(-65, 65, 27))
    level_T_sonar = level_from(roll, pitch)  # noqa: N806
    heights = np.stack(
        [
            beam_directions(bearing, elevation) @ level_T_sonar[2, :3]
            for elevation in np.linspace(-APERTURE / 2, APERTURE / 2, 2001)
        ]
    )
    lowest = heights.min(axis=0)
    with np.errstate(divide="ignore"):
        expected = np.where(lowest < -1e-12, 3.0 / -lowest, np.inf)
    gate = floor_gate_m(bearing, level_T_sonar, APERTURE, height_m=3.0, depth_m=None)
    assert gate == pytest.approx(expected, rel=1e-4)


def test_unknown_heights_are_no_gate() -> None:
    for height in (None, math.nan, math.inf):
        gate = floor_gate_m(AHEAD, np.eye(4), APERTURE, height_m=height, depth_m=height)
        assert np.isinf(gate).all()


def test_a_sonar_in_the_floor_trusts_nothing() -> None:
    assert floor_gate_m(AHEAD, np.eye(4), APERTURE, height_m=-0.1, depth_m=None)[0] == 0
