"""The command `accuracy-cost`: measure, draw, and check that the defaults are worth choosing."""

import argparse
import os
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from tqdm import tqdm

from studies.accuracy_cost.checking import measure_quick, verdicts
from studies.accuracy_cost.errors import AccuracyCostError
from studies.accuracy_cost.results import Results, read_results, write_results
from studies.accuracy_cost.running import run, wanted_keys
from studies.accuracy_cost.studies import MODULES, Selection, load_all
from studies.accuracy_cost.study import Study
from studies.report import IMAGES, ROOT

__all__ = ["RECORDED", "main"]

RECORDED = ROOT / "docs/reports/accuracy-cost"
FAULT, USAGE, INTERRUPTED = 1, 2, 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; what a person can mend is one line and exit code 2."""
    said = _parser().parse_args(argv)
    try:
        studies = load_all(said.only)
        return int(said.does(studies, said))
    except AccuracyCostError as error:
        sys.stderr.write(f"accuracy-cost: {error}\n")
        return USAGE
    except KeyboardInterrupt:
        sys.stderr.write("accuracy-cost: interrupted; the same command goes on from here\n")
        return INTERRUPTED


def _run(studies: Mapping[str, Study], said: argparse.Namespace) -> int:
    selection = Selection(tuple(said.knob), said.quick)
    selection.check_names(studies.values())
    tally = run(studies, selection, said.out, said.jobs)
    failures = f", {tally.failed} failed" if tally.failed else ""
    print(f"{tally.total} measurements, {tally.kept} were there{failures}: {said.out}")
    if tally.failed:
        return FAULT
    return _record(studies, said.out) if said.write else 0


def _record(studies: Mapping[str, Study], out: Path) -> int:
    """Copy whole results to where they are committed, in the order of the studies."""
    for study in studies.values():
        results = read_results(out / f"{study.name}.csv")
        keys = wanted_keys(study, Selection())
        if missing := [key for key in keys if key not in results.rows]:
            raise AccuracyCostError(
                f"{study.name}: {len(missing)} of {len(keys)} are not measured yet: not written"
            )
        write_results(RECORDED / f"{study.name}.csv", results, keys)
    return 0


def _plot(studies: Mapping[str, Study], said: argparse.Namespace) -> int:
    # matplotlib takes longer to import than a check of its names.
    from studies.accuracy_cost.drawing import draw  # noqa: PLC0415

    selection = Selection(tuple(said.knob))
    selection.check_names(studies.values())
    for study in studies.values():
        results = _results(study, RECORDED if said.write else said.out)
        for path in draw(study, results, selection, said.pictures, write=said.write):
            print(path)
    return 0


def _results(study: Study, out: Path) -> Results:
    """What was measured here, or else what is committed."""
    for folder in (out, RECORDED):
        path = folder / f"{study.name}.csv"
        if path.exists():
            return read_results(path)
    raise AccuracyCostError(
        f"{study.name}: nothing is measured: python -m studies accuracy-cost run"
    )


def _check(studies: Mapping[str, Study], _: argparse.Namespace) -> int:
    costs = {study.name: _results(study, RECORDED) for study in studies.values()}
    with tempfile.TemporaryDirectory(prefix="accuracy-cost-") as folder:
        errors = {
            study.name: measure_quick(module, study, Path(folder))
            for module, study in tqdm(studies.items(), unit="study", disable=None)
        }
    judged = verdicts(studies, errors, costs)
    for each in judged:
        print(each, file=sys.stdout if each.good else sys.stderr)
    return 0 if all(each.good for each in judged) else FAULT


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m studies accuracy-cost", description=__doc__, allow_abbrev=False,
        epilog="exit codes: 0 done; 1 a measurement failed or a default is not worth choosing; "
        "2 the command cannot be as given; 130 interrupted",
    )  # fmt: skip
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    measure = commands.add_parser("run", help="measure what is not measured yet")
    measure.add_argument("--quick", action="store_true", help="only the subset of check")
    measure.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    measure.add_argument(
        "--write", action="store_true", help="copy whole results to docs/reports/accuracy-cost"
    )
    measure.set_defaults(does=_run)
    plot = commands.add_parser("plot", help="draw what is measured")
    plot.add_argument("--pictures", type=Path, default=IMAGES / "accuracy-cost")
    plot.add_argument(
        "--write",
        action="store_true",
        help="of what is recorded, with the tables of docs/reports/accuracy-cost.md",
    )
    plot.set_defaults(does=_plot)
    check = commands.add_parser("check", help="fail where a default is not worth choosing")
    check.set_defaults(does=_check)
    for command in (measure, plot, check):
        command.add_argument("--only", nargs="+", choices=MODULES, default=list(MODULES))
    for command in (measure, plot):
        command.add_argument("--knob", nargs="+", default=[], metavar="NAME")
        command.add_argument("--out", type=Path, default=ROOT / "out/accuracy-cost")
    return parser
