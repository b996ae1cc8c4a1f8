"""Dives whose trajectory lies in another file."""

import math
from pathlib import Path

import pytest
from mapper_survey.errors import SurveyError

from tests.tools.mapper_survey.dives import START_NS, rows_in, run_here, write_dive, write_survey

SECOND = 1_000_000_000


def write_tum(path: Path, *, y: float, late_s: int = 0, pings: int = 30) -> None:
    """Write the way of `write_dive`."""
    lines = []
    for k in range(pings + 1):
        t_ns = START_NS + round(0.2 * k * SECOND) + late_s * SECOND
        half = 0.05 * k / 2
        numbers = (1.0 * k, y, -3.0, 0.0, 0.0, math.sin(half), math.cos(half))
        lines.append(" ".join([f"{t_ns // SECOND}.{t_ns % SECOND:09}", *map(repr, numbers)]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def survey_of(folder: Path, y: float, **odometry: object) -> Path:
    folder.mkdir()
    survey = write_survey(folder, dives=[{"name": "a", "recording": "a.mcap", **odometry}])
    write_dive(folder / "a.mcap", 1, y=y)
    return survey


@pytest.mark.slow
def test_a_trajectory_replaces_the_recorded_odometry(tmp_path: Path) -> None:
    survey = survey_of(tmp_path / "one", 0.0, odometry=["a.tum"], odometry_offset=-60)
    write_tum(tmp_path / "one" / "a.tum", y=2.5, late_s=60)
    run_here(survey, tmp_path / "out")
    run_here(survey_of(tmp_path / "two", 2.5), tmp_path / "expected")
    rows = rows_in(tmp_path / "out" / "map.db")
    assert len(rows) >= 4
    assert rows == rows_in(tmp_path / "expected" / "map.db")
    write_tum(tmp_path / "one" / "a.tum", y=3.5, late_s=60)
    run_here(survey, tmp_path / "out")
    assert rows_in(tmp_path / "out" / "map.db") != rows


def test_a_trajectory_of_another_day_ends_the_survey(tmp_path: Path) -> None:
    survey = survey_of(tmp_path / "one", 0.0, odometry=["a.tum"])
    write_tum(tmp_path / "one" / "a.tum", y=0.0, late_s=-86_400)
    with pytest.raises(SurveyError, match=r"dive a: .*a\.tum \(TUM\) ends .* before the sonar"):
        run_here(survey, tmp_path / "out")
