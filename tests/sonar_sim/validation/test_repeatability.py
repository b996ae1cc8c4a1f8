from sonar_sim.validation.repeatability import v18_classic


def test_constants_of_the_published_pipeline() -> None:
    result = v18_classic()
    assert [check for check in result.checks if not check.holds] == []
    assert len(result.checks) == 8
