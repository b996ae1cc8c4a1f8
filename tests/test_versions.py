"""One version everywhere, and every command prints it."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import sonar_sim
import yaml

import mapperd
import oculus_driver
from oculus_driver.command_line import ExitCode

ROOT = Path(__file__).resolve().parents[1]
COMMANDS = {
    "mapperd": "mapperd.cli.mapperd",
    "mapperctl": "mapperd.cli.mapperctl.command",
    "oculus": "oculus_driver.cli",
    "sonar-sim": "sonar_sim.command",
    "mapper-survey": "mapper_survey",
}


def project_version(path: str) -> str:
    with (ROOT / path).open("rb") as file:
        return str(tomllib.load(file)["project"]["version"])


def cmake_version() -> str:
    text = (ROOT / "cpp" / "CMakeLists.txt").read_text(encoding="utf-8")
    found = re.search(r"project\(mapperd VERSION (\S+)", text)
    assert found is not None
    return found.group(1)


def test_all_files_state_one_version() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert {
        project_version("pyproject.toml"),
        project_version("oculus_driver/pyproject.toml"),
        cmake_version(),
        citation["version"],
        oculus_driver.__version__,
        sonar_sim.__version__,
    } == {mapperd.__version__}


def test_changelog_begins_with_this_version() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    found = re.search(r"^## (\S+)", text, re.MULTILINE)
    assert found is not None
    assert found.group(1) == mapperd.__version__


@pytest.mark.parametrize("command", sorted(COMMANDS))
@pytest.mark.slow
def test_command_prints_its_version(command: str) -> None:
    code = f"import sys; from {COMMANDS[command]} import main; sys.exit(main(['--version']))"
    done = subprocess.run(  # noqa: S603 our own line
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout == f"{command} {mapperd.__version__}\n"


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("mapperd", []),
        ("mapperd", ["init"]),
        ("mapperd", ["doctor"]),
        ("mapperd", ["calibrate"]),
        ("mapperctl", []),
        ("mapperctl", ["view"]),
        ("mapperctl", ["bag"]),
        ("mapperctl", ["convert"]),
        ("mapperctl", ["changes"]),
        ("mapperctl", ["mavlink"]),
        ("mapperctl", ["ros2"]),
        ("oculus", []),
        ("oculus", ["render"]),
    ],
)
def test_help_needs_no_extra(command: str, words: list[str]) -> None:
    extras = "aiomqtt cv2 cyclonedds embreex foxglove laspy matplotlib msgpack PIL pymavlink"
    extras += " pynmea2 rosbags scipy serial shtab tifffile tqdm trimesh viser"
    code = (
        "import sys\n"
        f"for name in {extras.split()}:\n"
        "    sys.modules[name] = None\n"
        f"from {COMMANDS[command]} import main\n"
        f"sys.exit(main({[*words, '--help']}))\n"
    )
    done = subprocess.run(  # noqa: S603 our own lines
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (ExitCode.OK, "")
    assert done.stdout.startswith(f"usage: {' '.join([command, *words])}")


def without_extras(command: str, words: list[str]) -> subprocess.CompletedProcess[str]:
    """Run a command where the libraries of its extra are missing."""
    code = (
        "import sys\n"
        "for name in ('dask', 'embreex', 'fsspec', 'matplotlib', 'scipy', 'trimesh'):\n"
        "    sys.modules[name] = None\n"
        f"from {COMMANDS[command]} import main\n"
        f"sys.exit(main({words}))\n"
    )
    return subprocess.run(  # noqa: S603 our own lines
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize("command", ["sonar-sim", "mapper-survey"])
@pytest.mark.parametrize("option", ["--help", "--version"])
def test_help_and_version_need_no_extra(command: str, option: str) -> None:
    done = without_extras(command, [option])
    assert (done.returncode, done.stderr) == (ExitCode.OK, "")
    assert command in done.stdout


@pytest.mark.parametrize(
    ("command", "words"),
    [("sonar-sim", ["serve", "tank"]), ("mapper-survey", ["plan", "survey.yaml", "--out", "out"])],
)
def test_command_of_a_missing_extra_ends_in_one_line(
    command: str, words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "survey.yaml").write_text("dives: [{name: one, recording: dive.mcap}]\n")
    (tmp_path / "dive.mcap").touch()
    done = without_extras(command, words)
    assert done.returncode == ExitCode.BAD_CONFIG
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert "the extra `" in line
