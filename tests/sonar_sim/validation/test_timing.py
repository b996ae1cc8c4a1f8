from sonar_sim.validation.timing import v15_timing


def test_a_ping_lasts_as_long_as_the_sound_is_under_way() -> None:
    result = v15_timing()
    assert [check for check in result.checks if not check.holds] == []
    assert len(result.checks) == 8
