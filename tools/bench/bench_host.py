"""The host of a run: building the rivals on it, and what a reader must know of it."""

import os
import platform
import subprocess
import sys
import sysconfig
import time
from pathlib import Path

import msgspec
from contenders import BENCH
from measured import run_json
from results import Machine

PACKAGES = {
    "octomap_rival": "OctoMap (pip install 'mapperd[octomap]')",
    "openvdb_rival": "OpenVDB (apt install libopenvdb-dev libboost-dev)",
}
BEGAN_S = time.perf_counter()


def build_rivals(out: Path) -> Path:
    """Build the programs in C++; returns their folder."""
    say("building the rivals")
    build = out / "build"
    octomap = Path(sysconfig.get_path("purelib")) / "cmeel.prefix"  # where the wheel keeps it
    tools = Path(sys.executable).parent
    environment = os.environ | {"PATH": f"{tools}{os.pathsep}{os.environ['PATH']}"}
    configure = f"cmake -G Ninja -S {BENCH / 'rivals'} -B {build} -DCMAKE_BUILD_TYPE=Release"
    build_all = f"cmake --build {build} -- -k 0"  # one that does not build spares the others
    with (out / "build.log").open("wb") as log:
        for words in ([*configure.split(), f"-DCMAKE_PREFIX_PATH={octomap}"], build_all.split()):
            done = subprocess.run(words, env=environment, check=False, stdout=log, stderr=log)  # noqa: S603
            if done.returncode != 0:
                say(f"not everything builds: {out / 'build.log'}")
    for program, package in PACKAGES.items():
        if not (build / program).exists():
            say(f"left out: {package} is not installed")
    return build


def describe_machine(build: Path, load_before: float) -> Machine:
    """What the reader must know to compare, and the memory's bandwidth."""
    say("measuring the memory's bandwidth")
    bandwidth = msgspec.json.decode(run_json([build / "bandwidth"]))
    cpuinfo = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    models = [line.partition(":")[2].strip() for line in cpuinfo if line.startswith("model name")]
    compiler = _first_line(["c++", "--version"])
    commit = _first_line(["git", "-C", str(BENCH), "describe", "--always", "--dirty"])
    return Machine(
        cpu=models[0] if models else platform.machine(),
        cores=os.cpu_count() or 1,
        compiler=compiler,
        commit=commit,
        load=load_before,
        bytes_a_second=bandwidth["bytes_per_s"],
    )


def say(line: str) -> None:
    """Progress, with the seconds since the start."""
    print(f"[{time.perf_counter() - BEGAN_S:5.0f} s] {line}", file=sys.stderr, flush=True)


def _first_line(command: list[str]) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=True)  # noqa: S603
    return done.stdout.partition("\n")[0]
