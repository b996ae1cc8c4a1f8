"""Rows outlive any stop; what is cut is measured again."""

import csv
import math
from pathlib import Path

import pytest
from studies.accuracy_cost.results import (
    Key,
    append,
    key_of,
    open_results,
    read_results,
    write_results,
)
from studies.accuracy_cost.study import Setting, Study, StudyDive

HEAD = {"commit": "abc", "machine": "a computer, 2 cores", "command": "accuracy-cost run"}
FIGURES = {"error_m": 0.123456789, "cpu_ms": math.nan, "share": 1.0}
ROWS = [Key("calm", 1, "default"), Key("calm", 1, "a=1 b=2"), Key("storm", 2, 'odd, "text"')]


@pytest.fixture
def path(tmp_path: Path, fake: Study) -> Path:
    """A file of three rows."""
    path = tmp_path / "fake.csv"
    results = open_results(path, fake, HEAD)
    for key in ROWS:
        append(path, results, key, FIGURES)
    return path


def test_a_row_is_named_by_its_overrides_whatever_their_order() -> None:
    dive = StudyDive("calm", 1)
    assert key_of(Setting("x", {"b": 2, "a": 1}), dive) == ROWS[1]
    assert key_of(Setting("y", {}), dive) == ROWS[0]


def test_what_is_appended_is_read_again(path: Path) -> None:
    results = read_results(path)
    assert list(results.rows) == ROWS
    assert results.head == {"study": "fake", **HEAD}
    figures = results.rows[ROWS[2]]
    assert figures["error_m"] == pytest.approx(0.123456789, rel=1e-5)
    assert math.isnan(figures["cpu_ms"])


def test_another_reader_reads_the_rows(path: Path) -> None:
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    rows = list(csv.DictReader(lines))
    assert [(r["study"], r["dive"], r["seed"], r["setting"]) for r in rows] == [
        ("fake", *map(str, key)) for key in ROWS
    ]
    assert float(rows[0]["share"]) == 1.0


def test_a_cut_anywhere_loses_at_most_the_row_that_it_cut(path: Path, fake: Study) -> None:
    whole = path.read_bytes()
    ends = [at for at in range(len(whole)) if whole[at : at + 1] == b"\n"][-3:]
    for length in range(ends[0] - 20, len(whole) + 1):
        path.write_bytes(whole[:length])
        results = open_results(path, fake, HEAD)
        kept = sum(length > end for end in ends)
        assert list(results.rows) == ROWS[:kept]
        for key in ROWS[kept:]:
            append(path, results, key, FIGURES)
        assert path.read_bytes() == whole


def test_a_row_that_no_one_can_read_is_measured_again(path: Path, fake: Study) -> None:
    with path.open("ab") as file:
        file.write(b"\0\0\0\n")
        file.write(b"fake,calm,1,late,1,2\n")
    assert list(open_results(path, fake, HEAD).rows) == ROWS


@pytest.mark.parametrize("other", [{"commit": "def"}, {"machine": "another"}])
def test_rows_of_another_commit_or_machine_are_put_aside(
    path: Path, fake: Study, other: dict[str, str]
) -> None:
    old = path.read_bytes()
    assert open_results(path, fake, HEAD | other).rows == {}
    assert path.with_suffix(".abc.csv").read_bytes() == old


def test_figures_must_be_those_of_the_columns(path: Path, fake: Study) -> None:
    results = open_results(path, fake, HEAD)
    with pytest.raises(ValueError, match="differ: other, share"):
        append(path, results, Key("calm", 1, "x"), {"error_m": 1, "cpu_ms": 1, "other": 1})
    assert len(results.rows) == 3


def test_rows_are_written_in_the_order_asked_for(path: Path) -> None:
    write_results(path, read_results(path), ROWS[::-1])
    assert list(read_results(path).rows) == ROWS[::-1]
