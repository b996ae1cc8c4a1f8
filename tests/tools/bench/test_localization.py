"""The localization benchmark's table."""

from __future__ import annotations

from bench.localization import ABSENT, laps_of, table

LINES = [
    b'{"what": "field step", "particles": 2000, "who": "plain", "best_us": 1800, "median_us": 2}',
    b'{"what": "field step", "particles": 2000, "who": "mapperd", "best_us": 300,"median_us": 4e2}',
    b"",
    b'{"what": "range map", "particles": 0, "who": "mapperd", "best_us": 9e3, "median_us": 1e4}',
]


def test_ratios_are_to_the_plain_loop_of_the_same_work() -> None:
    rows = table(laps_of(LINES)).splitlines()[2:]
    assert rows[0].endswith("| 15.00 | 1.0 |")
    assert rows[1] == "| field step | 2000 | mapperd | 300 | 400 | 2.50 | 6.0 |"
    assert rows[2].endswith(f"| {ABSENT} | {ABSENT} |")
