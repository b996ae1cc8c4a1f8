from pathlib import Path

import pytest
from sonar_sim.scene_file import schema
from sonar_sim.scene_file.reference import PAGE, reference
from sonar_sim.scene_file.schema import Section

ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.slow
def test_page_is_made_from_the_types() -> None:
    page = (ROOT / PAGE).read_text(encoding="utf-8")
    assert page == reference(), "write it again: python -m sonar_sim.scene_file.reference"


@pytest.mark.slow
def test_every_setting_has_a_meaning() -> None:
    lines = [line for line in reference().splitlines() if line.startswith("| `")]
    names = {line.split("`")[1] for line in lines}
    for section in vars(schema).values():
        if isinstance(section, type) and issubclass(section, Section):
            assert set(section.__struct_fields__) <= names, section
    assert [line for line in lines if line.endswith("|  |")] == []


@pytest.mark.slow
def test_limits_of_numbers_are_intervals() -> None:
    page = reference()
    assert "| `temperature_c` | [-2, 40] | °C | 10.0 | Temperature. |" in page
    assert "| `count` | integer [1, 1000] |  | required |" in page
    assert "| (0, " in page
    assert "list of 2 x number" in page
