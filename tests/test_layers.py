"""Arrows between the rooms point one way; an import that points back fails here.

tools -> mapperd -> oculus_driver; mapperd -> mapperd._core; sonar_sim -> oculus_driver only.
In C++ map, localization and acoustics include common, and nothing of each other.
Inside mapperd every module imports only modules that stand above it in `tests.layer_order`.
"""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.layer_order import ORDER

ROOT = Path(__file__).resolve().parents[1]

MAY_IMPORT = {
    "oculus_driver": {"oculus_driver"},
    "mapperd": {"mapperd", "oculus_driver"},
    "sonar_sim": {"sonar_sim", "oculus_driver"},
    "tools": {"tools", "survey", "sonar_sim", "mapperd", "oculus_driver"},
}
OUR_ROOMS = {"oculus_driver", "mapperd", "sonar_sim", "survey", "tools", "tests"}

DASK = {"dask", "distributed"}
MAY_IMPORT_DASK = re.compile(r"tools/survey/engine\w*\.py")
"""The one place that knows of the engine of surveys."""


def room_of(path: Path, root: Path) -> str:
    """The room a file belongs to: its package, or `tools` for a program of its own."""
    parts = path.relative_to(root).parts
    if parts[0] != "tools":
        return parts[0]
    return "sonar_sim" if parts[1] == "sonar_sim" else "tools"


def module_of(path: Path, room: str, root: Path) -> str:
    """`mapperd/odometry/native.py` is `mapperd.odometry.native`."""
    base = root / "tools" if room == "sonar_sim" else root
    parts = path.relative_to(base).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports_of(path: Path, module: str) -> Iterator[str]:
    """Every module or name that a file imports, wherever in it the import stands."""
    is_package = path.name == "__init__.py"
    for node in ast.walk(ast.parse(path.read_bytes(), str(path))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = module.split(".")
                above = above[: len(above) - node.level + is_package]
                base = ".".join([*above, base]).rstrip(".")
            yield from (f"{base}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Call) and _imports_by_name(node):
            argument = node.args[0]
            assert isinstance(argument, ast.Constant), f"{path}:{node.lineno}: import of a variable"
            yield str(argument.value)


def _imports_by_name(call: ast.Call) -> bool:
    name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    return name in ("import_module", "__import__") and bool(call.args)


def place_of(name: str) -> int | None:
    """Place in ORDER of an imported name such as `mapperd.odometry.native.decode_native`."""
    parts = name.split(".")[1:]
    for length in range(len(parts), 0, -1):
        inner = ".".join(parts[:length])
        if inner in ORDER:
            return ORDER.index(inner)
    return None


def back_arrows(root: Path) -> list[str]:
    """Every import under `root` that points the wrong way."""
    wrong = []
    for folder in ("oculus_driver", "mapperd", "tools"):
        for path in sorted((root / folder).rglob("*.py")):
            room = room_of(path, root)
            module = module_of(path, room, root)
            if module == "mapperd":  # offers names of modules that it imports when asked
                continue
            wrong += [
                f"{path.relative_to(root)} imports {name}"
                for name in imports_of(path, module)
                if points_back(room, module, name)
            ]
    return wrong


def points_back(room: str, module: str, name: str) -> bool:
    target = name.partition(".")[0]
    if target in OUR_ROOMS and target not in MAY_IMPORT[room]:
        return True
    if target != "mapperd":
        return False
    if room != "mapperd":  # the core is reached through mapperd.mapping.sonar_map
        return name.startswith("mapperd._core")
    here, there = place_of(module), place_of(name)
    return here is None or there is None or there >= here  # also: a package imports nothing


def dask_elsewhere(root: Path) -> list[str]:
    """Every import of Dask in a room of the daemon, or outside of its one place in the tools."""
    return [
        f"{path.relative_to(root)} imports {name}"
        for folder in ("oculus_driver", "mapperd", "tools")
        for path in sorted((root / folder).rglob("*.py"))
        if not MAY_IMPORT_DASK.fullmatch(path.relative_to(root).as_posix())
        if (module := module_of(path, room_of(path, root), root)) != "mapperd"
        for name in imports_of(path, module)
        if name.partition(".")[0] in DASK
    ]


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


def test_no_import_points_back() -> None:
    assert back_arrows(ROOT) == []


def test_every_module_of_mapperd_has_its_place() -> None:
    modules = {
        module_of(path, "mapperd", ROOT).removeprefix("mapperd").removeprefix(".")
        for path in (ROOT / "mapperd").rglob("*.py")
        if path.name != "__init__.py"
    }
    assert modules == set(ORDER) - {"_core", "client"}
    assert len(ORDER) == len(set(ORDER)), "a place each"


def test_importing_the_package_imports_nothing_else() -> None:
    code = (
        "import sys, mapperd; "
        "print([m for m in sys.modules if m.startswith(('mapperd.', 'oculus_driver', 'numpy.'))])"
    )
    done = subprocess.run(  # noqa: S603 our own line
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_dask_has_one_place() -> None:
    assert dask_elsewhere(ROOT) == []


@pytest.mark.parametrize(
    ("file", "found"),
    [
        ("mapperd/session/replay.py", True),
        ("tools/survey/running.py", True),
        ("tools/survey/deep/engine_dask.py", True),
        ("tools/survey/engine_dask.py", False),
    ],
)
def test_planted_dask_is_found(tmp_path: Path, file: str, *, found: bool) -> None:
    path = tmp_path / file
    path.parent.mkdir(parents=True)
    path.write_text("def f():\n    from distributed import Client\n", encoding="utf-8")
    assert bool(dask_elsewhere(tmp_path)) == found


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


@pytest.mark.parametrize(
    ("file", "line"),
    [
        ("oculus_driver/ping.py", "import mapperd"),
        ("oculus_driver/ping.py", "from mapperd.config.tree import Config"),
        ("oculus_driver/deep/inside.py", "def f():\n    from mapperd import _core"),
        ("oculus_driver/ping.py", "import sonar_sim.scene"),
        ("oculus_driver/ping.py", "import importlib\nimportlib.import_module('mapperd')"),
        ("oculus_driver/ping.py", "if TYPE_CHECKING:\n    import mapperd.geometry.frames"),
        ("tools/sonar_sim/scene.py", "from mapperd.geometry.frames import Pose"),
        ("tools/sonar_sim/scene.py", "from mapperd import _core"),
        ("tools/demo.py", "import mapperd._core"),
        ("tools/bench/run.py", "from mapperd import _core"),
        ("mapperd/geometry/frames.py", "import sonar_sim"),
        ("mapperd/geometry/frames.py", "import tools.demo"),
        ("mapperd/session/replay.py", "import survey.running"),
        ("tools/sonar_sim/scene.py", "from survey.request import Survey"),
        ("mapperd/geometry/frames.py", "from mapperd import cli"),
        ("mapperd/geometry/frames.py", "from mapperd.mapping.sonar_map import SonarMap"),
        ("mapperd/mapping/sonar_map.py", "from mapperd.pipeline.step import process_ping"),
        ("mapperd/odometry/native.py", "from mapperd.odometry.fusion import Fusion"),
        ("mapperd/odometry/native.py", "from . import buffer"),
        ("mapperd/odometry/native.py", "from ..mapping import SonarMap"),
        ("mapperd/odometry/__init__.py", "from mapperd.odometry.fusion import Fusion"),
        ("mapperd/pipeline/step.py", "import mapperd.session.replay"),
        ("mapperd/unheard_of.py", "import mapperd.errors"),
    ],
)
def test_planted_back_arrow_is_found(tmp_path: Path, file: str, line: str) -> None:
    path = tmp_path / file
    path.parent.mkdir(parents=True)
    path.write_text(line + "\n", encoding="utf-8")
    assert back_arrows(tmp_path)


@pytest.mark.parametrize(
    ("file", "line"),
    [
        ("oculus_driver/ping.py", "import numpy\nfrom oculus_driver.wire import X"),
        ("oculus_driver/deep/inside.py", "from ..wire import X"),
        (
            "mapperd/mapping/sonar_map.py",
            "from mapperd import _core\nfrom mapperd.geometry.frames import Pose",
        ),
        ("mapperd/cli/mapperd.py", "import mapperd.session.replay\nimport oculus_driver.ping"),
        (
            "tools/sonar_sim/scene.py",
            "from oculus_driver import encode_ping\nimport sonar_sim.path",
        ),
        ("tools/demo.py", "import mapperd.cli.mapperd\nimport sonar_sim"),
    ],
)
def test_forward_arrow_is_left_alone(tmp_path: Path, file: str, line: str) -> None:
    path = tmp_path / file
    path.parent.mkdir(parents=True)
    path.write_text(line + "\n", encoding="utf-8")
    assert back_arrows(tmp_path) == []


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
