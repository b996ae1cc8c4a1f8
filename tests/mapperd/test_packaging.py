"""What the package asks for when it is installed."""

import ast
import os
import re
import shlex
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import pytest

from mapperd.errors import missing_extra

ROOT = Path(__file__).resolve().parents[2]
IMPORT_NAMES = {"pyyaml": "yaml"}

OLD = """
case "$1$2" in
  --version) echo Python 3.9.1 ;;
  -c) ;;
  *) exit 1 ;;
esac
"""


def imported(folder: Path) -> set[str]:
    """First names of all modules that the files of a folder import, in code or by name."""
    names: set[str] = set()
    for path in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_bytes())):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                names.add(node.module or "")
            elif isinstance(node, ast.Call) and getattr(node.func, "id", "") == "import_module":
                names |= {str(a.value) for a in node.args if isinstance(a, ast.Constant)}
    return {name.partition(".")[0] for name in names}


def required(words: list[str]) -> set[str]:
    names = (re.split(r"[^a-z0-9_-]", word)[0] for word in words)
    return {IMPORT_NAMES.get(name, name) for name in names}


@pytest.mark.slow
def test_vehicle_gets_what_it_imports_and_nothing_else() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    used = imported(ROOT / "mapperd") | imported(ROOT / "oculus_driver")
    assert required(project["dependencies"]) <= used
    assert "msgpack" in required(project["optional-dependencies"]["sim"])


def test_opencv_is_the_headless_contrib_distribution() -> None:
    for path in ("pyproject.toml", "oculus_driver/pyproject.toml", "requirements/vehicle.lock"):
        found = set(re.findall(r"opencv-[a-z-]+", (ROOT / path).read_text(encoding="utf-8")))
        assert found == {"opencv-contrib-python-headless"}, path


@pytest.mark.slow
def test_wheel_holds_four_import_names_and_their_commands() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    packages = project["tool"]["scikit-build"]["wheel"]["packages"]
    assert set(packages) == {"mapperd", "oculus_driver", "sonar_sim", "mapper_survey"}
    commands = project["project"]["scripts"].values()
    assert {re.split("[.:]", command)[0] for command in commands} == set(packages)
    checkout_only = {path.name for path in (ROOT / "tools").iterdir()} - set(packages)
    assert {"bench", "studies"} <= checkout_only
    for folder in packages.values():
        assert not imported(ROOT / folder) & checkout_only


def test_missing_extra_is_installed_with_its_libraries(monkeypatch: pytest.MonkeyPatch) -> None:
    wheel = ["lz4>=4", "aiomqtt<3,>=2.5; extra == 'mqtt'", 'laspy[lazrs]>=2; extra == "las"']
    monkeypatch.setattr(metadata, "requires", lambda _: wheel)
    hint, _, command = missing_extra("aiomqtt", "mqtt").partition("`mqtt`: ")
    assert hint == "aiomqtt cannot be imported; to install the extra "
    assert shlex.split(command) == [sys.executable, "-m", "pip", "install", "aiomqtt<3,>=2.5"]
    assert missing_extra("laspy", "las").endswith("-m pip install 'laspy[lazrs]>=2'")
    monkeypatch.setattr(metadata, "requires", lambda _: None)
    assert missing_extra("aiomqtt", "mqtt").endswith("-m pip install '.[mqtt]'")


def test_named_extras_exist() -> None:
    text = "".join(
        path.read_text(encoding="utf-8")
        for folder in ("mapperd", "tools")
        for path in (ROOT / folder).rglob("*.py")
    )
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    argument = r"(?:[^()]|\([^()]*\))*"
    found = set(re.findall(rf"""missing_extra\({argument}, ["'](\w+)["']\)""", text))
    assert {"filters", "foxglove", "geo", "las", "mqtt", "ros", "serial", "topside"} <= found
    assert {"sim", "survey"} <= found
    assert "install the extra" not in text
    assert found <= set(project["optional-dependencies"])


def test_no_text_installs_a_name_that_is_not_published() -> None:
    listed = subprocess.run(
        ["git", "grep", "-IlE", "pip install ['\"]?mapperd"],  # noqa: S607
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    if listed.returncode > 1:
        pytest.skip("no Git checkout")
    assert listed.stdout == ""


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("exit 127", "cannot be run"),
        ('[ "$1" = --version ] && echo Python 3.12.0', "cannot be run"),
        (OLD, "Python 3.9.1 is too old"),
    ],
    ids=["shim", "half a shim", "old"],
)
def test_python_that_will_not_do_is_reported_why(tmp_path: Path, body: str, words: str) -> None:
    shim = tmp_path / "python3"
    shim.write_text(f"#!/bin/sh\n{body}\n", encoding="utf-8")
    shim.chmod(0o755)
    done = subprocess.run(  # noqa: S603 our own script
        [str(ROOT / "scripts" / "prerequisites")],
        env=os.environ | {"PYTHON": str(shim)},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 1
    assert words in done.stderr
