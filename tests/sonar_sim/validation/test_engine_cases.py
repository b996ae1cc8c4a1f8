from collections.abc import Callable

import pytest
from sonar_sim.validation.case import ValidationResult
from sonar_sim.validation.propagation import (
    v02_range_slopes,
    v10_mirror_ghosts,
    v11_shadow,
    v17_no_wrap,
)
from sonar_sim.validation.repeatability import v19_determinism
from sonar_sim.validation.scattering import v03_lambert_floor, v04_spheres, v05_plate, v12_elevation
from sonar_sim.validation.timing import v16_motion


@pytest.mark.slow
@pytest.mark.parametrize(
    "case",
    [
        v02_range_slopes,
        v03_lambert_floor,
        v04_spheres,
        v05_plate,
        v10_mirror_ghosts,
        v11_shadow,
        v12_elevation,
        v16_motion,
        v17_no_wrap,
        v19_determinism,
    ],
)
def test_the_case_holds(case: Callable[[], ValidationResult]) -> None:
    result = case()
    assert result.checks
    assert [check for check in result.checks if not check.holds] == []
