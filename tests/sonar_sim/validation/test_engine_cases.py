from collections.abc import Callable

import pytest
from sonar_sim.validation.case import CaseResult
from sonar_sim.validation.v02_range_slopes import v02_range_slopes
from sonar_sim.validation.v03_lambert_floor import v03_lambert_floor
from sonar_sim.validation.v04_spheres import v04_spheres
from sonar_sim.validation.v05_plate import v05_plate
from sonar_sim.validation.v10_mirror_ghosts import v10_mirror_ghosts
from sonar_sim.validation.v11_shadow import v11_shadow
from sonar_sim.validation.v12_elevation import v12_elevation
from sonar_sim.validation.v16_motion import v16_motion
from sonar_sim.validation.v17_no_wrap import v17_no_wrap
from sonar_sim.validation.v19_determinism import v19_determinism


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
def test_the_case_holds(case: Callable[[], CaseResult]) -> None:
    result = case()
    assert result.checks
    assert [check for check in result.checks if not check.holds] == []
