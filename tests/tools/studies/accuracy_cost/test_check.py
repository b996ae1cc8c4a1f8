"""The defaults are worth choosing: the quick subset of each study, beside the recorded costs."""

from pathlib import Path

import pytest
from studies.accuracy_cost.command import RECORDED, measure_quick, verdicts
from studies.accuracy_cost.results import read_results
from studies.accuracy_cost.study import MODULES, load


@pytest.mark.slow
@pytest.mark.parametrize("name", MODULES)
def test_no_default_leaves_the_front_by_more_than_its_margin(name: str, tmp_path: Path) -> None:
    study = load(MODULES[name])
    errors = measure_quick(MODULES[name], study, tmp_path)
    costs = read_results(RECORDED / f"{name}.csv")
    judged = verdicts({MODULES[name]: study}, {name: errors}, {name: costs})
    assert judged
    assert [str(verdict) for verdict in judged if not verdict.good] == []
