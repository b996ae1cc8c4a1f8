"""A class name means one thing: no two modules of the sources define a class of one name."""

import ast
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("mapperd", "oculus_driver", "tools")
SHARED = {"Reject"}
"""Has one meaning in two places: the driver works alone and cannot import the daemon's."""

MIRRORS = {"FilterState", "Material", "MemoryStats", "OctreeMapper", "PingImage", "PingMotion"}
"""Python classes that hold the same as the C++ class of their name."""

CPP_TYPE = r"(?:class|struct) (?:alignas\(\w+\) )?(\w+)(?: final)?\s*(?:: [^;{]*)?\{"
CPP_CLASS = re.compile(rf"^ *{CPP_TYPE}", re.MULTILINE)
CPP_NAMESPACE_CLASS = re.compile(rf"^{CPP_TYPE}", re.MULTILINE)


def classes_of(source: str) -> Iterator[str]:
    """Names of all classes of a module, inner ones among them, without leading underscores."""
    nodes = ast.walk(ast.parse(source))
    return (node.name.lstrip("_") for node in nodes if isinstance(node, ast.ClassDef))


def repeated(names: Iterable[tuple[str, Path]], root: Path) -> dict[str, list[str]]:
    """Files of each name that occurs more than once."""
    files = defaultdict(list)
    for name, path in names:
        files[name].append(str(path.relative_to(root)))
    return {name: paths for name, paths in files.items() if len(paths) > 1}


def python_names(root: Path, *suffixes: str) -> Iterator[tuple[str, Path]]:
    for folder in FOLDERS:
        for path in sorted((root / folder).rglob("*")):
            if path.suffix in suffixes:
                for name in classes_of(path.read_text(encoding="utf-8")):
                    yield name, path


def cpp_files(root: Path) -> Iterator[Path]:
    """All C++ files, without tests and benches."""
    found = sorted((root / "cpp").rglob("*.[ch]pp"))
    return (path for path in found if not {"test", "bench"} & set(path.parts))


def cpp_names(root: Path) -> Iterator[tuple[str, Path]]:
    for path in cpp_files(root):
        for name in CPP_CLASS.findall(path.read_text(encoding="utf-8")):
            yield name, path


def header_names(root: Path) -> Iterator[tuple[str, Path]]:
    """Classes of the namespaces in public headers; inner classes belong to their class's name."""
    for path in cpp_files(root):
        if "include" in path.parts:
            for name in CPP_NAMESPACE_CLASS.findall(path.read_text(encoding="utf-8")):
                yield name, path


def names_of_two_meanings(root: Path) -> dict[str, list[str]]:
    """Clashes in Python and with C++; a `.pyi` of a binding is the C++ class itself."""
    python = [*python_names(root, ".py")]
    bindings = [*python_names(root, ".pyi")]
    headers = [*header_names(root)]
    return (
        {k: v for k, v in repeated(python, root).items() if k not in SHARED}
        | {k: v for k, v in repeated(python + headers, root).items() if k not in MIRRORS | SHARED}
        | {k: v for k, v in repeated(python + bindings, root).items() if k not in MIRRORS | SHARED}
    )


def test_every_class_name_is_defined_once() -> None:
    assert len({*python_names(ROOT, ".py")}) > 500
    assert len({*python_names(ROOT, ".pyi")}) > 20
    assert len({*header_names(ROOT)}) > 50
    assert names_of_two_meanings(ROOT) == {}


def test_every_cpp_class_name_is_defined_once() -> None:
    assert repeated(cpp_names(ROOT), ROOT) == {}


def test_every_mirror_is_one() -> None:
    """An entry that is no longer needed goes."""
    headers = {name for name, _ in header_names(ROOT)}
    python = {name for name, _ in python_names(ROOT, ".py")}
    assert headers & python - SHARED == MIRRORS


def test_a_planted_second_cpp_class_is_found(tmp_path: Path) -> None:
    for folder, text in (
        ("map/src", "struct View : Base {\n};\nclass View;\n"),
        ("python", "  class View final\n    : public Base {\n};\n"),
        ("map/test", "struct View {\n};\n"),
    ):
        (tmp_path / "cpp" / folder).mkdir(parents=True)
        (tmp_path / "cpp" / folder / "a.cpp").write_text(text)
    found = repeated(cpp_names(tmp_path), tmp_path)
    assert found == {"View": ["cpp/map/src/a.cpp", "cpp/python/a.cpp"]}


def test_a_planted_second_class_is_found(tmp_path: Path) -> None:
    planted = {
        "mapperd/a.py": "class View:\n    class _Inner: ...\n",
        "tools/b.py": "def f():\n    class View: ...\n",
        "oculus_driver/c.py": "class Inner: ...\nclass Same: ...\nclass Bound: ...\n",
        "mapperd/_core.pyi": "class Bound: ...\nclass Alike: ...\n",
        "cpp/map/include/a.hpp": "struct Same {\n  struct View {};\n};\nclass Alike final {\n};\n",
    }
    for name, text in planted.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    assert names_of_two_meanings(tmp_path) == {
        "View": ["mapperd/a.py", "tools/b.py"],
        "Inner": ["mapperd/a.py", "oculus_driver/c.py"],
        "Bound": ["oculus_driver/c.py", "mapperd/_core.pyi"],
        "Same": ["oculus_driver/c.py", "cpp/map/include/a.hpp"],
    }
