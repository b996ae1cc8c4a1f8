"""The page of survey products matches what the programs write."""

import re
from pathlib import Path

import msgspec
import pytest
from mapper_survey import report
from mapper_survey.export import PRODUCTS
from mapper_survey.report import (
    DIFFERENCE,
    REPORT,
    VERSION,
    CoverageRecord,
    DiveRecord,
    HeightRecord,
    PairRecord,
    Report,
    WayRecord,
)
from mapper_survey.running import MAP
from mapper_survey.surface import CELL_VOXELS, RULES

PAGE = (Path(__file__).resolve().parents[3] / "docs/reference/survey-products.md").read_text(
    "utf-8"
)


@pytest.mark.parametrize(
    "record", [Report, CoverageRecord, DiveRecord, HeightRecord, PairRecord, WayRecord]
)
def test_every_field_of_the_report_is_reported(record: type[msgspec.Struct]) -> None:
    names = {field.name for field in msgspec.structs.fields(record)}
    assert names - set(re.findall(r"`(\w+)`", PAGE)) == set()


def test_every_file_is_reported() -> None:
    pictures = [getattr(report, name) for name in ("COVERAGE", "OVERLAP", "DISAGREEMENT")]
    for name in (*PRODUCTS.values(), *pictures, report.DISTANCES, REPORT, DIFFERENCE):
        assert f"`{name}`" in PAGE
    assert f"`{MAP}`" in PAGE
    assert f"of this layout: {VERSION}" in PAGE


def test_choices_are_reported() -> None:
    *some, last = CELL_VOXELS
    assert f"`--cell-voxels` {', '.join(map(str, some))} or {last}" in PAGE
    for rule in RULES:
        assert f"`--rule {rule}`" in PAGE
