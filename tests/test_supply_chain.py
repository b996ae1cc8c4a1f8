"""What is installed: bounds of versions, locked hashes, and the files of the source package."""

import os
import re
import subprocess
import sys
import tarfile
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
LOCKS = ROOT / "requirements"
VEHICLE_EXTRAS = ("filters", "mavlink", "mqtt", "nmea", "serial")
BY_DATE = {"dask", "distributed", "fsspec", "s3fs", "tifffile"}
"""Versions are dates: no number announces a break."""

ENTRY = re.compile(
    r"^(?P<spec>[^\s#].*?) \\\n(?P<hashes>(?: {4}--hash=.*\n)+)(?P<via>(?: {4}#.*\n)*)",
    re.MULTILINE,
)
HASH = re.compile(r"--hash=sha256:[0-9a-f]{64}")


def project(path: str = "pyproject.toml") -> dict[str, Any]:
    return tomllib.loads((ROOT / path).read_text(encoding="utf-8"))


def requirements_of(path: str) -> list[Requirement]:
    """Every requirement of a project: to build it, to run it, and of its extras."""
    data = project(path)
    extras = data["project"]["optional-dependencies"].values()
    groups = [data["build-system"]["requires"], data["project"]["dependencies"], *extras]
    return [Requirement(text) for group in groups for text in group]


def locked(name: str) -> list[tuple[Requirement, list[str], set[str]]]:
    """Entries of a lock file: requirement, hashes, and what requires it."""
    text = (LOCKS / name).read_text(encoding="utf-8")
    found = []
    for entry in ENTRY.finditer(text):
        via = re.sub(r"#( via)?", "", entry["via"]).replace("(pyproject.toml)", "").split()
        hashes = [line.strip(" \\") for line in entry["hashes"].splitlines()]
        found.append((Requirement(entry["spec"]), hashes, set(via)))
    rest = [line for line in ENTRY.sub("", text).splitlines() if not line.startswith("#")]
    assert rest == [], "lines that are no entry"
    return found


@pytest.mark.parametrize("path", ["pyproject.toml", "oculus_driver/pyproject.toml"])
def test_next_major_version_of_a_requirement_is_excluded(path: str) -> None:
    for requirement in requirements_of(path):
        operators = {specifier.operator for specifier in requirement.specifier}
        bounded = operators in ({"=="}, {">=", "<"})
        assert bounded or requirement.name in BY_DATE, str(requirement)


def test_a_library_has_the_same_bounds_everywhere() -> None:
    seen: dict[str, str] = {}
    for path in ("pyproject.toml", "oculus_driver/pyproject.toml"):
        for requirement in requirements_of(path):
            bounds = str(requirement.specifier)
            assert seen.setdefault(requirement.name, bounds) == bounds, requirement.name


def test_vehicle_lock_holds_exactly_what_a_vehicle_needs() -> None:
    data = project()["project"]
    groups = [data["optional-dependencies"][extra] for extra in VEHICLE_EXTRAS]
    wanted = {
        canonicalize_name(requirement.name): requirement.specifier
        for group in (data["dependencies"], *groups)
        for requirement in map(Requirement, group)
    }
    entries = locked("vehicle.lock")
    names = {canonicalize_name(requirement.name) for requirement, _, _ in entries}
    direct = {canonicalize_name(entry.name) for entry, _, via in entries if "mapperd" in via}
    assert direct == set(wanted)
    for entry, _, via in entries:
        (pin,) = entry.specifier
        assert pin.operator == "=="
        bounds = wanted.get(canonicalize_name(entry.name))
        assert bounds is None or pin.version in bounds, str(entry)
        assert via
        assert via <= names | {"mapperd"}, f"nothing locked requires {entry}"


def test_build_lock_holds_what_the_build_needs() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    (line,) = re.findall(r"^BUILD_TOOLS := (.*)$", makefile, re.MULTILINE)
    tools = {(one := Requirement(text.strip("'"))).name: one for text in line.split()}
    for text in project()["build-system"]["requires"]:
        assert tools[Requirement(text).name] == Requirement(text)
    entries = locked("build.lock")
    direct = {entry.name for entry, _, via in entries if not via}
    assert direct == set(tools)
    for entry, _, _ in entries:
        (pin,) = entry.specifier
        assert entry.name not in tools or pin.version in tools[entry.name].specifier


@pytest.mark.parametrize("name", ["build.lock", "vehicle.lock"])
def test_lock_has_hashes_and_names_no_host(name: str) -> None:
    entries = locked(name)
    assert entries
    for entry, hashes, _ in entries:
        assert hashes
        assert all(HASH.fullmatch(one) for one in hashes), str(entry)
    text = (LOCKS / name).read_text(encoding="utf-8")
    assert not re.search(r"://|--(?:extra-)?index|--find-links|@ ", text)


@pytest.mark.parametrize("name", ["build.lock", "vehicle.lock"])
def test_every_supported_python_gets_one_version(name: str) -> None:
    for minor in ("3.11", "3.12", "3.13", "3.14"):
        where = {"python_full_version": f"{minor}.0", "python_version": minor}
        chosen = [
            entry.name
            for entry, _, _ in locked(name)
            if entry.marker is None or entry.marker.evaluate(where)
        ]
        assert len(chosen) == len(set(chosen)) == len({entry.name for entry, _, _ in locked(name)})


SDIST_PATHS = (
    *("CHANGELOG.md", "LICENSE", "PKG-INFO", "README.md", "pyproject.toml"),
    *("config/", "cpp/", "mapperd/", "oculus_driver/", "requirements/", "scripts/check_wheel.py"),
    *("systemd/", "tools/mapper_survey/", "tools/sonar_sim/"),
)


def test_wheels_are_built_on_machines_of_their_architecture() -> None:
    text = (ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8")
    wheels = yaml.safe_load(text)["jobs"]["wheels"]
    machines = {one["arch"]: one["runner"] for one in wheels["strategy"]["matrix"]["include"]}
    assert set(machines) == {"x86_64", "aarch64"}
    assert machines["aarch64"].endswith("-arm")
    assert {"run": "make wheels"} in wheels["steps"]
    options = project()["tool"]["cibuildwheel"]
    assert options["archs"] == ["auto64"]
    assert all(re.fullmatch(r"cp3\d\d-manylinux_\*", name) for name in options["build"])
    commands = " ".join(options[name] for name in ("before-build", "before-test", "test-command"))
    needed = re.findall(r"\{project\}/(\S+)", commands)
    assert len(needed) == 3
    for name in needed:
        assert (ROOT / name).is_file()
        assert name.startswith(SDIST_PATHS), "wheels are built from the source package"


@pytest.mark.slow
def test_check_of_a_wheel_maps_a_ping(tmp_path: Path) -> None:
    done = subprocess.run(  # noqa: S603 our own program
        [sys.executable, str(ROOT / "scripts" / "check_wheel.py")],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        timeout=100,
    )
    assert done.returncode == 0, done.stderr
    assert "one ping mapped" in done.stdout


def copied(files: list[str], folder: Path) -> Path:
    """Copy tracked files, in this order."""
    for name in files:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes((ROOT / name).read_bytes())
        path.chmod((ROOT / name).stat().st_mode)
    return folder


def built(folder: Path) -> tuple[bytes, set[str]]:
    """Build the source package of a folder: its bytes, and the names of its files."""
    script = "from scikit_build_core.build import build_sdist as b; b('dist')"
    subprocess.run(  # noqa: S603 our own line
        [sys.executable, "-c", script],
        cwd=folder,
        env=os.environ | {"SOURCE_DATE_EPOCH": "1700000000"},
        capture_output=True,
        check=True,
        timeout=200,
    )
    (path,) = (folder / "dist").glob("mapperd-*.tar.gz")
    with tarfile.open(path) as archive:
        members = archive.getmembers()
    assert {member.mtime for member in members} == {1_700_000_000}
    assert all(member.isfile() for member in members)
    return path.read_bytes(), {member.name.partition("/")[2] for member in members}


@pytest.mark.slow
def test_source_package_is_reproducible_and_holds_sources_alone(tmp_path: Path) -> None:
    pytest.importorskip("scikit_build_core")
    listed = subprocess.run(
        ["git", "ls-files", "-z"],  # noqa: S607
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    if listed.returncode:
        pytest.skip("no Git checkout")
    files = [name for name in listed.stdout.split("\0") if name and (ROOT / name).is_file()]
    clean = copied(files, tmp_path / "clean")
    used = copied(files[::-1], tmp_path / "used")
    for name in (
        *("build/a.o", "out/map.bt", "tests/data/dive.mcap", ".hypothesis/a", ".venv/a.py"),
        *("mapperd/_core.so", "mapperd/__pycache__/api.pyc", "cpp/map/test/data.bin", "dive.mcap"),
    ):
        (used / name).parent.mkdir(parents=True, exist_ok=True)
        (used / name).write_bytes(b"x")
    for name in files:
        os.utime(used / name, (1.0, 1.0))
        (used / name).chmod((used / name).stat().st_mode & 0o700)  # another umask

    archive, names = built(clean)
    assert built(used)[0] == archive
    assert names - {"PKG-INFO"} <= set(files)
    assert [name for name in sorted(names) if not name.startswith(SDIST_PATHS)] == []
    assert not [name for name in names if "test" in name.split("/")]
    packages = ("mapperd/", "oculus_driver/", "tools/mapper_survey/", "tools/sonar_sim/")
    assert {name for name in files if name.startswith(packages)} <= names
    assert {"cpp/CMakeLists.txt", "cpp/map/CMakeLists.txt"} <= names
