"""The C++ libraries as another program uses them: installed, found by CMake, linked."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
BUILD = ROOT / "build" / "release"


def run(*command: str | Path) -> str:
    ended = subprocess.run(  # noqa: S603 our own commands
        command, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


@pytest.mark.slow
def test_a_program_links_the_installed_libraries(tmp_path: Path) -> None:
    cmake = Path(sys.executable).parent / "cmake"
    if not (BUILD / "cmake_install.cmake").exists():
        pytest.skip("build/release is missing: `make install` builds it")
    run(cmake, "--install", BUILD, "--component", "cpp", "--prefix", tmp_path / "usr")
    example, build = ROOT / "examples" / "cpp", tmp_path / "build"
    run(cmake, "-S", example, "-B", build, f"-DCMAKE_PREFIX_PATH={tmp_path / 'usr'}")
    run(cmake, "--build", build)
    lines = run(build / "integrate_ping").splitlines()
    assert lines[:3] == ["4 m ahead: occupied", "2 m ahead: free", "5 m ahead: unknown"]
    assert lines[3].endswith("the wall is 2.00 m ahead of the second point")
