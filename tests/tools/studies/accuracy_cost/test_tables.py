"""Tables of settings, from known figures."""

from studies.accuracy_cost.results import StudyResults, key_of
from studies.accuracy_cost.study import Study
from studies.accuracy_cost.tables import section


def page(fake: Study, **figures: tuple[float, float]) -> str:
    """Of (error, cost) by the label of a knob's setting, the same on both dives."""
    results = StudyResults({"study": "fake", "commit": "abc"}, ["error_m", "cpu_ms", "share"])
    for knob in fake.knobs:
        for setting in knob.settings:
            error, cost = figures.get(f"_{setting.label}".replace(".", "_"), (9.0, 99.0))
            for dive in fake.dives:
                row = {"error_m": error, "cpu_ms": cost, "share": 0.0}
                results.rows[key_of(setting, dive)] = row
    return section(fake, results)


def test_knobs_that_save_most_come_first(fake: Study) -> None:
    text = page(fake, _1=(1.0, 10.0), _2=(1.05, 5.0), _3=(1.2, 1.0), _slow=(1.1, 4.0))
    assert "| way | slow | 0.40 | +10 % |\n| size | 2 | 0.50 | +5 % |\n\n" in text


def test_a_twentieth_of_the_time_is_no_saving(fake: Study) -> None:
    assert "No knob saves time" in page(fake, _1=(1.0, 10.0), _2=(1.0, 9.6))
    assert "| size | 2 | 0.95 | +0 % |" in page(fake, _1=(1.0, 10.0), _2=(1.0, 9.5))


def test_a_default_behind_the_front_is_reported_with_its_margin(fake: Study) -> None:
    text = page(fake, _1=(1.0, 10.0), _2=(0.8, 5.0))
    assert "| 20 % behind 2 (margin 10 %) |" in text
    assert "| yes |" in text


def test_what_was_not_measured_is_no_figure(fake: Study) -> None:
    results = StudyResults({"study": "fake"}, ["error_m", "cpu_ms", "share"])
    text = section(fake, results)
    assert "| error, m | - | - |" in text
    assert "| not measured |" in text
