from itertools import pairwise

import pytest

from mapperd.telemetry.payloads import Throttle


@pytest.mark.parametrize("asked_hz", [3, 7, 20, 97])
def test_pace_is_kept_on_average_however_often_it_is_asked(asked_hz: float) -> None:
    pace, rate_hz, seconds = Throttle(1 / 5), 5, 100
    due_s = [k / asked_hz for k in range(round(seconds * asked_hz)) if pace.due(k / asked_hz)]
    assert len(due_s) <= rate_hz * seconds + 1
    assert len(due_s) >= 0.95 * min(rate_hz, asked_hz) * seconds
    gaps_s = [b - a for a, b in pairwise(due_s)]
    assert min(gaps_s) >= 0.1 - 1e-9


def test_pace_makes_nothing_up_after_a_pause() -> None:
    pace = Throttle(1.0)
    assert pace.due(0.0)
    assert [pace.due(60.0 + k / 10) for k in range(9)] == [True] + [False] * 8
