"""The architecture page names files that exist."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "concepts" / "architecture.md").read_text()


def test_every_file_in_the_text_exists() -> None:
    named = re.findall(r"`((?:mapperd|oculus_driver|cpp)/[\w/.]*)`", PAGE)
    assert len(named) > 15
    assert [path for path in named if not (ROOT / path).exists()] == []


def test_every_file_in_the_diagrams_exists() -> None:
    named = re.findall(r"\[([a-z]+/[a-z_]+\.py)", PAGE)
    assert len(named) > 10
    assert [path for path in named if not (ROOT / "mapperd" / path).exists()] == []


def test_the_package_list_is_whole() -> None:
    listed = set(re.findall(r"`(\w+)`", PAGE.partition("## Packages")[2].partition("| package")[2]))
    packages = {path.parent.name for path in (ROOT / "mapperd").glob("*/__init__.py")}
    assert packages - listed == set()
