from collections.abc import Callable
from pathlib import Path

import pytest
from studies.adaptive_ratio import (
    BEFORE,
    DEFAULT,
    MIDDLE,
    NOISE,
    PROMISED_PINGS,
    PUBLISHED,
    FalseAlarms,
    burst_table,
    draw,
    false_alarms,
    first_true,
    intensity_table,
    noise_row,
    pings_to_free,
    pings_to_occupied,
    probability_after,
    published_pings_to_occupied,
    reclassification_table,
)

pytestmark = pytest.mark.slow

PAGE = (Path(__file__).resolve().parents[3] / "docs/reports/mapping.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("least", [1, 2, 3, 4, 5, 63, 64, 65, 1000])
def test_search_finds_the_first(least: int) -> None:
    assert first_true(lambda n: n >= least) == least


def test_search_gives_up() -> None:
    with pytest.raises(ValueError, match="not within"):
        first_true(lambda _: False)


def test_published_rule_deadlocks_and_the_default_does_not() -> None:
    assert [published_pings_to_occupied(n) for n in (1, 2)] == [84, 2850]
    assert published_pings_to_occupied(5) == pytest.approx(210_000, rel=0.005)
    assert pings_to_occupied(PUBLISHED, 1) == pytest.approx(84, abs=2)
    # In the map's 16 bits its steps are nothing from there on.
    start = probability_after(PUBLISHED, [(5, 0)])
    assert probability_after(PUBLISHED, [(5, 0), (300_000, MIDDLE)]) == start
    assert max(pings_to_occupied(DEFAULT, n) for n in BEFORE) <= PROMISED_PINGS


def test_free_steps_are_as_published() -> None:
    for before in BEFORE:
        assert pings_to_free(PUBLISHED, before) == pings_to_free(DEFAULT, before)


@pytest.mark.parametrize("table", [reclassification_table, intensity_table, burst_table])
def test_page_shows_the_tables(table: Callable[[], list[str]]) -> None:
    assert "\n".join(table()) in PAGE


@pytest.mark.slow
@pytest.mark.parametrize("rate", [0.05, 0.3])
def test_page_shows_the_noise(rate: float) -> None:
    alarms = [false_alarms(ratio, rate, PROMISED_PINGS) for ratio in (PUBLISHED, DEFAULT)]
    assert noise_row(rate, alarms) in PAGE
    if rate == 0.05:
        assert alarms == [FalseAlarms(0.0, 0.0)] * 2


@pytest.mark.slow
def test_picture_is_drawn(tmp_path: Path) -> None:
    none = [FalseAlarms(0.0, 0.0)] * len(NOISE)
    draw(tmp_path / "new" / "a.png", {PUBLISHED: none, DEFAULT: none})
    assert (tmp_path / "new" / "a.png").read_bytes().startswith(b"\x89PNG")
