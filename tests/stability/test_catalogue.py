"""The hard cases read as a catalogue, and the page counts all of them."""

from __future__ import annotations

import pytest
from studies.numerics.catalogue import CASES, case_of, cases, catalogue, listing
from studies.report import PAGES, section

MIN_CASES = 80


def test_every_case_states_what_it_guards_against_and_what_happens_naively() -> None:
    found = list(cases())
    assert len(found) >= MIN_CASES
    assert len({case.name for case in found}) == len(found), "two cases of one name"


def test_every_test_is_a_case_of_its_own() -> None:
    """A test within a class, or an asynchronous one, would be left out of the catalogue."""
    listed = {case.name for case in cases()}
    for path in CASES.glob("test_*.py"):
        if not path.stem.endswith("catalogue"):
            lines = path.read_text(encoding="utf-8").splitlines()
            names = {
                line.split("def ")[1].split("(")[0] for line in lines if "def test_" in line[:20]
            }
            assert names <= listed, path.name


def test_the_page_is_up_to_date() -> None:
    """`PYTHONPATH=tools python -m studies hard-cases` writes it."""
    page = PAGES["numerical-stability"].read_text(encoding="utf-8")
    assert section(page, "catalogue", catalogue(list(cases()))) == page


@pytest.mark.parametrize(
    "docstring",
    [
        None,
        "",
        "What holds.",
        "Naively it fails.",
        "What holds. It would fail naively.",
        "What holds. Naively it fails",
        "What holds. Naively it fails. Naively it also does that.",
        "What holds, naively. NaN comes.",
    ],
)
def test_another_form_is_refused(docstring: str | None) -> None:
    with pytest.raises(ValueError, match="Naively"):
        case_of("test_mapping_any.py", "test_any", docstring)


@pytest.mark.parametrize("gap", [" ", "\n\n", "\n    "])
def test_the_two_parts_are_two_sentences_or_paragraphs(gap: str) -> None:
    case = case_of("test_clock_any.py", "test_any", f"What\nholds. Always.{gap}Naively, it fails.")
    assert (case.area, case.guard) == ("clock", "What holds. Always.")
    assert case.naive == "Naively, it fails."


def test_a_case_is_counted_in_its_area_and_listed_with_both_parts() -> None:
    case = case_of("test_clock_any.py", "test_any", "|q| is 1. Naively it is not.")
    assert "| clock | 2 |" in catalogue([case, case])
    assert listing([case]) == "test_clock_any.py: test_any\n  |q| is 1.\n  Naively it is not."


@pytest.mark.parametrize("page", ["", "<!-- other: begin, x -->\n<!-- other: end -->"])
def test_a_page_without_a_place_is_refused(page: str) -> None:
    with pytest.raises(ValueError, match="no section to write into"):
        section(page, "catalogue", "")
