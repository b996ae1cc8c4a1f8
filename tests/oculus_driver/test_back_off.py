import pytest
from hypothesis import given
from hypothesis import strategies as st

from oculus_driver.back_off import BackOff, doubling_steps


def test_delays_follow_the_steps_until_an_attempt_succeeds() -> None:
    back_off = BackOff((1, 2, 5))
    assert [back_off.failed() for _ in range(5)] == [1, 2, 5, 5, 5]
    assert back_off.failures == 5
    back_off.succeeded()
    assert (back_off.failures, back_off.failed()) == (0, 1)


@given(chance=st.floats(0.0, 1.0), failures=st.integers(1, 50))
def test_delays_are_jittered_down_to_half_of_their_step(chance: float, failures: int) -> None:
    steps = (0.5, 1.0, 2.0, 5.0)
    back_off = BackOff(steps, lambda: chance)
    delay = [back_off.failed() for _ in range(failures)][-1]
    step = steps[min(failures, 4) - 1]
    assert step / 2 <= delay <= step
    assert delay == pytest.approx(step * (1 - chance / 2))


def test_steps_double_up_to_the_longest() -> None:
    assert doubling_steps(0.25, 5.0) == (0.25, 0.5, 1.0, 2.0, 4.0, 5.0)
    assert doubling_steps(3.0, 3.0) == (3.0,)
    assert doubling_steps(3.0, 1.0) == (3.0,)
