"""What is worth choosing, by hand and against brute force."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import pytest
from hypothesis import given
from hypothesis import strategies as st
from studies.accuracy_cost.front import (
    Lag,
    Plane,
    Point,
    dominates,
    front,
    lag,
    mean_point,
    plane_of,
)
from studies.accuracy_cost.results import StudyResults, key_of
from studies.accuracy_cost.study import DEFAULT, Setting, Study

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


def test_a_difference_that_may_be_chance_is_no_lag() -> None:
    drawn = Point(Setting("", {}), 10, 1.0, chance=0.03)
    sure, unsure = point(9, 0.8, "sure"), Point(Setting("unsure", {"x": "u"}), 9, 0.7, chance=0.14)
    assert lag(drawn, [point(9, 0.95)]) == Lag(0.0, None)
    # Two standard errors of the difference are taken off: 0.06 and 2 hypot(0.03, 0.14) = 0.286.
    found = lag(drawn, [unsure, sure])
    assert found.better == sure.setting
    assert found.share == pytest.approx(1.0 - 0.86)


def test_the_mean_over_dives_is_surer_than_each(fake: Study) -> None:
    results = StudyResults({"study": "fake"}, ["error_m", "cpu_ms", "error_chance_m"])
    for dive, chance in zip(fake.dives, (0.3, 0.4), strict=True):
        row = {"error_m": 1.0, "cpu_ms": 1.0, "error_chance_m": chance}
        results.rows[key_of(DEFAULT, dive)] = row
    plane = Plane("cpu_ms", "error_m", "error_chance_m")
    assert mean_point(plane, results, DEFAULT, fake.dives).chance == pytest.approx(0.25)
    assert mean_point(Plane("cpu_ms", "error_m"), results, DEFAULT, fake.dives).chance == 0.0


def test_an_error_has_the_chance_that_its_column_names(fake: Study) -> None:
    columns = tuple(
        replace(column, chance="share" if column.name == "error_m" else None)
        for column in fake.columns
    )
    drawn = SimpleNamespace(cost="cpu_ms", error="error_m", columns=columns)
    assert plane_of(cast("Study", drawn)) == Plane("cpu_ms", "error_m", "share")
    assert plane_of(fake) == Plane("cpu_ms", "error_m", None)


def test_an_error_that_does_not_exist_is_worse_than_any() -> None:
    assert lag(point(10, NAN), [point(5, 100)]).share == 1.0
