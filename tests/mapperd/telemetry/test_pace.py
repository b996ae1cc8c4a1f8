from itertools import pairwise
from random import Random

import pytest

from mapperd.telemetry.payloads import BackOff, Throttle


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


def test_pauses_grow_from_1_to_30_s_and_are_spread() -> None:
    chance = Random(1)  # noqa: S311 no secret
    runs = []
    for _ in range(200):
        back_off = BackOff(chance.random)
        runs.append([back_off.after(0.0) for _ in range(20)])
    everything = [pause for run in runs for pause in run]
    assert min(everything) >= 1.0
    assert max(everything) <= 30.0
    first = [run[0] for run in runs]
    assert max(first) <= 3.0
    assert max(first) - min(first) > 1.5
    assert sum(run[-1] for run in runs) / len(runs) > 10


def test_pauses_start_again_after_a_connection_that_held() -> None:
    back_off = BackOff(lambda: 1.0)
    assert [back_off.after(0.0) for _ in range(4)] == [3.0, 9.0, 27.0, 30.0]
    assert back_off.after(5.0) == 30.0  # it flaps
    assert back_off.after(30.0) == 3.0
