"""When a default is no longer worth choosing."""

import math
from dataclasses import replace
from pathlib import Path

import pytest
from studies.accuracy_cost.command import measure_quick, verdict, verdicts
from studies.accuracy_cost.results import StudyResults, key_of
from studies.accuracy_cost.study import AccuracyCostError, Study


def recorded(fake: Study, figures: dict[str, tuple[float, float]]) -> StudyResults:
    """Results of (cost, error) by label, the same on all dives."""
    results = StudyResults({"study": "fake"}, ["error_m", "cpu_ms", "share"])
    for setting in fake.knobs[0].settings:
        if setting.label in figures:
            cost, error = figures[setting.label]
            for dive in fake.dives:
                row = {"error_m": error, "cpu_ms": cost, "share": 0.0}
                results.rows[key_of(setting, dive)] = row
    return results


COSTS = {"0.5": (40.0, 9.0), "1": (10.0, 9.0), "2": (2.5, 9.0), "3": (3.0, 9.0)}
"""Recorded: the errors there are of no weight."""


def errors(at_half: float, at_two: float) -> dict[str, tuple[float, float]]:
    """Measured now: the costs there are of no weight."""
    return {"0.5": (0.0, at_half), "1": (99.0, 1.0), "2": (99.0, at_two), "3": (99.0, math.nan)}


@pytest.mark.parametrize(
    ("at_half", "at_two", "share"),
    [(0.1, 1.1, 0.0), (0.1, 1.0, 0.0), (0.1, 0.95, 0.05), (0.1, 0.85, 0.15)],
)
def test_a_default_lags_where_another_setting_has_less_error_at_no_more_recorded_cost(
    fake: Study, at_half: float, at_two: float, share: float
) -> None:
    now = recorded(fake, errors(at_half, at_two))
    found = verdict(fake, fake.knobs[0], fake.dives, now, recorded(fake, COSTS))
    assert found.lag is not None
    assert found.lag.share == pytest.approx(share)
    assert found.good is (share <= fake.knobs[0].margin)


def test_a_verdict_names_knob_margin_and_the_setting_that_beats_the_default(fake: Study) -> None:
    now, costs = recorded(fake, errors(0.1, 0.85)), recorded(fake, COSTS)
    (found,) = verdicts({"fake_study": fake}, {"fake": now}, {"fake": costs})
    assert str(found) == (
        "fake: size: the default lies 15.0 % behind the front (margin 10 %): "
        "2 has less error at no more cost"
    )


def test_a_knob_may_be_judged_by_an_error_of_its_own(fake: Study) -> None:
    now, costs = recorded(fake, errors(0.1, 0.5)), recorded(fake, COSTS)
    knob = replace(fake.knobs[0], error="other")
    for key, row in now.rows.items():
        row["other"] = 3.0 if key.setting == "default" else 4.0
    assert verdict(fake, knob, fake.dives, now, costs).good
    assert not verdict(fake, fake.knobs[0], fake.dives, now, costs).good


def test_a_default_whose_cost_was_never_recorded_is_not_good(fake: Study) -> None:
    costs = recorded(fake, {"2": (1.0, 1.0)})
    now = recorded(fake, errors(0.1, 1.1))
    found = verdict(fake, fake.knobs[0], fake.dives, now, costs)
    assert not found.good
    assert "run make accuracy-cost" in str(found)


def test_the_quick_subset_is_the_quick_knobs_on_the_quick_dives(
    fake: Study, tmp_path: Path
) -> None:
    results = measure_quick("fake_study", fake, tmp_path)
    assert [key.setting for key in results.rows] == ["default", "size=0.5", "size=2", "size=3"]
    assert {key.dive for key in results.rows} == {"calm"}


@pytest.mark.parametrize(
    ("fault", "stated"),
    [
        ("FAKE_2=raises", "fake: calm, 2: ValueError: no such setting"),
        ("FAKE_UNPREPARED=calm", "fake: calm, its files: OSError: no sea"),
    ],
)
def test_what_cannot_be_measured_ends_the_check(
    fake: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str, stated: str
) -> None:
    monkeypatch.setenv(*fault.split("="))
    with pytest.raises(AccuracyCostError, match=stated):
        measure_quick("fake_study", fake, tmp_path)
