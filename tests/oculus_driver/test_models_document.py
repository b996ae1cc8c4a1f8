"""docs/reference/models.md states what the driver knows about models, no more and no less."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from oculus_driver.models import BEAMS, FAMILIES, MAX_RATE_HZ, MODELS, ModeSpec, max_rate_hz
from oculus_driver.wire import PingRate

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "reference" / "models.md").read_text(
    encoding="utf-8"
)
RANGES_M = (5, 10, 20, 30, 40, 60, 80, 100, 120, 200)


def rows(*cells: tuple[str, ...]) -> list[str]:
    return ["| " + " | ".join(row) + " |" for row in cells]


def number(value: float | None) -> str:
    return "not known" if value is None else f"{value:g}"


def mode_row(family: str, place: int, mode: ModeSpec) -> tuple[str, ...]:
    frequency = None if mode.frequency_hz is None else mode.frequency_hz / 1e3
    elevation = (
        "not known" if mode.elevation_deg is None else " or ".join(map(number, mode.elevation_deg))
    )
    labels = (frequency, mode.max_range_m, mode.aperture_deg)
    return (family, str(place), *map(number, labels), elevation, number(mode.resolution_deg))


def mode_table() -> list[str]:
    return rows(
        *(
            mode_row(family.name, place, mode)
            for family in FAMILIES
            for place, mode in enumerate(family.modes, start=1)
        )
    )


def rate_table() -> list[str]:
    ordered = sorted(MAX_RATE_HZ.items(), key=lambda item: item[1])
    return rows(*((rate.name.lower(), str(rate.value), f"{hertz:g}") for rate, hertz in ordered))


def range_table() -> list[str]:
    return rows(*((str(r), f"{max_rate_hz(PingRate.HIGHEST, r):.3g}") for r in RANGES_M))


def part_table() -> list[str]:
    return rows(
        *(
            (str(model.part_number), model.name, model.family.name)
            for model in sorted(
                MODELS.values(), key=lambda m: (FAMILIES.index(m.family), m.part_number)
            )
        )
    )


def tables_of(page: str) -> list[list[str]]:
    """Return the bodies of all tables, line by line."""
    blocks = re.findall(r"^\|.*\n\|[-|]+\|\n((?:\|.*\n)+)", page, re.MULTILINE)
    return [block.splitlines() for block in blocks]


@pytest.mark.parametrize(
    ("place", "expected"),
    [(0, mode_table()), (1, rate_table()), (2, range_table()), (3, part_table())],
    ids=["modes", "rates", "ranges", "parts"],
)
def test_the_table_agrees_with_the_driver(place: int, expected: list[str]) -> None:
    assert tables_of(PAGE)[place] == expected


def test_the_number_of_beams_is_reported() -> None:
    assert f"{BEAMS[0]} or {BEAMS[1]} beams" in PAGE
