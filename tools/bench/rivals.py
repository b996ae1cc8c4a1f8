"""Our integrators against OctoMap and OpenVDB, on the same simulated pings, in one run.

Usage: python tools/bench/rivals.py [--pings N] [--looks down] [--only WORD ...]. Prints the tables
and writes them to docs/performance.md, with docs/images/performance.png; docs/performance.md says
what is measured. A part of the whole (--looks, --only) leaves docs/ as it is.
"""

import argparse
import math
import os
import sys
from collections.abc import Sequence
from pathlib import Path

import msgspec
from accuracy import Accuracy
from bench_host import build_rivals, describe_machine, say
from bench_input import LOOKS, SETTINGS, cached
from bench_pings import load, loud_share, write_rays
from bench_plot import draw
from bench_report import markdown, put_into
from contenders import BENCH, CONTENDERS, FIRST, FULL, Case, Contender
from measured import Measured, run_json
from our_settings import APERTURE_DEG
from results import CaseResult, Results, Water

from mapperd.config import Mapping

ROOT = BENCH.parent.parent
PAGE, PICTURE = ROOT / "docs" / "performance.md", ROOT / "docs" / "images" / "performance.png"
RESOLUTIONS_M = (0.1, 0.05)
ACCURACY_BUDGET_S = 4.0


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, print, and write."""
    said = parse(argv)
    said.out.mkdir(parents=True, exist_ok=True)
    results = measure_all(said)
    results.save(said.out / "results.json")
    text = markdown(results)
    print(text)
    draw(said.out / "performance.png", results)
    is_whole = not said.only and set(said.looks) == set(LOOKS)
    if is_whole and not said.keep_docs:
        put_into(PAGE, text)
        draw(PICTURE, results)
    return 0


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    """What the caller wants."""
    parser = argparse.ArgumentParser(prog="rivals", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--pings", type=int, default=20, help="a case")
    parser.add_argument("--seed", type=int, default=7, help="of the simulated noise")
    parser.add_argument("--budget", type=float, default=8.0, help="most seconds a contender")
    parser.add_argument("--looks", nargs="+", choices=LOOKS, default=list(LOOKS))
    help_only = "contenders whose name contains a word, and no more than their times"
    parser.add_argument("--only", nargs="+", metavar="WORD", default=[], help=help_only)
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "bench")
    parser.add_argument("--keep-docs", action="store_true", help="leave docs/ as it is")
    return parser.parse_args(argv)


def measure_all(said: argparse.Namespace) -> Results:
    """Run everybody, one after another."""
    load_before = os.getloadavg()[0]
    cases = make_cases(said.out, said.looks, said.pings, said.seed)
    build = build_rivals(said.out)
    options = f"--pings {said.pings} --seed {said.seed} --budget {said.budget:g}"
    if set(said.looks) != set(LOOKS):
        options += f" --looks {' '.join(said.looks)}"
    if said.only:
        options += f" --only {' '.join(said.only)}"
    water_ways = () if said.only else ("exact", "default")
    return Results(
        command=f"python tools/bench/rivals.py {options}",
        pings=said.pings,
        seed=said.seed,
        error_bound=Mapping().error_bound,
        machine=describe_machine(build, load_before),
        cases=[measure_case(case, build, said.budget, said.only) for case in cases],
        open_water={way: measure_open_water(way) for way in water_ways},
    )


def make_cases(out: Path, looks: Sequence[str], pings: int, seed: int) -> list[Case]:
    """Simulate the pings, or find them simulated, and write them for the rivals."""
    aperture_rad = math.radians(APERTURE_DEG)
    cases = []
    for setting in SETTINGS:
        if setting.look not in looks:
            continue
        say(f"simulating {pings} pings, looking {setting.look}, {setting.range_m:g} m")
        file = cached(out, setting, pings, seed)
        rays, simulated = file.with_suffix(".rays"), load(file)
        write_rays(rays, simulated, aperture_rad)
        share = loud_share(simulated)
        cases += [
            Case(setting.look, setting.range_m, each_m, file, rays, share)
            for each_m in RESOLUTIONS_M
        ]
    return cases


def measure_case(case: Case, build: Path, budget_s: float, only: Sequence[str]) -> CaseResult:
    """Run each contender on one case, then compare ours with the exact map."""
    runs = {}
    for contender in chosen(only):
        if not contender.is_ours and not (build / contender.words[0]).exists():
            continue
        command = contender.command(case, build, budget_s)
        run = msgspec.json.decode(run_json(command), type=Measured)
        runs[contender.name] = run
        say(f"{case.name}: {run.median_ms:8.2f} ms  {contender.label}")
    accuracy = {} if only else measure_accuracies(case)
    size = (case.range_m, case.resolution_m)
    return CaseResult(case.name, case.look, *size, case.loud_share, runs, accuracy)


def chosen(only: Sequence[str]) -> list[Contender]:
    """Those whose name contains any of the words; all, if there are none."""
    return [c for c in CONTENDERS if not only or any(word in c.name for word in only)]


def measure_accuracies(case: Case) -> dict[str, dict[str, Accuracy]]:
    """Of first returns and of full images."""
    say(f"{case.name}: comparing with the exact map")
    return {FIRST: measure_accuracy(case, "--first-returns"), FULL: measure_accuracy(case)}


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


if __name__ == "__main__":
    sys.exit(main())
