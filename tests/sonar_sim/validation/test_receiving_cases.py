"""The validation cases of beams, speckle and receiver hold."""

from collections.abc import Callable

import pytest
from sonar_sim.validation.case import CaseResult
from sonar_sim.validation.v06_beam_pattern import v06_beam_pattern
from sonar_sim.validation.v07_speckle import v07_speckle
from sonar_sim.validation.v08_ping_correlation import v08_ping_correlation
from sonar_sim.validation.v09_range_lines import v09_range_lines
from sonar_sim.validation.v13_bearings import v13_bearings
from sonar_sim.validation.v14_quantiser import v14_quantiser

CASES = (
    v06_beam_pattern,
    v07_speckle,
    v08_ping_correlation,
    v09_range_lines,
    v13_bearings,
    v14_quantiser,
)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__)
def test_every_number_of_the_case_is_near_enough(case: Callable[[], CaseResult]) -> None:
    result = case()
    assert result.checks
    assert [check for check in result.checks if not check.holds] == []
