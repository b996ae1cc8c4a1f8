from sonar_sim.validation.propagation import v01_absorption


def test_both_absorption_formulas_give_the_published_table() -> None:
    result = v01_absorption()
    assert len(result.checks) == 8 * 2 * 2 + 3 + 1
    assert [check for check in result.checks if not check.holds] == []
