"""The contenders, and the command that runs each."""

import os
import subprocess
import sys
import sysconfig
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
from studies.report import cpu_model

from bench.results import Machine

BENCH = Path(__file__).resolve().parent


@dataclass(frozen=True, slots=True)
class PingCase:
    """One look, range and voxel size, and the files that hold its pings.

    Attributes:
        loud_share: share of the pixels above the map's intensity threshold.
    """

    look: str
    range_m: float
    resolution_m: float
    pings_file: Path
    rays_file: Path
    loud_share: float

    @property
    def name(self) -> str:
        """For people."""
        return f"looking {self.look}, {self.range_m:g} m, {100 * self.resolution_m:g} cm"


@dataclass(frozen=True, slots=True)
class Contender:
    """A map and an integrator.

    Attributes:
        name: unique.
        map_name: of the map and its integrator.
        takes: what it is given of a ping.
        threads: that it may use.
        words: what distinguishes its command.
    """

    name: str
    map_name: str
    takes: str
    threads: int
    words: tuple[str, ...]

    @property
    def label(self) -> str:
        """For people; all rivals take the same input."""
        takes = f", {self.takes}" if self.is_ours else ""
        threads = f", {self.threads} threads" if self.threads > 1 else ""
        return f"{self.map_name}{takes}{threads}"

    @property
    def is_ours(self) -> bool:
        """Whether it is a map of this project."""
        return self.takes != RAYS

    def command(self, case: PingCase, build: Path, budget_s: float) -> list[str | Path]:
        """To run it on a case in a process of its own."""
        given = (f"{case.resolution_m}", f"{budget_s}")
        if not self.is_ours:
            program, *way = self.words
            return [build / program, case.rays_file, *given, *way]
        return [sys.executable, "-m", "bench.our_contender", case.pings_file, *given, *self.words]


def _rival(program: str, map_name: str, *way: str) -> Contender:
    name = " ".join((program.removesuffix("_rival"), *way))
    return Contender(name, map_name, RAYS, 1, (program, *way))


def _ours(way: str, threads: int, takes: str) -> Contender:
    """Motion within the ping is timed with one thread of the evidence grid."""
    map_name = "ours, rays" if way == "rays" else "ours, evidence grid"
    words = [way, "--threads", f"{threads}"]
    words += ["--first-returns"] if takes == FIRST else []
    words += ["--motion"] if way == "grid" and threads == 1 else []
    return Contender(f"{way} {threads} {takes}", map_name, takes, threads, tuple(words))


RAYS, FIRST, FULL = "11 rays a first return", "first returns", "full image"
OCTOMAP = _rival("octomap_rival", "OctoMap insertPointCloud")
OPENVDB = (
    _rival("openvdb_rival", "OpenVDB, each visit", "visits"),
    _rival("openvdb_rival", "OpenVDB, once a ping", "once"),
)
BONXAI = _rival("bonxai_rival", "Bonxai insertPointCloud")
RAYS_FIRST, RAYS_FULL = _ours("rays", 1, FIRST), _ours("rays", 1, FULL)
GRID_FIRST, GRID_FULL = _ours("grid", 1, FIRST), _ours("grid", 1, FULL)
GRID_FIRST_2, GRID_FULL_2 = _ours("grid", 2, FIRST), _ours("grid", 2, FULL)
CONTENDERS = (
    *(OCTOMAP, *OPENVDB, BONXAI),
    *(RAYS_FIRST, RAYS_FULL),
    *(GRID_FIRST, GRID_FULL, GRID_FIRST_2, GRID_FULL_2),
)


PACKAGES = {
    "octomap_rival": "OctoMap (pip install '.[octomap]')",
    "openvdb_rival": "OpenVDB (apt install libopenvdb-dev libboost-dev)",
    "bonxai_rival": "Bonxai (--bonxai with a checkout, apt install libeigen3-dev)",
}
BEGAN_S = time.perf_counter()


def build_rivals(out: Path, bonxai: Path | None) -> Path:
    """Build the programs in C++; returns their folder.

    Args:
        out: the build's folder lies in it.
        bonxai: a checkout of Bonxai; None keeps the one of an earlier build, if any.
    """
    log("building the rivals")
    build = out / "build"
    octomap = Path(sysconfig.get_path("purelib")) / "cmeel.prefix"  # where the wheel keeps it
    tools = Path(sys.executable).parent
    environment = os.environ | {"PATH": f"{tools}{os.pathsep}{os.environ['PATH']}"}
    configure = f"cmake -G Ninja -S {BENCH / 'cpp'} -B {build} -DCMAKE_BUILD_TYPE=Release"
    options = [f"-DCMAKE_PREFIX_PATH={octomap}"]
    options += [] if bonxai is None else [f"-DBONXAI_PATH={bonxai.resolve()}"]
    build_all = f"cmake --build {build} -- -k 0"  # one that does not build spares the others
    with (out / "build.log").open("wb") as out_file:
        for words in ([*configure.split(), *options], build_all.split()):
            done = subprocess.run(  # noqa: S603 our own programs
                words, env=environment, check=False, stdout=out_file, stderr=subprocess.STDOUT
            )
            if done.returncode != 0:
                log(f"not everything builds: {out / 'build.log'}")
    for program, package in PACKAGES.items():
        if not (build / program).exists():
            log(f"left out: {package} was not found or does not build")
    return build


def describe_machine(build: Path, load_before: float) -> Machine:
    """What the reader must know to compare, and the memory's bandwidth."""
    log("measuring the memory's bandwidth")
    bandwidth = msgspec.json.decode(run_json([build / "bandwidth"]))
    compiler = _first_line(["c++", "--version"])
    commit = _first_line(["git", "-C", str(BENCH), "describe", "--always", "--dirty"])
    return Machine(
        cpu=cpu_model(),
        cores=os.cpu_count() or 1,
        compiler=compiler,
        commit=commit,
        load=load_before,
        bytes_a_second=bandwidth["bytes_per_s"],
    )


def log(line: str) -> None:
    """Progress, with the seconds since the start."""
    print(f"[{time.perf_counter() - BEGAN_S:5.0f} s] {line}", file=sys.stderr, flush=True)


def status_bytes(name: str) -> int:
    """A line of /proc/self/status, such as VmHWM, in bytes."""
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith(name + ":"):
            return int(line.split()[1]) * 1024
    raise LookupError(name)


def run_json(command: Sequence[str | Path]) -> bytes:
    """Run a program in a process of its own; returns its standard output.

    Raises:
        RuntimeError: it failed; with its standard error.
    """
    words = [str(word) for word in command]
    environment = os.environ | {"PYTHONPATH": str(BENCH.parent)}
    done = subprocess.run(words, env=environment, capture_output=True, check=False)  # noqa: S603
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(words)}: {done.stderr.decode(errors='replace').strip()}")
    return done.stdout


def _first_line(command: list[str]) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=True)  # noqa: S603
    return done.stdout.partition("\n")[0]
