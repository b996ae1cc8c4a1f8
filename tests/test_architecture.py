"""The architecture page names files that exist and lie near; packages have few modules."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "concepts" / "architecture.md").read_text()

MAX_MODULES = {"mapperd": 250, "oculus_driver": 70, "tools/sonar_sim": 130}
MAX_FLAT_FILES = 10
MAX_CLICKS = 3


SUFFIX = r"\.(?:py|pyi|cpp|hpp|md|yaml|toml)"


def named(page: str) -> list[str]:
    """Return all files and folders of the text.

    A name alone is joined with the folder of "`name` in `folder/`", else with that of the path
    before it in its line.
    """
    found = []
    for line in page.splitlines():
        folder = Path("mapperd")
        for match in re.finditer(r"`([\w./]+)`", line):
            name = match[1]
            if re.match(r"(?:mapperd|oculus_driver|cpp|tools)/", name):
                path = Path(name)
                folder = path if name.endswith("/") else path.parent
            elif re.fullmatch(rf"\w+{SUFFIX}", name):
                after = re.match(r"(?:(?:, | and )`[\w.]+`)* in `([\w/]+/)`", line[match.end() :])
                path = Path(after[1] if after else folder) / name
            else:
                continue
            found.append(str(path))
    return found


def too_deep(paths: list[str]) -> list[str]:
    return [path for path in paths if len(Path(path).parts) > MAX_CLICKS]


def test_every_file_in_the_text_exists() -> None:
    assert len(named(PAGE)) > 25
    ground = {"api.py", "io.py", "session_log.py", "errors.py", "events.py"}
    assert ground <= {Path(path).name for path in named(PAGE)}
    assert [path for path in named(PAGE) if not (ROOT / path).exists()] == []


def test_every_file_in_the_text_is_three_clicks_away() -> None:
    assert too_deep(named(PAGE)) == []


def test_a_file_that_is_named_beside_its_folder_is_found() -> None:
    text = (
        "`a.cpp` and `b.cpp` in `cpp/map/src/`\n`mapperd/wire/x.py`, `y.py`; `Name`; `tools/z/`\n"
    )
    paths = ["cpp/map/src/a.cpp", "cpp/map/src/b.cpp", "cpp/map/src"]
    assert named(text) == [*paths, "mapperd/wire/x.py", "mapperd/wire/y.py", "tools/z"]
    assert too_deep(named(text)) == paths[:2]


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
