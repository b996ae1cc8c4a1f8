"""What is worth choosing, by hand and against brute force."""

import math

import pytest
from accuracy_cost.front import Lag, Point, dominates, front, lag
from accuracy_cost.study import Setting
from hypothesis import given
from hypothesis import strategies as st

NAN = math.nan
FIGURES = st.integers(0, 4).map(float) | st.just(NAN)


def point(cost: float, error: float, label: str = "") -> Point:
    return Point(Setting(label, {"x": label}), cost, error)


@pytest.mark.parametrize(
    ("a", "b", "beats"),
    [
        ((1, 1), (2, 2), True),
        ((1, 2), (2, 2), True),
        ((2, 1), (2, 2), True),
        ((2, 2), (2, 2), False),
        ((1, 3), (2, 2), False),
        ((3, 1), (2, 2), False),
    ],
)
def test_a_point_dominates_where_both_are_no_worse_and_one_is_better(
    a: tuple[float, float], b: tuple[float, float], *, beats: bool
) -> None:
    assert dominates(point(*a), point(*b)) is beats


def test_the_front_goes_from_cheap_to_exact_and_leaves_out_what_is_beaten() -> None:
    points = [point(4, 1, "fine"), point(1, 4, "coarse"), point(3, 4.5, "beaten"), point(2, 2, "")]
    assert [p.cost for p in front(points)] == [1, 2, 4]


def test_equal_points_are_all_on_the_front() -> None:
    assert len(front([point(1, 1, "a"), point(1, 1, "b"), point(1, 2, "c")])) == 2


@given(st.lists(st.tuples(FIGURES, FIGURES), max_size=12))
def test_every_point_is_on_the_front_or_beaten_by_one_on_it(
    pairs: list[tuple[float, float]],
) -> None:
    points = [point(*pair, str(place)) for place, pair in enumerate(pairs)]
    best = front(points)
    for p in points:
        if math.isnan(p.cost + p.error):
            assert p not in best
        else:
            assert (p in best) != any(dominates(q, p) for q in best)
    assert not any(dominates(p, q) for p in best for q in best)


def test_a_lag_is_the_share_of_the_error_that_others_avoid_at_no_more_cost() -> None:
    others = [point(9, 0.9, "a"), point(10, 0.8, "b"), point(11, 0.1, "dear"), point(1, 1.1, "bad")]
    assert lag(point(10, 1), others) == Lag(1 - 0.8, others[1].setting)


def test_costs_within_a_twentieth_are_the_same() -> None:
    assert lag(point(100, 1), [point(105, 0.5)]).share == pytest.approx(0.5)
    assert lag(point(100, 1), [point(105.1, 0.5)]) == Lag(0.0, None)


def test_no_lag_behind_errors_that_are_equal_or_do_not_exist() -> None:
    assert lag(point(10, 1), [point(5, 1), point(5, NAN), point(NAN, 0.5)]) == Lag(0.0, None)


def test_an_error_that_does_not_exist_is_worse_than_any() -> None:
    assert lag(point(10, NAN), [point(5, 100)]).share == 1.0
