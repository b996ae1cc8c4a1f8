"""The command `accuracy-cost`: measure, draw, and check that the defaults are worth choosing."""

import argparse
import math
import os
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tqdm import tqdm

from studies.accuracy_cost.front import Lag, lag, mean_point, plane_of
from studies.accuracy_cost.results import StudyResults, key_of, read_results, write_results
from studies.accuracy_cost.running import Job, perform, run, wanted_keys
from studies.accuracy_cost.study import (
    MODULES,
    AccuracyCostError,
    Knob,
    Selection,
    Study,
    StudyDive,
    load_all,
)
from studies.report import IMAGES, ROOT

__all__ = ["RECORDED", "DefaultVerdict", "main", "measure_quick", "verdict", "verdicts"]


@dataclass(frozen=True, slots=True)
class DefaultVerdict:
    """What a knob's default is worth.

    Attributes:
        lag: how far it lies behind the front; none where its cost was never recorded.
    """

    study: str
    knob: Knob
    lag: Lag | None

    @property
    def good(self) -> bool:
        """Whether the default lies behind the front by no more than the knob's margin."""
        return self.lag is not None and self.lag.share <= self.knob.margin

    def __str__(self) -> str:
        name = f"{self.study}: {self.knob.name}"
        if self.lag is None:
            return f"{name}: no recorded cost of its default: run make accuracy-cost"
        if self.lag.better is None:
            return f"{name}: the default is on the front"
        return (
            f"{name}: the default lies {100 * self.lag.share:.1f} % behind the front (margin "
            f"{100 * self.knob.margin:g} %): {self.lag.better.label} has less error at no more cost"
        )


def measure_quick(module: str, study: Study, folder: Path) -> StudyResults:
    """Measure the quick subset, in this process.

    Raises:
        AccuracyCostError: a setting cannot be measured.
    """
    results = StudyResults({"study": study.name}, [column.name for column in study.columns])
    selection = Selection(quick=True)
    for dive in selection.dives_of(study):
        place = folder / study.name / f"{dive.name}-{dive.seed}"
        for setting in (None, *selection.settings_of(study)):
            outcome = perform(Job(module, dive, setting, place))
            if outcome.figures is None:
                label = "its files" if setting is None else setting.label
                raise AccuracyCostError(f"{study.name}: {dive.name}, {label}: {outcome.failure}")
            if setting is not None:
                results.rows[key_of(setting, dive)] = outcome.figures
    return results


def verdict(
    study: Study, knob: Knob, dives: Sequence[StudyDive], errors: StudyResults, costs: StudyResults
) -> DefaultVerdict:
    """Judge a knob's default by the mean over dives; errors and costs may be of different runs."""
    plane = plane_of(study, knob)
    points = [
        replace(
            mean_point(plane, errors, setting, dives),
            cost=mean_point(plane, costs, setting, dives).cost,
        )
        for setting in knob.settings
    ]
    (default,) = (point for point in points if not point.setting.overrides)
    others = [point for point in points if point.setting.overrides]
    known = not math.isnan(default.cost)
    return DefaultVerdict(study.name, knob, lag(default, others) if known else None)


def verdicts(
    studies: Mapping[str, Study],
    errors: Mapping[str, StudyResults],
    costs: Mapping[str, StudyResults],
) -> list[DefaultVerdict]:
    """Judge the defaults of all quick knobs; results are by the study's name."""
    return [
        verdict(study, knob, dives, errors[study.name], costs[study.name])
        for study in studies.values()
        for dives in [[dive for dive in study.dives if dive.quick]]
        for knob in study.knobs
        if knob.quick
    ]


RECORDED = ROOT / "docs/reports/accuracy-cost"
FAULT, USAGE, INTERRUPTED = 1, 2, 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; what a person can mend is one line and exit code 2."""
    args = _parser().parse_args(argv)
    try:
        studies = load_all(args.only)
        return int(args.does(studies, args))
    except AccuracyCostError as error:
        sys.stderr.write(f"accuracy-cost: {error}\n")
        return USAGE
    except KeyboardInterrupt:
        sys.stderr.write("accuracy-cost: interrupted; the same command resumes\n")
        return INTERRUPTED


def _run(studies: Mapping[str, Study], args: argparse.Namespace) -> int:
    selection = Selection(tuple(args.knob), args.quick)
    selection.check_names(studies.values())
    tally = run(studies, selection, args.out, args.jobs)
    failures = f", {tally.failed} failed" if tally.failed else ""
    print(f"{tally.total} measurements, {tally.kept} were there{failures}: {args.out}")
    if tally.failed:
        return FAULT
    return _record(studies, args.out) if args.write else 0


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


def _plot(studies: Mapping[str, Study], args: argparse.Namespace) -> int:
    # matplotlib takes longer to import than a check of its names.
    from studies.accuracy_cost.drawing import draw  # noqa: PLC0415

    selection = Selection(tuple(args.knob))
    selection.check_names(studies.values())
    for study in studies.values():
        results = _results(study, RECORDED if args.write else args.out)
        for path in draw(study, results, selection, args.pictures, write=args.write):
            print(path)
    return 0


def _results(study: Study, out: Path) -> StudyResults:
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
