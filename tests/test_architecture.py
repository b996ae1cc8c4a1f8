"""The architecture page names files that exist and lie near; packages have few modules."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "concepts" / "architecture.md").read_text()

MAX_MODULES = {"mapperd": 250, "oculus_driver": 70, "tools/sonar_sim": 130}
MAX_FLAT_FILES = 10
MAX_CLICKS = 3


def named() -> list[str]:
    return re.findall(r"`((?:mapperd|oculus_driver|cpp|tools)/[\w/.]*)`", PAGE)


def test_every_file_in_the_text_exists() -> None:
    assert len(named()) > 15
    assert [path for path in named() if not (ROOT / path).exists()] == []


def test_every_file_in_the_text_is_three_clicks_away() -> None:
    assert [path for path in named() if len(Path(path).parts) > MAX_CLICKS] == []


def test_every_file_that_a_folder_is_named_for_exists() -> None:
    found = re.findall(r"((?:`\w+\.\w+`(?:, | and )?)+) in `([\w/]+)`", PAGE)
    assert len(found) > 2
    files = [(folder, file) for files, folder in found for file in re.findall(r"`(.+?)`", files)]
    assert [pair for pair in files if not ROOT.joinpath(*pair).exists()] == []


def test_every_file_in_the_diagrams_exists() -> None:
    drawn = re.findall(r"\[([a-z]+/[a-z_]+\.py)", PAGE)
    assert len(drawn) > 10
    assert [path for path in drawn if not (ROOT / "mapperd" / path).exists()] == []


def test_the_package_list_is_whole() -> None:
    listed = set(re.findall(r"`(\w+)`", PAGE.partition("## Packages")[2].partition("| package")[2]))
    packages = {path.parent.name for path in (ROOT / "mapperd").glob("*/__init__.py")}
    assert packages - listed == set()


@pytest.mark.parametrize("package", MAX_MODULES)
def test_a_package_has_few_modules(package: str) -> None:
    """Merge a module that only one sibling imports, rather than raise a limit."""
    assert len(list((ROOT / package).rglob("*.py"))) <= MAX_MODULES[package]


def test_mapperd_has_few_files_beside_its_packages() -> None:
    flat = [
        path for path in (ROOT / "mapperd").iterdir() if path.suffix in {".py", ".pyi", ".typed"}
    ]
    assert 0 < len(flat) <= MAX_FLAT_FILES
