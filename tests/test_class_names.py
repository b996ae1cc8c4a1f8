"""A class name means one thing: no two modules of the sources define a class of one name."""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("mapperd", "oculus_driver", "tools")
SHARED = {"Reject"}
"""Has one meaning in two places: the driver works alone and cannot import the daemon's."""

CPP_CLASS = re.compile(r"^ *(?:class|struct) (\w+)(?: final)?(?: : [^;]*)? \{$", re.MULTILINE)


def classes_of(source: str) -> Iterator[str]:
    """Names of all classes of a module, inner ones among them."""
    return (node.name for node in ast.walk(ast.parse(source)) if isinstance(node, ast.ClassDef))


def names_defined_twice(root: Path) -> dict[str, list[str]]:
    """Files of each class name that is defined more than once below `FOLDERS`."""
    files = defaultdict(list)
    for folder in FOLDERS:
        for path in sorted((root / folder).rglob("*.py")):
            for name in classes_of(path.read_text(encoding="utf-8")):
                files[name].append(str(path.relative_to(root)))
    return {name: paths for name, paths in files.items() if len(paths) > 1}


def cpp_names_defined_twice(root: Path) -> dict[str, list[str]]:
    """The same for C++, without tests and benches."""
    files = defaultdict(list)
    for path in sorted((root / "cpp").rglob("*.[ch]pp")):
        if {"test", "bench"} & set(path.parts):
            continue
        for name in CPP_CLASS.findall(path.read_text(encoding="utf-8")):
            files[name].append(str(path.relative_to(root)))
    return {name: paths for name, paths in files.items() if len(paths) > 1}


def test_every_class_name_is_defined_once() -> None:
    assert all(any((ROOT / folder).rglob("*.py")) for folder in FOLDERS)
    assert {k: v for k, v in names_defined_twice(ROOT).items() if k not in SHARED} == {}


def test_every_cpp_class_name_is_defined_once() -> None:
    assert sum(1 for _ in (ROOT / "cpp").rglob("*.hpp")) > 50
    assert cpp_names_defined_twice(ROOT) == {}


def test_a_planted_second_cpp_class_is_found(tmp_path: Path) -> None:
    for folder, text in (
        ("map/src", "struct View : Base {\n};\nclass View;\n"),
        ("python", "  class View final {\n};\n"),
        ("map/test", "struct View {\n};\n"),
    ):
        (tmp_path / "cpp" / folder).mkdir(parents=True)
        (tmp_path / "cpp" / folder / "a.cpp").write_text(text)
    assert cpp_names_defined_twice(tmp_path) == {"View": ["cpp/map/src/a.cpp", "cpp/python/a.cpp"]}


def test_a_planted_second_class_is_found(tmp_path: Path) -> None:
    for folder in FOLDERS:
        (tmp_path / folder).mkdir()
    (tmp_path / "mapperd" / "a.py").write_text("class View:\n    class Inner: ...\n")
    (tmp_path / "tools" / "b.py").write_text("def f():\n    class View: ...\n")
    assert names_defined_twice(tmp_path) == {"View": ["mapperd/a.py", "tools/b.py"]}
