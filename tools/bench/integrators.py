"""Our integrators against OctoMap, OpenVDB and Bonxai, on the same simulated pings, in one run.

Usage: python -m bench integrators [--bonxai PATH] [--looks down] [--only WORD ...]. Prints the
tables and writes them into the page on performance, with its picture. The page describes what is
measured. A part of the whole (--looks, --only) leaves docs/ as it is.
"""

import argparse
import math
import os
import sys
from collections.abc import Sequence
from pathlib import Path

import msgspec
from studies.report import IMAGES, PAGES, ROOT, write_section

from bench.contenders import (
    BENCH,
    CONTENDERS,
    Contender,
    PingCase,
    build_rivals,
    describe_machine,
    log,
    run_json,
)
from bench.inputs import LOOKS, SETTINGS, cached, load, loud_share, write_rays
from bench.our_contender import APERTURE_DEG
from bench.report import details, draw, markdown
from bench.results import BenchResults, CaseResult, ContenderResult, DetailDifference

PROGRAM = "python -m bench integrators"
PICTURE = IMAGES / "performance.png"
DETAILS = PAGES["performance"].with_suffix("") / "integrators.csv"
RESOLUTIONS_M = (0.1, 0.05)
DETAIL_BUDGET_S = 4.0


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, print, and write."""
    args = parse(argv)
    args.out.mkdir(parents=True, exist_ok=True)
    results = measure_all(args)
    results.save(args.out / "results.json")
    text = markdown(results)
    print(text)
    (args.out / DETAILS.name).write_text(details(results), encoding="utf-8")
    draw(args.out / "performance.png", results)
    is_whole = not args.only and set(args.looks) == set(LOOKS)
    if is_whole and not args.keep_docs:
        write_section(PAGES["performance"], "integrators", text, PROGRAM)
        DETAILS.write_text(details(results), encoding="utf-8")
        draw(PICTURE, results)
    return 0


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="rivals", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--pings", type=int, default=20, help="a case")
    parser.add_argument("--seed", type=int, default=7, help="of the simulated noise")
    parser.add_argument("--budget", type=float, default=8.0, help="seconds a contender and pass")
    parser.add_argument("--looks", nargs="+", choices=LOOKS, default=list(LOOKS))
    help_only = "only contenders whose name contains a word, and only their times"
    parser.add_argument("--only", nargs="+", metavar="WORD", default=[], help=help_only)
    parser.add_argument(
        "--bonxai",
        type=Path,
        metavar="PATH",
        default=os.environ.get("BONXAI_PATH") or None,
        help="checkout of https://github.com/facontidavide/Bonxai (default: $BONXAI_PATH)",
    )
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "bench")
    parser.add_argument("--keep-docs", action="store_true", help="leave docs/ as it is")
    return parser.parse_args(argv)


def measure_all(args: argparse.Namespace) -> BenchResults:
    """Run every contender, one after another."""
    load_before = os.getloadavg()[0]
    cases = make_cases(args.out, args.looks, args.pings, args.seed)
    build = build_rivals(args.out, args.bonxai)
    options = f"--pings {args.pings} --seed {args.seed} --budget {args.budget:g}"
    if set(args.looks) != set(LOOKS):
        options += f" --looks {' '.join(args.looks)}"
    if args.only:
        options += f" --only {' '.join(args.only)}"
    return BenchResults(
        command=f"python {PROGRAM} {options}",
        pings=args.pings,
        seed=args.seed,
        machine=describe_machine(build, load_before),
        cases=[measure_case(case, build, args.budget, args.only) for case in cases],
        open_water={} if args.only else measure_open_water(),
    )


def make_cases(out: Path, looks: Sequence[str], pings: int, seed: int) -> list[PingCase]:
    """Simulate the pings, unless cached, and write them as rays for the rivals."""
    aperture_rad = math.radians(APERTURE_DEG)
    cases = []
    for setting in SETTINGS:
        if setting.look not in looks:
            continue
        log(f"simulating {pings} pings, looking {setting.look}, {setting.range_m:g} m")
        file = cached(out, setting, pings, seed)
        rays, simulated = file.with_suffix(".rays"), load(file)
        write_rays(rays, simulated, aperture_rad)
        share = loud_share(simulated)
        cases += [
            PingCase(setting.look, setting.range_m, each_m, file, rays, share)
            for each_m in RESOLUTIONS_M
        ]
    return cases


def measure_case(case: PingCase, build: Path, budget_s: float, only: Sequence[str]) -> CaseResult:
    """Run each contender on one case, then compare detail 1 with the converged grid."""
    runs = {}
    for contender in chosen(only):
        if not contender.is_ours and not (build / contender.words[0]).exists():
            continue
        command = contender.command(case, build, budget_s)
        run = msgspec.json.decode(run_json(command), type=ContenderResult)
        runs[contender.name] = run
        log(f"{case.name}: {run.median_ms:8.2f} ms  {contender.label}")
    detail = None if only else measure_detail(case)
    size = (case.range_m, case.resolution_m)
    return CaseResult(case.name, case.look, *size, case.loud_share, runs, detail)


def chosen(only: Sequence[str]) -> list[Contender]:
    """The contenders whose name contains any of the words; without words, all."""
    return [c for c in CONTENDERS if not only or any(word in c.name for word in only)]


def measure_detail(case: PingCase) -> DetailDifference:
    """Compare in a process of its own."""
    log(f"{case.name}: comparing with the converged grid")
    given = (f"{case.resolution_m}", f"{DETAIL_BUDGET_S:g}")
    found = run_json([sys.executable, "-m", "bench.detail", case.pings_file, *given])
    return msgspec.json.decode(found, type=DetailDifference)


def measure_open_water() -> dict[str, float]:
    """Time pings without returns."""
    log("open water")
    return msgspec.json.decode(
        run_json([sys.executable, BENCH / "open_water.py"]), type=dict[str, float]
    )


if __name__ == "__main__":
    sys.exit(main())
