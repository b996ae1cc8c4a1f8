"""The coarse picture: what a rule overlooks in it."""

import numpy as np
import pytest
from sonar_sim.effects.coarse_picture import change_db
from sonar_sim.effects.image_difference import Tolerance

from tests.sonar_sim.effects.previews import SONAR


@pytest.mark.parametrize(("part", "same"), [(0.05, True), (0.5, False)])
def test_half_a_beam_explains_a_part_of_a_coarse_column(part: float, *, same: bool) -> None:
    power = np.where(np.arange(96) < 48, 1e-5, 0.5) * np.ones((128, 1))
    moved = power + part * (np.roll(power, -1, axis=1) - power)
    moved[:, -1] = power[:, -1]
    # Half of 512 beams' distance is 0.09 of 96 columns'.
    change = change_db(np.sqrt(power), np.sqrt(moved), SONAR, Tolerance())
    assert (change == 0.0) is same
