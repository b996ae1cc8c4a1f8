"""docs/reports/accuracy-cost.md shows what is recorded: all of it, and nothing else."""

import pytest
from studies.accuracy_cost.command import RECORDED
from studies.accuracy_cost.drawing import PAGE
from studies.accuracy_cost.results import StudyResults, read_results
from studies.accuracy_cost.running import wanted_keys
from studies.accuracy_cost.study import MODULES, Selection, Study, load
from studies.accuracy_cost.tables import IMAGES, section

MAX_BYTES = 80_000


@pytest.fixture(params=MODULES)
def study(request: pytest.FixtureRequest) -> Study:
    """Each of the four."""
    return load(MODULES[request.param])


@pytest.fixture
def recorded(study: Study) -> StudyResults:
    """Its committed figures."""
    return read_results(RECORDED / f"{study.name}.csv")


def test_every_setting_is_recorded(study: Study, recorded: StudyResults) -> None:
    assert list(recorded.rows) == wanted_keys(study, Selection())
    assert list(recorded.columns) == [column.name for column in study.columns]


def test_the_page_holds_the_recorded_figures(study: Study, recorded: StudyResults) -> None:
    assert section(study, recorded) in PAGE.read_text(encoding="utf-8")


def test_every_picture_is_there_and_small(study: Study) -> None:
    pictures = PAGE.parent / IMAGES
    names = [study.name, *(f"{study.name}-{knob.name}" for knob in study.knobs)]
    sizes = {name: (pictures / f"{name}.png").stat().st_size for name in names}
    assert {name: size for name, size in sizes.items() if size > MAX_BYTES} == {}
