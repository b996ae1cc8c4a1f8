"""Simulate the dives, align each with every odometry, and judge.

Usage: python -m studies drift simulate [--dives NAME ...] [--ping-seeds 1 2]
       python -m studies drift run [--dives ...] [--kinds NAME ...] [--seeds 1 2 3 4 5]
           [--ping-seeds 1] [--align MODULE:FUNCTION] [--name NAME] [--set SETTING=VALUE ...]
           [--no-maps] [--jobs 2]
       python -m studies drift report [--dives ...] [--kinds ...] [--name NAME ...] [--rows]

What is there is not done again: recordings that are simulated, and rows of the same core, settings,
files, aligner and figures. A row is a file, `rows/NAME/DIVE-KIND-SEED-PINGSEED.json`; maps at true
poses and at the odometry's are the same for all aligners and kept in `maps/`.

An aligner is a function of a recording, a file of odometry, settings and a folder. It writes there

- `trajectory.tum`: the base at the pings at least, in the odometry's frame or the map's;
- `loops.csv`: the loops that it accepted, as `judge.read_loops` reads them; without loops, nothing;
- `verdict.json`: `{"corrected": true}`, or `{"corrected": false, "because": "..."}`.

Without `--align` it is `mapperd.alignment`; `studies.drift.run:keep_odometry` aligns nothing.
"""

import argparse
import dataclasses
import hashlib
import importlib
import inspect
import itertools
import json
import statistics
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, cast

import msgspec
import numpy as np
import yaml

from mapperd.alignment.align import DiveInput, align
from mapperd.alignment.report import write_alignment
from mapperd.alignment.submaps import read_submaps
from mapperd.config.loader import config_of, read_tree
from mapperd.config.tree import Config
from mapperd.odometry.odometry_files import OdometryOptions
from mapperd.session.recordings import files_in, sessions_of
from mapperd.session.replay import odometry_of
from studies.accuracy_cost.mapping.dives import once
from studies.drift.dives import (
    DIVES,
    FOLDER,
    KINDS,
    PING_SEEDS,
    SEEDS,
    SITE_DIVES,
    odometry_path,
    pings_path,
    simulate,
)
from studies.drift.judge import (
    LoopErrors,
    MapErrors,
    TrackErrors,
    loop_errors,
    map_errors,
    read_loops,
    read_odometry_track,
    read_tum,
    track_errors,
    write_tum,
)
from studies.report import table
from studies.runner import do_all

__all__ = [
    "DriftTask",
    "align_recording",
    "keep_odometry",
    "run_task",
    "summary_table",
    "table_of_rows",
]


Aligner = Callable[[Path, Path, Config, Path], None]
Row = Mapping[str, Any]

FIGURES_VERSION = 1
"""Counts up when `judge` changes what a figure means."""
WORSE_RATIO = 1.05
"""A corrected trajectory whose error is larger by more than this has become worse."""


def keep_odometry(recording: Path, odometry: Path, config: Config, out: Path) -> None:
    """Align nothing; see the module for what an aligner writes."""
    del recording, config
    write_tum(out / "trajectory.tum", read_odometry_track(odometry))
    verdict = {"corrected": False, "because": "nothing was aligned"}
    (out / "verdict.json").write_text(json.dumps(verdict))


def align_recording(recording: Path, odometry: Path, config: Config, out: Path) -> None:
    """Align with `mapperd.alignment`; see the module for what an aligner writes."""
    sessions = sessions_of(files_in([recording], begun=True))
    files = odometry_of(sessions, OdometryOptions((odometry,)), config)
    [session] = sessions_of(files_in([recording], begun=True), odometry=files)
    alignment = align([DiveInput("dive", partial(read_submaps, session, config))])
    [dive] = alignment.dives
    write_alignment(alignment, out)
    lines = ["t_i_s,t_j_s,x_m,y_m,yaw_rad,accepted"]
    for loop in alignment.loops:
        if not loop.neighbours:
            times = f"{dive.t_ns[loop.i] / 1e9:.9f},{dive.t_ns[loop.j] / 1e9:.9f}"
            x, y, yaw = loop.poses[loop.chosen].tolist()
            lines.append(f"{times},{x:.6f},{y:.6f},{yaw:.6f},{int(loop.accepted)}")
    (out / "loops.csv").write_text("\n".join(lines) + "\n")
    verdict = {"corrected": alignment.corrected, "because": alignment.reason}
    (out / "verdict.json").write_text(json.dumps(verdict))


@dataclass(frozen=True)
class DriftTask:
    """A dive with one odometry to be aligned and judged.

    Attributes:
        dive, kind, seed: the dive and its odometry.
        ping_seed: of its pings.
        aligner: `MODULE:FUNCTION`.
        name: of the aligner with its settings.
        settings: that differ from the dive's, by dotted name.
        maps: whether maps are judged too.
        folder: of all files.
    """

    dive: str
    kind: str
    seed: int
    ping_seed: int
    aligner: str
    name: str
    settings: Mapping[str, object]
    maps: bool
    folder: Path

    @property
    def label(self) -> str:
        """Name of its files."""
        return f"{self.dive}-{self.kind}-{self.seed}-{self.ping_seed}"

    @property
    def row_file(self) -> Path:
        """Where its row is."""
        return self.folder / "rows" / self.name / f"{self.label}.json"

    @property
    def pings(self) -> Path:
        """Recording of the pings."""
        gap = KINDS[self.kind].gap
        return pings_path(self.folder, self.dive, self.ping_seed, gap=gap)

    @property
    def odometry(self) -> Path:
        """Recording of the odometry."""
        return odometry_path(self.folder, self.dive, self.kind, self.seed)

    @cached_property
    def config(self) -> Config:
        """The dive's settings with those of the task.

        Raises:
            ConfigError: there is no such setting, or the value is not allowed.
        """
        tree = read_tree(self.folder / self.dive / "config.yaml")
        for name, value in self.settings.items():
            *sections, field = name.split(".")
            place = tree
            for section in sections:
                place = place.setdefault(section, {})
            place[field] = value
        return config_of(tree, self.name)

    def align(self) -> Aligner:
        """The function that aligns."""
        module, _, function = self.aligner.partition(":")
        return cast("Aligner", getattr(importlib.import_module(module), function))

    def fingerprint(self) -> str:
        """Of everything that the row depends on."""
        parts = [
            msgspec.json.encode(self.config).decode(),
            self.aligner,
            _sources_sha256(self.aligner.partition(":")[0]),
            _core_sha256(),
            _sha256(self.pings),
            _sha256(self.odometry),
            str(self.maps),
            str(FIGURES_VERSION),
        ]
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()


@cache
def _core_sha256() -> str:
    """Of the compiled core."""
    spec = find_spec("mapperd._core")
    return _sha256(Path(spec.origin)) if spec is not None and spec.origin is not None else ""


@cache
def _sources_sha256(module: str) -> str:
    """Of the aligner's module, and of the alignment in the daemon, where there is one."""
    files = [Path(inspect.getfile(importlib.import_module(module)))]
    package = find_spec("mapperd.alignment")
    for folder in (package.submodule_search_locations or []) if package is not None else []:
        files += sorted(Path(folder).glob("*.py"))
    return " ".join(_sha256(file) for file in files)


@cache
def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def run_task(task: DriftTask) -> str:
    """Align and judge, unless the row is there; return a line about it."""
    fingerprint = task.fingerprint()
    if task.row_file.exists():
        row: dict[str, Any] = json.loads(task.row_file.read_text())
        if row["fingerprint"] == fingerprint:
            return f"{task.label}: is there"
    row = {
        "dive": task.dive,
        "kind": task.kind,
        "seed": task.seed,
        "ping_seed": task.ping_seed,
        "name": task.name,
        **_judged(task),
        "fingerprint": fingerprint,
    }
    _write(task.row_file, row)
    return f"{task.label}: {_line(row)}"


def _judged(task: DriftTask) -> dict[str, Any]:
    home, odometry = task.folder / task.dive, read_odometry_track(task.odometry)
    truth = read_tum(home / "truth.tum")
    gap = KINDS[task.kind].gap
    times_s = DIVES[task.dive].ping_times_s(gap=gap)
    before = track_errors(odometry, truth, times_s)
    figures: dict[str, Any] = {
        "recorded_s": float(times_s[-1] - times_s[0]),
        "odometry": _track_figures(before),
    }
    with tempfile.TemporaryDirectory(prefix="drift-") as folder:
        out = Path(folder)
        began_s, began_cpu_s = time.perf_counter(), time.process_time()
        try:
            task.align()(task.pings, task.odometry, task.config, out)
        except Exception:  # noqa: BLE001 the study goes on without this row
            return figures | {"failed": traceback.format_exc()}
        figures["wall_s"] = time.perf_counter() - began_s
        figures["cpu_s"] = time.process_time() - began_cpu_s
        verdict = json.loads((out / "verdict.json").read_text())
        figures |= {"corrected": verdict["corrected"], "because": verdict.get("because", "")}
        tum, loops_file = out / "trajectory.tum", out / "loops.csv"
        after = track_errors(read_tum(tum), truth, times_s)
        loops = loop_errors(read_loops(loops_file), truth) if loops_file.exists() else NO_LOOPS
        figures |= {
            "estimate": _track_figures(after),
            "ratio": after.rms_m / before.rms_m,
            "loops": dataclasses.asdict(loops),
        }
        if task.maps:
            figures["maps"] = _map_figures(task, before, after, tum, verdict["corrected"])
    return figures


NO_LOOPS = LoopErrors(0, 0, 0.0, 0.0, 0.0)


def _track_figures(errors: TrackErrors) -> dict[str, float]:
    return {
        "rms_m": errors.rms_m,
        "max_m": errors.max_m,
        "rms_deg": errors.rms_deg,
        "covered": errors.covered,
    }


def _map_figures(
    task: DriftTask, before: TrackErrors, after: TrackErrors, tum: Path, corrected: object
) -> dict[str, Any]:
    """Figures of the maps at true poses, at the odometry's and at the estimate's.

    The last two are the same where the odometry was kept.
    """
    label, config = f"{task.dive}-{task.ping_seed}", task.config
    surface = task.folder / task.dive / "surface.npy"
    true = _kept_map(
        task,
        f"{label}{'-gap' if KINDS[task.kind].gap else ''}-true",
        lambda: map_errors(task.pings, None, config, surface, np.eye(4)),
    )
    drifted = _kept_map(
        task,
        f"{task.label}-odometry",
        lambda: map_errors(task.pings, task.odometry, config, surface, before.anchor),
    )
    estimate = drifted
    if corrected:
        mapped = map_errors(task.pings, tum, config, surface, after.anchor)
        estimate = dataclasses.asdict(mapped)
    return {"true": true, "odometry": drifted, "estimate": estimate}


def _kept_map(task: DriftTask, label: str, judge: Callable[[], MapErrors]) -> dict[str, Any]:
    """Figures of a map that no aligner changes: those of its file, if its settings are the same."""
    path = task.folder / "maps" / f"{label}.json"
    parts = [
        msgspec.json.encode(task.config).decode(),
        _core_sha256(),
        _sha256(task.pings),
        _sha256(task.odometry) if label.endswith("odometry") else "",
        str(FIGURES_VERSION),
    ]
    fingerprint = hashlib.sha256("\n".join(parts).encode()).hexdigest()
    if path.exists():
        kept: dict[str, Any] = json.loads(path.read_text())
        if kept.pop("fingerprint") == fingerprint:
            return kept
    figures = dataclasses.asdict(judge())
    _write(path, figures | {"fingerprint": fingerprint})
    return figures


def _write(path: Path, content: Mapping[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    part = once(path)
    part.write_bytes(msgspec.json.format(msgspec.json.encode(content), indent=1))
    part.rename(path)


def _verdict(row: Row) -> str:
    if "failed" in row:
        return "failed: " + str(row["failed"]).strip().splitlines()[-1]
    return "corrected" if row["corrected"] else f"not corrected: {row['because']}"


def _line(row: Row) -> str:
    odometry_m = row["odometry"]["rms_m"]
    if "failed" in row:
        return f"odometry {odometry_m:.2f} m, {_verdict(row)}"
    return (
        f"odometry {odometry_m:.2f} m, estimate {row['estimate']['rms_m']:.2f} m, "
        f"{row['loops']['count']} loops, {_verdict(row)}"
    )


HEAD = (
    "dive",
    "kind",
    "seed",
    "odometry, m",
    "corrected, m",
    "ratio",
    "verdict",
    "loops",
    "wrong",
    "worst loop, m",
    "worst loop, deg",
    "map true / odometry / corrected, m",
    "s a s",
)


def table_of_rows(rows: Iterable[Row]) -> str:
    """One line a row: RMS errors, verdict, loops, medians of maps, CPU time by recorded time."""
    return table(HEAD, (_cells(row) for row in rows))


def _cells(row: Row) -> list[str]:
    seed = f"{row['seed']}" if row["ping_seed"] == PING_SEEDS[0] else f"{row['seed']}b"
    first = [row["dive"], row["kind"], seed, f"{row['odometry']['rms_m']:.2f}"]
    if "failed" in row:
        return [*first, "", "", _verdict(row), *[""] * 6]
    loops, maps = row["loops"], row.get("maps")
    medians = [f"{maps[kind]['median_m']:.2f}" for kind in maps] if maps else []
    return [
        *first,
        f"{row['estimate']['rms_m']:.2f}",
        f"{row['ratio']:.2f}",
        _verdict(row),
        f"{loops['count']}",
        f"{loops['wrong']}",
        f"{loops['worst_m']:.2f}",
        f"{loops['worst_deg']:.1f}",
        " / ".join(medians),
        f"{row['cpu_s'] / row['recorded_s']:.3f}",
    ]


def summary_table(rows: Iterable[Row]) -> str:
    """One line for each dive and kind, over its seeds."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["dive"], row["kind"]), []).append(row)
    head = (
        "dive",
        "kind",
        "runs",
        "odometry, m",
        "corrected, m",
        "worst, m",
        "ratio",
        "worst ratio",
        "corrected",
        "worse",
        "loops",
        "wrong loops",
        "map true / odometry / corrected, m",
        "s a s",
    )
    return table(head, (_group_cells(*key, group) for key, group in groups.items()))


def _group_cells(dive: str, kind: str, rows: Sequence[Row]) -> list[str]:
    """Medians over the seeds, but for what is called worst, and for counts."""
    odometry_m = statistics.median(row["odometry"]["rms_m"] for row in rows)
    done = [row for row in rows if "failed" not in row]
    first = [dive, kind, f"{len(rows)}", f"{odometry_m:.2f}"]
    if not done:
        return [*first, *["failed"], *[""] * 9]
    estimate_m = [row["estimate"]["rms_m"] for row in done]
    ratios = [row["ratio"] for row in done]
    loops = [row["loops"] for row in done]
    maps = [row["maps"] for row in done if "maps" in row]
    medians = [
        f"{statistics.median(one[kind]['median_m'] for one in maps):.2f}"
        for kind in (maps[0] if maps else ())
    ]
    return [
        *first,
        f"{statistics.median(estimate_m):.2f}",
        f"{max(estimate_m):.2f}",
        f"{statistics.median(ratios):.2f}",
        f"{max(ratios):.2f}",
        f"{sum(row['corrected'] for row in done)} of {len(rows)}",
        f"{sum(ratio > WORSE_RATIO for ratio in ratios)}",
        f"{statistics.median(one['count'] for one in loops):.0f}",
        f"{sum(one['wrong'] for one in loops)}",
        " / ".join(medians),
        f"{statistics.median(row['cpu_s'] / row['recorded_s'] for row in done):.3f}",
    ]


def _simulate(args: argparse.Namespace) -> None:
    for seed, name in itertools.product(args.ping_seeds, args.dives):
        simulate(DIVES[name], args.folder, [seed])


def _run(args: argparse.Namespace) -> None:
    pairs = (text.partition("=") for text in args.set)
    settings = {setting: yaml.safe_load(value) for setting, _, value in pairs}
    tasks = [
        DriftTask(
            dive,
            kind,
            seed,
            ping_seed,
            args.align,
            args.name,
            settings,
            args.maps,
            args.folder,
        )
        for ping_seed in args.ping_seeds
        for seed in args.seeds
        for dive in args.dives
        for kind in args.kinds
    ]
    do_all(run_task, tasks, args.jobs, "run")
    rows = [json.loads(task.row_file.read_text()) for task in tasks]
    rows.sort(key=_order)
    print(table_of_rows(rows))
    print()
    print(summary_table(rows))


def _order(row: Row) -> tuple[int, int, int, int]:
    dives, kinds = list(DIVES), list(KINDS)
    return dives.index(row["dive"]), kinds.index(row["kind"]), row["ping_seed"], row["seed"]


def _report(args: argparse.Namespace) -> None:
    for name in args.name:
        paths = (args.folder / "rows" / name).glob("*.json")
        rows = [json.loads(path.read_text()) for path in paths]
        chosen = [row for row in rows if row["dive"] in args.dives and row["kind"] in args.kinds]
        chosen.sort(key=_order)
        print(f"{name}\n")
        if args.rows:
            print(f"{table_of_rows(chosen)}\n")
        print(f"{summary_table(chosen)}\n")


def main() -> None:
    """Do what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    commands = parser.add_subparsers(required=True)
    functions = {"simulate": _simulate, "run": _run, "report": _report}
    for name, function in functions.items():
        command = commands.add_parser(name)
        command.set_defaults(function=function)
        command.add_argument("--folder", type=Path, default=FOLDER, help="of all files")
        dives = list(DIVES) if name != "run" else [one for one in DIVES if one not in SITE_DIVES]
        command.add_argument("--dives", nargs="+", choices=DIVES, default=dives)
        if name != "report":
            seeds = list(PING_SEEDS) if name == "simulate" else [PING_SEEDS[0]]
            command.add_argument("--ping-seeds", nargs="+", type=int, default=seeds)
        if name != "simulate":
            command.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
        if name == "report":
            command.add_argument("--name", nargs="+", default=["align"], help="of aligners")
            command.add_argument("--rows", action="store_true", help="each run, not only medians")
        if name == "run":
            command.add_argument("--seeds", nargs="+", type=int, default=list(SEEDS))
            command.add_argument("--align", default=f"{__package__}.run:align_recording")
            command.add_argument("--name", default="align", help="of the aligner with its settings")
            command.add_argument(
                "--set", nargs="+", default=[], metavar="SETTING=VALUE", help="of the dive's"
            )
            command.add_argument("--no-maps", dest="maps", action="store_false")
            command.add_argument("--jobs", type=int, choices=(1, 2), default=1, help="processes")
    args = parser.parse_args()
    args.function(args)


if __name__ == "__main__":
    main()
