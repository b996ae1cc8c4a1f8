import numpy as np
import pytest
from sonar_sim.simulator import Simulator
from sonar_sim.validation import tank
from sonar_sim.validation.tank import band, v20_tank


@pytest.mark.slow
def test_rods_and_plate_are_where_and_as_wide_as_they_are() -> None:
    result = v20_tank()
    assert [check for check in result.checks if not check.holds] == []
    assert len(result.checks) == 14


@pytest.mark.parametrize("target", tank.TARGETS[1:])
def test_a_target_stands_out_against_the_empty_tank(target: str) -> None:
    sonar = band(2)
    images = [
        Simulator(tank.tank_scene(name), sonar).ping(tank.tank_pose()).image
        for name in ("background", target)
    ]
    row = int((tank.TARGET_RANGE_M - tank.ROD_RADIUS_M) / sonar.range_resolution_m)
    middle = slice(sonar.beams // 2 - 5, sonar.beams // 2 + 5)
    empty, there = (
        np.mean(np.square(image[row - 3 : row + 4, middle], dtype=float)) for image in images
    )
    assert there > 2.0 * empty
