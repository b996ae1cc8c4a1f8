"""Our integrators against OctoMap and OpenVDB, on the same simulated pings, in one run.

Usage: python tools/bench/rivals.py [--pings N]. Prints the tables and writes them to
docs/performance.md, with docs/images/performance.png; docs/performance.md says what is measured.
"""

import argparse
import math
import os
import platform
import subprocess
import sys
import sysconfig
import time
from collections.abc import Sequence
from pathlib import Path

import msgspec
from accuracy import Accuracy
from bench_input import SETTINGS, cached
from bench_pings import load, write_rays
from bench_plot import draw
from bench_report import markdown, put_into
from contenders import BENCH, CONTENDERS, FIRST, FULL, Case
from measured import Measured, run_json
from results import CaseResult, Machine, Results, Water

from mapperd.config import Config, Mapping

ROOT = BENCH.parent.parent
PAGE, PICTURE = ROOT / "docs" / "performance.md", ROOT / "docs" / "images" / "performance.png"
RESOLUTIONS_M = (0.1, 0.05)
ACCURACY_BUDGET_S = 6.0
PACKAGES = {
    "octomap_rival": "OctoMap (pip install 'mapperd[octomap]')",
    "openvdb_rival": "OpenVDB (apt install libopenvdb-dev libboost-dev)",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, print, and write."""
    parser = argparse.ArgumentParser(prog="rivals", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--pings", type=int, default=40, help="a case")
    parser.add_argument("--seed", type=int, default=7, help="of the simulated noise")
    parser.add_argument("--budget", type=float, default=60.0, help="most seconds a contender")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "bench")
    parser.add_argument("--keep-docs", action="store_true", help="leave docs/ as it is")
    said = parser.parse_args(argv)
    said.out.mkdir(parents=True, exist_ok=True)
    results = measure_all(said.out, said.pings, said.seed, said.budget)
    results.save(said.out / "results.json")
    text = markdown(results)
    print(text)
    draw(said.out / "performance.png", results)
    if not said.keep_docs:
        put_into(PAGE, text)
        draw(PICTURE, results)
    return 0


def measure_all(out: Path, pings: int, seed: int, budget_s: float) -> Results:
    """Run everybody, one after another."""
    load_before = os.getloadavg()[0]
    cases = make_cases(out, pings, seed)
    build = build_rivals(out)
    machine = describe_machine(build, load_before)
    return Results(
        command=f"python tools/bench/rivals.py --pings {pings} --seed {seed}",
        pings=pings,
        seed=seed,
        error_bound=Mapping().error_bound,
        machine=machine,
        cases=[measure_case(case, build, budget_s) for case in cases],
        open_water={way: measure_open_water(way) for way in ("exact", "default")},
    )


def make_cases(out: Path, pings: int, seed: int) -> list[Case]:
    """Simulate the pings, or find them simulated, and write them for the rivals."""
    aperture_rad = math.radians(Config().sonar.vertical_aperture)
    cases = []
    for setting in SETTINGS:
        say(f"simulating {pings} pings of {setting.range_m:g} m")
        file = cached(out, setting, pings, seed)
        rays = file.with_suffix(".rays")
        write_rays(rays, load(file), aperture_rad)
        cases += [Case(setting.range_m, each_m, file, rays) for each_m in RESOLUTIONS_M]
    return cases


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
    commit = _first_line(["git", "-C", str(ROOT), "describe", "--always", "--dirty"])
    return Machine(
        cpu=models[0] if models else platform.machine(),
        cores=os.cpu_count() or 1,
        compiler=compiler,
        commit=commit,
        load=load_before,
        bytes_a_second=bandwidth["bytes_per_s"],
    )


def measure_case(case: Case, build: Path, budget_s: float) -> CaseResult:
    """Run each contender on one case, then compare ours with the exact map."""
    runs = {}
    for contender in CONTENDERS:
        if not contender.is_ours and not (build / contender.words[0]).exists():
            continue
        command = contender.command(case, build, budget_s)
        run = msgspec.json.decode(run_json(command), type=Measured)
        runs[contender.name] = run
        label = f"{contender.map_name}, {contender.takes}, {contender.threads} thread(s)"
        say(f"{case.name}: {run.median_ms:8.2f} ms  {label}")
    say(f"{case.name}: comparing with the exact map")
    accuracy = {FIRST: measure_accuracy(case, "--first-returns"), FULL: measure_accuracy(case)}
    return CaseResult(case.name, case.range_m, case.resolution_m, runs, accuracy)


def measure_accuracy(case: Case, *options: str) -> dict[str, Accuracy]:
    """Compare in a process of its own."""
    given = (f"{case.resolution_m}", f"{ACCURACY_BUDGET_S:g}", *options)
    found = run_json([sys.executable, BENCH / "accuracy.py", case.pings_file, *given])
    return msgspec.json.decode(found, type=dict[str, Accuracy])


def measure_open_water(way: str) -> Water:
    """Time pings without returns."""
    say(f"open water, {way}")
    found = run_json([sys.executable, BENCH / "open_water.py", way])
    return msgspec.json.decode(found, type=Water)


def say(line: str) -> None:
    """Progress, with the seconds since the start."""
    print(f"[{time.perf_counter() - BEGAN_S:5.0f} s] {line}", file=sys.stderr, flush=True)


def _first_line(command: list[str]) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=True)  # noqa: S603
    return done.stdout.partition("\n")[0]


BEGAN_S = time.perf_counter()

if __name__ == "__main__":
    sys.exit(main())
