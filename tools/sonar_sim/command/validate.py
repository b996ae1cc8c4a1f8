"""`sonar-sim validate`: the simulator against theory and measurement."""

import argparse
from pathlib import Path

from tqdm import tqdm

from oculus_driver.command_line import ExitCode
from sonar_sim.command.arguments import names
from sonar_sim.errors import SonarSimError
from sonar_sim.validation.case import ValidationResult
from sonar_sim.validation.cases import CASES, draw_page

NAME = "validate"
HELP = "compute and draw the validation cases; fail if one does not hold"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add = parser.add_argument
    add("--out", metavar="DIR", type=Path, required=True, help="folder of the page")
    add("--only", metavar="V2,V18", type=names, default=(), help="only these cases")
    add("--verbose", action="store_true", help="print every number, not only those that fail")


def run(args: argparse.Namespace) -> int:
    """Print expected and computed values of each case; return 1 if one is off."""
    unknown = [name for name in args.only if name not in CASES]
    if unknown:
        raise SonarSimError(f"no case is named {unknown[0]}; use {', '.join(CASES)}")
    chosen = args.only or tuple(CASES)
    results = [CASES[name]() for name in tqdm(chosen, unit="case", disable=None)]
    for result in results:
        print("\n".join(_lines(result, verbose=args.verbose)))
    page = args.out / "simulator-validation.png"
    draw_page(page, results)
    failed = sum(not check.holds for result in results for check in result.checks)
    print(f"{len(results)} cases, {failed} numbers off; drawn: {page}")
    return ExitCode.FAULT if failed else ExitCode.OK


def _lines(result: ValidationResult, *, verbose: bool) -> list[str]:
    held = sum(check.holds for check in result.checks)
    lines = [f"{result.name}: {held} of {len(result.checks)} hold ({result.source})"]
    return lines + [
        f"  {'ok ' if check.holds else 'OFF'} {check.what}: {check.got:.6g},"
        f" expected {check.expected:.6g} ± {check.tolerance:.2g}"
        for check in result.checks
        if verbose or not check.holds
    ]
