"""The commands of the installation run in an empty folder; the file of the image is sound."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

from mapperd import __version__
from tests.support.machine import Machine, copy_of_this_machine
from tests.support.shell_blocks import blocks_of, follow

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "getting-started" / "install.md"
DOCKERFILE = (ROOT / "Dockerfile").read_text("utf-8")


def block_with(text: str) -> str:
    (code,) = (block.code for block in blocks_of(PAGE) if text in block.code)
    return code


def run(code: str, folder: Path) -> str:
    """Run commands with nothing of this environment but Python, the registry and the network."""
    python = Path(sys.executable).resolve().parent
    kept = {name: os.environ[name] for name in os.environ if name.startswith("PIP_")}
    environment = {
        "PATH": f"{python}:/usr/local/bin:/usr/bin:/bin",
        "HOME": str(folder),
        "REPOSITORY": str(ROOT),
        **kept,
    }
    done = subprocess.run(  # noqa: S603
        ["/bin/bash", "-euc", code],
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_the_commands_of_a_topside_pc_and_of_a_board_without_compiler_run(tmp_path: Path) -> None:
    topside, board = tmp_path / "topside", tmp_path / "board"
    topside.mkdir()
    (board / "wheels").mkdir(parents=True)
    assert f"mapperd {__version__}" in run(block_with("'.[mavlink,topside]'"), topside)
    wheel = f"cd mapperd && . venv/bin/activate && pip wheel --no-deps -w {board}/wheels ."
    run(wheel, topside)
    assert f"mapperd {__version__}" in run(block_with("wheels/mapperd-*"), board)
    check = f"cd {board} && . venv/bin/activate && python {ROOT}/scripts/check_wheel.py"
    run(check, board)


def labels() -> dict[str, str]:
    found = re.findall(
        r"""^LABEL (\w+)=(?:'((?:[^'\\]|\\\n)*)'|"([^"\n]*)")$""", DOCKERFILE, re.MULTILINE
    )
    return {name: (quoted or plain).replace("\\\n", "") for name, quoted, plain in found}


def test_the_image_has_the_labels_of_a_blueos_extension() -> None:
    found = labels()
    assert found["version"] == __version__
    permissions = json.loads(found["permissions"])["HostConfig"]
    assert permissions["NetworkMode"] == "host"
    assert permissions["Binds"] == ["/usr/blueos/extensions/mapperd:/data"]
    for name in ("authors", "company", "tags", "links"):
        json.loads(found[name])
    assert {"type", "requirements"} <= found.keys()


def test_the_image_s_file_names_what_exists_and_is_sent() -> None:
    sent = {
        line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line[:1] == "!"
    }
    project = (ROOT / "pyproject.toml").read_text("utf-8")
    built = set(re.findall(r'^    "/([\w.]+)', project, re.MULTILINE)) - {"scripts"}
    assert built <= sent
    assert all((ROOT / name).exists() for name in sent)
    for name in re.findall(r"^COPY (requirements/\S+)", DOCKERFILE, re.MULTILINE):
        assert (ROOT / name).is_file()
    (command,) = re.findall(r"^CMD (.*)$", DOCKERFILE, re.MULTILINE)
    shell, option, script = json.loads(command)
    subprocess.run([f"/bin/{shell}", "-n", option, script], check=True)  # noqa: S603


def test_images_are_built_on_machines_of_their_architecture() -> None:
    jobs = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text("utf-8"))["jobs"]
    machines = {
        one["arch"]: one["runner"] for one in jobs["image"]["strategy"]["matrix"]["include"]
    }
    assert set(machines) == {"amd64", "arm64"}
    assert machines["arm64"].endswith("-arm")


def test_a_tag_publishes_what_the_page_names() -> None:
    jobs = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text("utf-8"))["jobs"]
    page = PAGE.read_text("utf-8")
    assert f"`ghcr.io/OWNER/mapperd:v{__version__}`" in page
    image = jobs["release-image"]["steps"][0]["run"]
    assert 'name="ghcr.io/${GITHUB_REPOSITORY,,}:${GITHUB_REF_NAME}"' in image
    release = jobs["release"]
    assert release["needs"] == "wheels"
    fetch, publish = release["steps"]
    assert fetch["with"]["pattern"] == "wheels-*"
    files = f"{fetch['with']['path']}/*"
    assert f'gh release upload "$GITHUB_REF_NAME" --clobber {files}' in publish["run"]
    for arch in ("amd64", "arm64"):
        assert f"image-{arch}" in page


def test_a_push_follows_the_pages_from_a_clone() -> None:
    jobs = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text("utf-8"))["jobs"]
    pushed = [job for job in jobs.values() if job.get("if") == "github.event_name == 'push'"]
    assert any({"run": "make from-clone"} in job["steps"] for job in pushed)


def test_the_page_states_the_pythons_of_the_package() -> None:
    project = (ROOT / "pyproject.toml").read_text("utf-8")
    minors = [int(minor) for minor in re.findall(r'"cp3(\d\d)-manylinux', project)]
    assert f"3.{min(minors)} to 3.{max(minors)}" in PAGE.read_text("utf-8")
    assert f'requires-python = ">=3.{min(minors)}"' in project


def test_the_page_lists_every_extra() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    table = re.findall(r"^\| (`[^|]*`) \|", PAGE.read_text("utf-8"), re.MULTILINE)
    listed = [name for row in table for name in re.findall(r"`([\w-]+)`", row)]
    assert sorted(listed) == sorted(extras["optional-dependencies"])


@pytest.mark.slow
@pytest.mark.net
@pytest.mark.timeout(900)
def test_the_vehicle_s_libraries_are_to_be_had_for_arm64_without_a_compiler(tmp_path: Path) -> None:
    words = "install --dry-run --quiet --only-binary=:all: --implementation cp --no-deps"
    platforms = ("manylinux_2_28_aarch64", "manylinux_2_17_aarch64", "manylinux2014_aarch64")
    command = [sys.executable, "-m", "pip", *words.split(), "--target", str(tmp_path / "none")]
    command += ["--python-version", "3.12", "--require-hashes"]
    command += [word for name in platforms for word in ("--platform", name)]
    command += ["-r", str(ROOT / "requirements" / "vehicle.lock")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603
    if re.search(r"NewConnectionError|Name or service|Connection(Error| refused)", done.stderr):
        pytest.skip("no registry can be reached")
    assert done.returncode == 0, done.stderr[-2000:]


FROM_CLONE = pytest.mark.skipif(
    "MAPPERD_FROM_CLONE" not in os.environ,
    reason="installs from a clone for minutes: `make from-clone` runs it",
)


@FROM_CLONE
@pytest.mark.slow
@pytest.mark.net
@pytest.mark.timeout(7200)
def test_the_first_dive_runs_from_a_fresh_clone(tmp_path: Path) -> None:
    first_dive = PAGE.with_name("first-dive.md")
    (install,) = (block.code for block in blocks_of(first_dive) if "git clone" in block.code)
    run(install, tmp_path)
    home = tmp_path / "reader"
    home.mkdir()
    follow(first_dive, home, installed=tmp_path / "mapperd" / "venv" / "bin")


@FROM_CLONE
@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_the_service_is_installed_and_runs(tmp_path: Path) -> None:
    """With systemd as the first process of a copy of this machine."""
    install, start = (block.code for block in blocks_of(PAGE.with_name("service.md")))
    *lines, log = start.strip().splitlines()
    assert log.startswith("journalctl")
    with copy_of_this_machine(tmp_path) as machine:
        home = tmp_path / "home"
        require_packages(machine)
        done = machine.run(f"cd {home}\n{install}", REPOSITORY=str(ROOT))
        assert done.returncode == 0, done.stderr[-3000:]
        with machine.booted():
            done = machine.run("\n".join(lines))
            if done.returncode != 0:
                journal = machine.run("journalctl --no-pager --unit mapperd").stdout
                raise AssertionError(done.stdout + done.stderr + journal)
            assert re.search(r"Active: active \(running\)", done.stdout)
            followed = machine.run(f"timeout --signal=INT 10 {log} || test $? = 124")
            assert "mapperd[" in followed.stdout, followed.stdout + followed.stderr
            files = "stat --format %a /etc/mapperd/mapperd.yaml /etc/credstore/mapperd.server-token"
            assert machine.run(files).stdout.split() == ["644", "600"]
            asked = machine.run("/opt/mapperd/bin/mapperctl status --once")
            assert asked.stdout.startswith("! no sonar"), asked.stdout + asked.stderr
            assert f"\nmapperd {__version__} " in asked.stdout
            stopped = "systemctl stop mapperd && systemctl show --property=Result mapperd"
            assert machine.run(stopped).stdout == "Result=success\n"


def require_packages(machine: Machine) -> None:
    """Fetch the lists of packages where one of the page's is missing; skip without them."""
    (line,) = (line for line in block_with("apt install").splitlines() if "apt" in line)
    packages = line.partition("install ")[2]
    if machine.run(f"dpkg --status {packages}").returncode == 0:
        return
    done = machine.run(f"apt-get update && apt-get install --dry-run {packages}")
    if done.returncode != 0:
        pytest.skip(f"apt cannot install {packages}: {done.stderr[-300:]}")


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_packages_of_the_pages_are_installed(tmp_path: Path) -> None:
    if shutil.which("apt") is None:
        pytest.skip("apt exists only on Debian and its descendants")
    code = block_with("apt install")
    assert code in PAGE.with_name("service.md").read_text("utf-8")
    with copy_of_this_machine(tmp_path) as machine:
        require_packages(machine)
        done = machine.run(code)
        assert done.returncode == 0, done.stderr
        tools = "git --version; g++ --version; make --version; python3-config --includes"
        done = machine.run(f"{tools}; python3 -c 'import venv, ensurepip'")
        assert done.returncode == 0, done.stderr


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_driver_is_installed_without_mapperd(tmp_path: Path) -> None:
    page = PAGE.parents[1] / "guides" / "driver.md"
    (code,) = (block.code for block in blocks_of(page) if "pip install" in block.code)
    clone = 'git clone "$REPOSITORY" mapperd && cd mapperd && python3 -m venv ../venv'
    check = "oculus --version; python -c 'import cv2'; ! python -I -c 'import mapperd' 2>/dev/null"
    done = run(f"{clone} && . ../venv/bin/activate\n{code}\ncd ..; {check}", tmp_path)
    assert f"oculus {__version__}" in done


def docker(words: str) -> int:
    """Run docker; return its exit code."""
    return subprocess.run(["docker", *words.split()], capture_output=True, check=False).returncode  # noqa: S603, S607


@pytest.mark.slow
@pytest.mark.net
@pytest.mark.timeout(7200)
def test_the_image_is_built_and_answers(tmp_path: Path) -> None:
    if shutil.which("docker") is None or docker("info") != 0:
        pytest.skip("Docker is not installed, or its daemon does not answer")
    if docker("container inspect mapperd") == 0 or Path("/var/lib/mapperd").exists():
        pytest.skip("this machine has a container `mapperd`, or the folder of one")
    *lines, status = block_with("docker build").strip().splitlines()
    code = shlex.quote("set -eu\n" + "\n".join(lines))
    terminal = f"printf '%20s' | tr ' ' '\\n' | script --quiet --return --command {code} typescript"
    try:
        assert "wrote /data" in run(terminal, tmp_path)
        assert "mapperd" in run(
            f"for i in $(seq 20); do sleep 5; {status} && break; done", tmp_path
        )
    finally:
        docker("rm --force mapperd")
        docker("run --rm --volume /var/lib:/host mapperd rm -rf /host/mapperd")
