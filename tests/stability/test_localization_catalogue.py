"""The tables of docs/reports/localization.md name existing tests and all hard cases."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "reports" / "localization.md").read_text(encoding="utf-8")


def names_in(folder: str, files: str, pattern: str) -> set[str]:
    texts = (path.read_text(encoding="utf-8") for path in (ROOT / folder).rglob(files))
    return {name for text in texts for name in re.findall(pattern, text)}


def section(title: str) -> str:
    return PAGE.split(f"## {title}\n")[1].split("\n## ")[0]


def test_every_test_that_the_page_names_is_there() -> None:
    """A renamed test leaves a row that nothing holds."""
    tests = names_in("tests", "test_*.py", r"def (test_\w+)")
    cases = names_in("cpp/localization/test", "*.cpp", r'TEST_CASE\("([^"]+)"\)')
    for title in ("Differences from Beluga and Nav2", "Hard cases"):
        rows = [row for row in section(title).splitlines() if row.startswith("| ")][1:]
        for row in rows:
            named = re.findall(r"`([^`]+)`", row.split("|")[-2])
            for name in named:
                assert name in tests or name in cases or name.startswith("make "), row
            assert named or row.startswith("| several scanners"), row


def test_every_hard_case_is_in_the_table() -> None:
    """A case that nobody finds is one that somebody removes."""
    hard = names_in("tests/stability", "test_localization_[mw]*.py", r"def (test_\w+)")
    missing = {name for name in hard if f"`{name}`" not in section("Hard cases")}
    assert not missing
