"""The promise of mapping stands on the page with the recorded figures of each dive."""

from studies.accuracy_cost.mapping import STUDY
from studies.accuracy_cost.mapping.knobs import PUBLISHED
from studies.accuracy_cost.results import StudyResults, key_of
from studies.accuracy_cost.study import DEFAULT, Selection, Study
from studies.accuracy_cost.tables import remarks


def test_each_dive_has_its_own_figures() -> None:
    results = StudyResults({}, [])
    for number, dive in enumerate(STUDY.dives, 1):
        for setting in Selection().settings_of(STUDY):
            cost = {DEFAULT.key: 2.0, PUBLISHED.key: 30.0}.get(setting.key, 50.0)
            row = {"surface_error_m": 0.1 * number, "ping_cpu_ms": cost, "log_odds_error": 1.0}
            results.rows[key_of(setting, dive)] = row
    _, text = remarks(STUDY, results)
    for number, dive in enumerate(STUDY.dives, 1):
        assert f"| {dive.name} | published | 0.{number}00 m, 30.0 ms | 15 times cheaper" in text


def test_other_studies_have_none(fake: Study) -> None:
    assert remarks(fake, StudyResults({}, [])) == []
