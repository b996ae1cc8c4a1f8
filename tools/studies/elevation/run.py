"""Simulate the dives, map each with every contender, and report.

Usage: python -m studies elevation simulate [--dives NAME ...] [--seeds 1 2 3] [--jobs 2]
       python -m studies elevation run [--dives ...] [--seeds ...] [--contenders NAME ...]
           [--with NAME SETTING=VALUE ...] [--voxel 0.05] [--pose-noise] [--jobs 2]
       python -m studies elevation report [--contenders NAME ...] [--write]
       python -m studies elevation recording FILE [--write]

What is there is not done again: dives that are simulated, and rows of the same settings, core,
dive and figures. A row is a file, `rows/CONTENDER/DIVE-SEED-VOXELmm-POSES.json`.
"""

import argparse
import hashlib
import json
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import yaml
from numpy.typing import NDArray
from tqdm import tqdm

from mapperd.config.loader import config_of
from mapperd.config.tree import Config
from mapperd.mapping.sonar_map import SonarMap
from studies.accuracy_cost.mapping.dives import once
from studies.elevation.dives import DIVES, DiveData, cache_of, load, simulate
from studies.elevation.measures import ChangeWatch, TrueGrid, measure, truth_of
from studies.report import IMAGES
from studies.runner import do_all

__all__ = [
    "CONTENDERS",
    "Mapped",
    "Task",
    "contender_config",
    "map_dive",
    "noisy_poses",
    "run_task",
]

Floats = NDArray[np.float64]

Contender = Mapping[str, object]

ARC = {"mapping.rule": "arc"}

CONTENDERS: dict[str, Contender] = {
    "iwlo": {},
    "arc": ARC,
    "arc, refined": ARC | {"refine": True},
    "arc, level 34": ARC | {"arc.level": 34.0},
    "arc, all levels": ARC | {"arc.broad_share": 0.99},
    "arc, unprotected": ARC | {"arc.max_ratio": 1.0},
    "arc, narrow beam": ARC | {"arc.beam_width": 9.0},
    "arc, a tenth missed": ARC | {"arc.missed_share": 0.1},
}
"""Settings that differ from the defaults, by dotted name; with `refine`, the map is refined at the
end. The first contender is what others stand beside: its observed voxels are those of
`..._common`."""

FIGURES_VERSION = 4
"""Counts up when `measures` changes what a figure means."""
POSITION_NOISE_M, ATTITUDE_NOISE_DEG = 0.05, 0.5
FOLDER = Path("out/elevation")
SEEDS = (1, 2, 3)
VOXEL_M = 0.1


def contender_config(overrides: Contender, edge_m: float) -> Config:
    """The settings of a contender for voxels of an edge.

    Raises:
        ConfigError: there is no such setting, or the value is not allowed.
    """
    tree: dict[str, Any] = {"octree": {"voxel_resolution": edge_m}}
    for name, value in overrides.items():
        if name == "refine":
            continue
        *sections, field = name.split(".")
        place = tree
        for section in sections:
            place = place.setdefault(section, {})
        place[field] = value
    return config_of(tree, "contender")


@dataclass(frozen=True, slots=True, eq=False)
class Mapped:
    """A map and what it took.

    Attributes:
        map: the result.
        cpu_ms: (N,) CPU time of each ping, with its share of the refining.
    """

    map: SonarMap
    cpu_ms: Floats


def map_dive(
    data: DiveData,
    config: Config,
    poses: Floats | None = None,
    watch: ChangeWatch | None = None,
    *,
    refine: bool = False,
) -> Mapped:
    """Map a dive ping by ping.

    Args:
        data: the dive.
        config: the map's settings.
        poses: map_T_sonar to map with, (N, 4, 4); None takes the true ones.
        watch: looks at the map after each ping.
        refine: integrate all pings once more at the end.
    """
    if refine:
        with tempfile.TemporaryDirectory() as folder:
            return _mapped(data, config, poses, watch, Path(folder))
    return _mapped(data, config, poses, watch, None)


def _mapped(
    data: DiveData,
    config: Config,
    poses: Floats | None,
    watch: ChangeWatch | None,
    log: Path | None,
) -> Mapped:
    sonar_map = SonarMap(config)
    if log is not None:
        sonar_map.keep_pings(log)
    cpu_ms = []
    for i, pose in enumerate(data.map_T_sonar if poses is None else poses):
        image = data.ping(i)
        began_s = time.process_time()
        sonar_map.integrate(image, pose)
        cpu_ms.append(1e3 * (time.process_time() - began_s))
        if watch is not None:
            watch(i, sonar_map)
    began_s = time.process_time()
    for _ in sonar_map.refine():
        pass
    again_ms = 1e3 * (time.process_time() - began_s) / len(data)
    if watch is not None:
        watch.look_again(sonar_map)
    return Mapped(sonar_map, np.array(cpu_ms) + again_ms)


def noisy_poses(poses: Floats, seed: int, position_m: float, attitude_deg: float) -> Floats:
    """Poses (N, 4, 4) with independent errors of each ping, standard deviations a axis."""
    rng = np.random.default_rng([seed, 1])
    noisy = poses.copy()
    noisy[:, :3, 3] += position_m * rng.standard_normal((len(poses), 3))
    x, y, z = np.radians(attitude_deg) * rng.standard_normal((3, len(poses)))
    zero = np.zeros_like(x)
    skew = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    left, _, right = np.linalg.svd(np.eye(3) + skew)  # the nearest rotation
    noisy[:, :3, :3] = poses[:, :3, :3] @ left @ right
    return noisy


@dataclass(frozen=True, slots=True)
class Task:
    """A dive of a seed to be mapped by contenders.

    Attributes:
        dive, seed: which.
        contenders: settings of each by name.
        edge_m: of a voxel.
        noise: whether poses have errors of 5 cm and 0.5 degrees.
        folder: of all files.
    """

    dive: str
    seed: int
    contenders: Mapping[str, Contender]
    edge_m: float
    noise: bool
    folder: Path

    @property
    def label(self) -> str:
        """Name of its files."""
        poses = "noisy" if self.noise else "true"
        return f"{self.dive}-{self.seed}-{1000 * self.edge_m:g}mm-{poses}"

    def row_file(self, contender: str) -> Path:
        """Where the row of a contender is."""
        return self.folder / "rows" / contender.replace(" ", "_") / f"{self.label}.json"

    @property
    def common_file(self) -> Path:
        """Where it is kept which voxels the first contender observed."""
        return self.folder / f"common-{self.label}.npz"

    def fingerprint(self, config: Config, *, refine: bool) -> str:
        """Of everything that the row depends on."""
        dive_file = _sha256(cache_of(DIVES[self.dive], self.seed, self.folder))
        parts = [msgspec.json.encode(config).decode(), _core_sha256(), dive_file, str(refine)]
        return hashlib.sha256("\n".join([*parts, str(FIGURES_VERSION)]).encode()).hexdigest()


@cache
def _core_sha256() -> str:
    """Of the compiled core."""
    spec = find_spec("mapperd._core")
    return _sha256(Path(spec.origin)) if spec is not None and spec.origin is not None else ""


@cache
def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def run_task(task: Task) -> list[str]:
    """Map a dive with the first of `CONTENDERS` and its own; return the names of new rows."""
    first = next(iter(CONTENDERS))
    contenders = {first: CONTENDERS[first], **task.contenders}
    configs = {name: contender_config(own, task.edge_m) for name, own in contenders.items()}
    missing = [name for name in contenders if not _is_there(task, name, contenders[name])]
    if not missing:
        return []
    dive, data = DIVES[task.dive], load(DIVES[task.dive], task.seed, task.folder)
    truth = truth_of(dive, task.edge_m, task.folder)
    poses = data.map_T_sonar
    if task.noise:
        poses = noisy_poses(poses, task.seed, POSITION_NOISE_M, ATTITUDE_NOISE_DEG)
    for name in missing:
        watch = None
        if dive.change is not None:
            watch = ChangeWatch(dive, data, task.edge_m, task.folder)
        refine = "refine" in contenders[name]
        mapped = map_dive(data, configs[name], poses, watch, refine=refine)
        common = _common(task, mapped.map if name == first else None, truth)
        seen_m = data.seen_m if watch is None else watch.staying_m
        row: dict[str, object] = {
            "dive": task.dive,
            "seed": task.seed,
            "contender": name,
            "edge_m": task.edge_m,
            "poses": "noisy" if task.noise else "true",
            "fingerprint": task.fingerprint(configs[name], refine=refine),
            **measure(truth, seen_m, mapped.map, common),
            "pings": len(data),
            "cpu_ms": float(mapped.cpu_ms.mean()),
            **({} if watch is None else watch.figures()),
        }
        path = task.row_file(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        part = once(path)
        part.write_bytes(msgspec.json.format(msgspec.json.encode(row), indent=1))
        part.rename(path)
    return missing


def _is_there(task: Task, name: str, contender: Contender) -> bool:
    path = task.row_file(name)
    if not path.exists():
        return False
    config, refine = contender_config(contender, task.edge_m), "refine" in contender
    wanted = task.fingerprint(config, refine=refine)
    return bool(json.loads(path.read_text())["fingerprint"] == wanted)


def _common(task: Task, first: SonarMap | None, truth: TrueGrid) -> NDArray[np.bool_]:
    """Which voxels the first contender observed: of its map if it is at hand, else of its file."""
    if first is not None:
        observed = np.zeros(truth.solid.shape, dtype=np.bool_)
        observed[truth.place(first.core.voxels()[0])] = True
        part = once(task.common_file)
        with part.open("wb") as file:
            np.savez_compressed(file, observed=observed)
        part.rename(task.common_file)
    with np.load(task.common_file) as archive:
        common: NDArray[np.bool_] = archive["observed"]
    return common


def _simulate(args: argparse.Namespace) -> None:
    jobs = [(name, seed, args.folder) for seed in args.seeds for name in args.dives]
    do_all(_simulate_one, jobs, args.jobs, "dive")


def _simulate_one(job: tuple[str, int, Path]) -> str:
    name, seed, folder = job
    with tqdm(desc=f"{name} {seed}", unit="ping", disable=None, leave=False) as bar:

        def progress(done: int, of: int) -> None:
            bar.total = of
            bar.update(done - bar.n)

        simulate(DIVES[name], seed, folder, progress)
    return f"{name} {seed}"


def _run(args: argparse.Namespace) -> None:
    chosen = {name: CONTENDERS[name] for name in args.contenders or CONTENDERS}
    for name, *settings in args.own:
        chosen[name] = {
            setting: yaml.safe_load(value)
            for setting, _, value in (text.partition("=") for text in settings)
        }
    tasks = [
        Task(name, seed, chosen, args.voxel, args.pose_noise, args.folder)
        for seed in args.seeds
        for name in args.dives
    ]
    do_all(_run_one, tasks, args.jobs, "dive")


def _run_one(task: Task) -> str:
    return f"{task.label}: {', '.join(run_task(task)) or 'nothing new'}"


def _report(args: argparse.Namespace) -> None:
    from studies.elevation.report import write_report  # noqa: PLC0415 imports this module

    write_report(args.folder, args.contenders, write=args.write)


def _recording(args: argparse.Namespace) -> None:
    from studies.elevation.report import draw_recording  # noqa: PLC0415 imports this module

    folder = IMAGES if args.write else args.folder
    draw_recording(args.file, folder / "elevation-recording.png")


def main() -> None:
    """Do what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    commands = parser.add_subparsers(required=True)
    functions = {"simulate": _simulate, "run": _run, "report": _report, "recording": _recording}
    for name, function in functions.items():
        command = commands.add_parser(name)
        command.set_defaults(function=function)
        command.add_argument("--folder", type=Path, default=FOLDER, help="of all files")
        if name in ("report", "recording"):
            command.add_argument("--write", action="store_true", help="into docs/")
        if name == "report":
            command.add_argument("--contenders", nargs="+", default=[], help="all if none is given")
            continue
        if name == "recording":
            command.add_argument("file", type=Path, help="messages of a sonar at rest")
            continue
        command.add_argument("--dives", nargs="+", choices=DIVES, default=list(DIVES))
        command.add_argument("--seeds", nargs="+", type=int, default=list(SEEDS))
        command.add_argument("--jobs", type=int, default=1, help="processes")
        if name == "run":
            command.add_argument("--contenders", nargs="+", choices=CONTENDERS)
            command.add_argument(
                "--with",
                dest="own",
                nargs="+",
                action="append",
                default=[],
                metavar=("NAME", "SETTING=VALUE"),
                help="one more contender",
            )
            command.add_argument("--voxel", type=float, default=VOXEL_M, help="edge in metres")
            command.add_argument(
                "--pose-noise", action="store_true", help="poses err by 5 cm and 0.5 degrees"
            )
    args = parser.parse_args()
    args.function(args)


if __name__ == "__main__":
    main()
