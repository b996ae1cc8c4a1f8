"""The driver is installed alone: no compiler, no mapperd, its command works."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

if TYPE_CHECKING:
    from collections.abc import Callable

ROOT = Path(__file__).resolve().parents[2]
PROJECT = ROOT / "oculus_driver"

PROGRAM = """
import importlib.util, pkgutil
import oculus_driver, oculus_driver.recording
assert importlib.util.find_spec("mapperd") is None
for module in pkgutil.walk_packages(oculus_driver.__path__, "oculus_driver."):
    if ".render" not in module.name and "__main__" not in module.name:  # OpenCV is an extra
        importlib.import_module(module.name)
for name in oculus_driver.__all__:
    getattr(oculus_driver, name)
print(oculus_driver.__file__)
"""


def run(*command: str | Path, cwd: Path) -> str:
    """Run a command outside of the checkout and of this environment's settings."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(  # noqa: S603 - our own words
        [str(word) for word in command],
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def modules_of(packages: Path, *names: str) -> None:
    """Make modules of this environment available in another one, without the network."""
    site = Path(np.__file__).resolve().parents[1]
    for name in names:
        if (site / name).exists():
            (packages / name).symlink_to(site / name)


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fresh virtual environment with the driver's wheel and numpy, and nothing else."""
    for name in ("hatchling", "pip"):
        if importlib.util.find_spec(name) is None:
            pytest.skip(f"the build of a wheel without the network needs {name} here")
    folder = tmp_path_factory.mktemp("standalone")
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check")
    build = ("--no-build-isolation", "--no-deps", "--no-index", "--wheel-dir", folder, PROJECT)
    run(*pip, "wheel", *build, cwd=folder)
    (wheel,) = folder.glob("*.whl")
    assert wheel.name.endswith("-py3-none-any.whl")  # pure Python
    run(sys.executable, "-m", "venv", "--without-pip", folder / "venv", cwd=folder)
    python = folder / "venv" / "bin" / "python"
    run(*pip, "--python", python, "install", "--no-deps", "--no-index", wheel, cwd=folder)
    (packages,) = (folder / "venv" / "lib").glob("python*/site-packages")
    modules_of(packages, "numpy", "numpy.libs")
    return folder / "venv" / "bin"


@pytest.mark.slow
def test_it_is_imported_without_mapperd(installed: Path, tmp_path: Path) -> None:
    where = run(installed / "python", "-c", PROGRAM, cwd=tmp_path)
    assert Path(where.strip()).is_relative_to(installed.parent)


@pytest.mark.slow
def test_its_command_helps_and_reads_a_recording(
    installed: Path, tmp_path: Path, make_ping: Callable[..., bytes]
) -> None:
    assert "discover" in run(installed / "oculus", "--help", cwd=tmp_path)
    (tmp_path / "dive.raw").write_bytes(make_ping(ping_id=7) * 2)
    assert "valid pings: 2" in run(installed / "oculus", "info", "dive.raw", cwd=tmp_path)


def test_its_version_is_that_of_mapperd() -> None:
    ours, mapperd = (
        tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        for folder in (PROJECT, ROOT)
    )
    assert ours["version"] == mapperd["version"]
    assert ours["license"] == mapperd["license"]
    assert set(ours["dependencies"]) <= set(mapperd["dependencies"])
