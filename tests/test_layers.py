"""Packages import only what lies below them: contracts of import-linter, and rules for C++.

The contracts stand in pyproject.toml. In C++ map, localization and acoustics include common, and
nothing of each other.
"""

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LINT = Path(sys.executable).with_name("lint-imports")
CORE_IMPORT = re.compile(
    r"^\s*(from mapperd import .*\b_core\b|(from|import) mapperd\._core\b)", re.MULTILINE
)


CPP_LIBRARIES = ("common", "map", "localization", "acoustics")
PYTHON_HEADER = re.compile(r"#\s*include\s*[<\"](Python\.h|pybind11/|nanobind/|numpy/)")
LIBRARY_HEADER = re.compile(r"#\s*include\s*[<\"](?:mapperd/)?(map|localization|acoustics|common)/")


def sources_of(library: str, root: Path) -> Iterator[Path]:
    """Headers and sources of a C++ library; its tests and bindings may include what they like."""
    for folder in ("include", "src"):
        yield from sorted((root / "cpp" / library / folder).rglob("*.[ch]pp"))


def python_in_core(root: Path) -> list[str]:
    """Sources of C++ libraries that know of Python."""
    return [
        str(path.relative_to(root))
        for library in CPP_LIBRARIES
        for path in sources_of(library, root)
        if PYTHON_HEADER.search(path.read_text(encoding="utf-8"))
    ]


def cpp_back_arrows(root: Path) -> list[str]:
    """Sources of C++ libraries that include another library than `common`."""
    return [
        f"{path.relative_to(root)} includes {included}"
        for library in CPP_LIBRARIES
        for path in sources_of(library, root)
        for included in LIBRARY_HEADER.findall(path.read_text(encoding="utf-8"))
        if included not in {library, "common"}
    ]


def test_contracts_of_imports_are_kept() -> None:
    done = subprocess.run(  # noqa: S603 our own program
        [LINT, "--no-cache"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout


def test_a_planted_import_breaks_a_contract(tmp_path: Path) -> None:
    for name in ("low", "high"):
        (tmp_path / "planted" / name).mkdir(parents=True)
        (tmp_path / "planted" / name / "__init__.py").touch()
    (tmp_path / "planted" / "__init__.py").touch()
    (tmp_path / "planted" / "low" / "a.py").write_text("def f():\n    import planted.high\n")
    (tmp_path / ".importlinter").write_text(
        "[importlinter]\nroot_package = planted\n"
        "[importlinter:contract:1]\nname = one way\ntype = layers\nlayers =\n"
        "    planted.high\n    planted.low\n"
    )
    done = subprocess.run(  # noqa: S603 our own program
        [LINT, "--no-cache"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert "planted.low is not allowed to import planted.high" in done.stdout


def test_tools_reach_the_core_through_the_mapping() -> None:
    """The core is compiled: import-linter does not see it."""
    importing = [
        str(path.relative_to(ROOT))
        for folder in ("oculus_driver", "tools")
        for path in sorted((ROOT / folder).rglob("*.py"))
        if CORE_IMPORT.search(path.read_text(encoding="utf-8"))
    ]
    assert importing == []


def test_importing_the_package_imports_nothing_else() -> None:
    code = (
        "import sys, mapperd; "
        "print([m for m in sys.modules if m.startswith(('mapperd.', 'oculus_driver', 'numpy.'))])"
    )
    done = subprocess.run(  # noqa: S603 our own line
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_core_knows_no_python() -> None:
    assert all(any(sources_of(library, ROOT)) for library in CPP_LIBRARIES)
    assert python_in_core(ROOT) == []


def test_cpp_libraries_include_only_what_is_common() -> None:
    assert cpp_back_arrows(ROOT) == []


@pytest.mark.parametrize(
    ("file", "header", "found"),
    [
        ("common/include/mapperd/common/vec.hpp", "mapperd/map/block.hpp", True),
        ("map/src/block.cpp", "localization/grid.hpp", True),
        ("localization/src/grid.cpp", "mapperd/map/block.hpp", True),
        ("acoustics/include/acoustics/beams.hpp", "localization/grid.hpp", True),
        ("map/src/block.cpp", "mapperd/map/block.hpp", False),
        ("map/src/block.cpp", "mapperd/common/vec.hpp", False),
        ("localization/src/grid.cpp", "mapperd/common/vec.hpp", False),
        ("bind/map.cpp", "mapperd/map/block.hpp", False),
    ],
)
def test_planted_cpp_include_is_found(
    tmp_path: Path, file: str, header: str, *, found: bool
) -> None:
    path = tmp_path / "cpp" / file
    path.parent.mkdir(parents=True)
    path.write_text(f'#include "{header}"\n', encoding="utf-8")
    assert bool(cpp_back_arrows(tmp_path)) == found


def test_planted_python_header_is_found(tmp_path: Path) -> None:
    for folder in ("map/include/mapperd/map", "map/src", "acoustics/src", "acoustics/bind", "bind"):
        path = tmp_path / "cpp" / folder / "a.hpp"
        path.parent.mkdir(parents=True)
        path.write_text("#include <pybind11/pybind11.h>\n", encoding="utf-8")
    assert python_in_core(tmp_path) == [
        "cpp/map/include/mapperd/map/a.hpp",
        "cpp/map/src/a.hpp",
        "cpp/acoustics/src/a.hpp",
    ]
