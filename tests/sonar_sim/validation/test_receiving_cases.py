"""The validation cases of beams, speckle and receiver hold."""

from collections.abc import Callable

import pytest
from sonar_sim.validation.case import ValidationResult
from sonar_sim.validation.receiver import v06_beam_pattern, v13_bearings, v14_quantiser
from sonar_sim.validation.speckle import v07_speckle, v08_ping_correlation, v09_range_lines

CASES = (
    v06_beam_pattern,
    v07_speckle,
    v08_ping_correlation,
    v09_range_lines,
    v13_bearings,
    v14_quantiser,
)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__)
def test_every_number_of_the_case_is_near_enough(case: Callable[[], ValidationResult]) -> None:
    result = case()
    assert result.checks
    assert [check for check in result.checks if not check.holds] == []
