"""Make the survey's dives: recordings, their scenes, and the survey files that name them.

    PYTHONPATH=tools python -m studies survey-dives --out out/survey

Leaves `dives/NAME.mcap` and `.yaml`, `survey.yaml` and `mapperd.yaml`; with `--damage` also
`damaged/`, `damaged.yaml` and `damage.json`. After a stop, what was finished is kept.
"""

import argparse
import heapq
import json
import multiprocessing
import os
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import yaml
from sonar_sim import load_scenario
from sonar_sim.capture import EPOCH_NS, POWER_UP_S, CaptureSettings, ping_times_s
from sonar_sim.scene.scenario import Scenario, sonar_motion, sonar_pose
from sonar_sim.scene.vehicle import SimulatedOdometry, in_order_of_arrival, odometry_record
from sonar_sim.simulator import Simulator
from sonar_sim.wire import Network, compass_heading_deg, delivered, ping_message
from tqdm import tqdm

from oculus_driver.recording import OCULUS, ODOMETRY_NATIVE, RecordingWriter
from studies.survey.dives import FULL, PING_RATE_HZ, SMALL, SimulatedDive, SurveyPlan, dives

if TYPE_CHECKING:
    from multiprocessing.sharedctypes import Synchronized


MIDDLE = (0.3, 0.7)
"""Of the file, in which damage is done: some is always before it, and some behind."""

FLIPS = 20
PIECE = 1 << 20


class Damage(msgspec.Struct, frozen=True):
    """What was done to a copy.

    Attributes:
        copy: its path.
        kind: `cut` or `flips`.
        places: bytes from the file's start: of the cut, or of each flipped byte, sorted.
    """

    copy: Path
    kind: str
    places: tuple[int, ...]


def cut(recording: Path, copy: Path, seed: int) -> Damage:
    """Copy what comes before a random byte."""
    generator = np.random.default_rng([seed, 3])
    place = int(generator.uniform(*MIDDLE) * recording.stat().st_size)
    copy.parent.mkdir(parents=True, exist_ok=True)
    with recording.open("rb") as source, copy.open("wb") as out:
        left = place
        while piece := source.read(min(left, PIECE)):
            out.write(piece)
            left -= len(piece)
    return Damage(copy, "cut", (place,))


def flip(recording: Path, copy: Path, seed: int, flips: int = FLIPS) -> Damage:
    """Copy all, and invert all bits of random bytes."""
    generator = np.random.default_rng([seed, 4])
    low, high = (int(part * recording.stat().st_size) for part in MIDDLE)
    places = sorted(int(p) for p in generator.choice(high - low, size=flips, replace=False) + low)
    copy.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(recording, copy)
    with copy.open("r+b") as file:
        for place in places:
            file.seek(place)
            byte = file.read(1)[0]
            file.seek(place)
            file.write(bytes([byte ^ 0xFF]))
    return Damage(copy, "flips", tuple(places))


VOXEL_M = 0.1
ORIGIN = {"latitude": 53.5, "longitude": 8.1}

SETTINGS: dict[str, Any] = {
    "octree": {"voxel_resolution": VOXEL_M},
    "mounting": {
        "position": {"x": 0.3, "y": 0.0, "z": -0.4},
        "orientation": {"roll": 0.0, "pitch": 90.0, "yaw": 0.0},
    },
}
"""Those of config/survey.yaml, but for coarser voxels, and how the simulated sonar is mounted."""

CONFIGURATION = "mapperd.yaml"


def write_survey(folder: Path, recordings: Sequence[Path], name: str = "survey.yaml") -> Path:
    """Write a survey file and, beside it, the configuration that it names.

    Args:
        folder: of both; recordings are named from here.
        recordings: one a dive, called by their stems.
        name: of the survey file.
    """
    configuration = folder / CONFIGURATION
    configuration.write_text(yaml.safe_dump(SETTINGS, sort_keys=False), encoding="utf-8")
    survey: Mapping[str, Any] = {
        "configuration": CONFIGURATION,
        "origin": ORIGIN,
        "dives": [
            {"name": recording.stem, "recording": str(recording.relative_to(folder))}
            for recording in recordings  # all in the frame of the beacons that they navigate by
        ],
    }
    path = folder / name
    path.write_text(yaml.safe_dump(survey, sort_keys=False), encoding="utf-8")
    return path


ELEVATIONS = 64
NODES_PER_BEAM = 2.0

Progress = Callable[[int, int], None]
"""Called with the pings done and the pings in all."""
Arrival = tuple[float, str, bytes]


def record(dive: SimulatedDive, folder: Path, progress: Progress | None = None) -> Path:
    """Write `NAME.yaml`, the scene, and `NAME.mcap`; a recording that is there is kept.

    The recording is there whole or not at all. Equal dives give equal bytes.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path, scene = folder / f"{dive.name}.mcap", folder / f"{dive.name}.yaml"
    text = json.dumps(dive.scene, indent=1)  # YAML too, and without the aliases of a dumper
    if path.exists() and scene.exists() and scene.read_text(encoding="utf-8") == text:
        return path
    path.unlink(missing_ok=True)
    scene.write_text(text, encoding="utf-8")
    unfinished = path.with_suffix(".part")
    _write(unfinished, dive, load_scenario(scene), progress)
    unfinished.replace(path)
    return path


def _write(path: Path, dive: SimulatedDive, scenario: Scenario, progress: Progress | None) -> None:
    start_ns = EPOCH_NS + round(dive.start_s * 1e9)
    pings = _sonar_link(dive, scenario, progress)
    odometry = _odometry_link(dive, scenario, start_ns)
    with RecordingWriter(path, overwrite=True) as recording:
        links = {
            "sonar": recording.add_link("sonar", OCULUS),
            "odometry": recording.add_link("odometry", ODOMETRY_NATIVE),
        }
        for time_s, name, data in heapq.merge(pings, odometry, key=lambda arrival: arrival[0]):
            recording.write(links[name], data, start_ns + round(time_s * 1e9))


def _sonar_link(
    dive: SimulatedDive, scenario: Scenario, progress: Progress | None
) -> Iterator[Arrival]:
    sonar, water = scenario.sonar, scenario.scene.water
    simulator = Simulator(
        scenario.scene,
        sonar,
        dive.seed,
        threads=1,
        elevations=ELEVATIONS,
        nodes_per_beam=NODES_PER_BEAM,
    )
    generator = np.random.default_rng([dive.seed, 2])
    times_s = ping_times_s(scenario, CaptureSettings())
    listening_s = 2.0 * sonar.range_m / water.speed_of_sound_mps
    for number, time_s in enumerate(times_s):
        ping = simulator.ping(
            sonar_pose(scenario, time_s), number, time_s, sonar_motion(scenario, time_s)
        )
        message = ping_message(
            ping.image.astype(np.uint8, copy=False),
            ping_id=number,
            start_time_s=POWER_UP_S + time_s,
            heading_deg=compass_heading_deg(scenario.trajectory.pose(time_s).rotation),
            sonar=sonar,
            water=water,
        )
        for arrival_s, piece in delivered(message, time_s + listening_s, Network(), generator):
            yield arrival_s, "sonar", piece
        if progress is not None:
            progress(number + 1, len(times_s))


def _odometry_link(dive: SimulatedDive, scenario: Scenario, start_ns: int) -> Iterator[Arrival]:
    odometry = SimulatedOdometry(scenario.trajectory, scenario.vehicle, dive.seed)
    for sample in in_order_of_arrival(odometry.samples()):
        record = odometry_record(sample, start_ns + round(sample.time_s * 1e9))
        yield sample.arrival_s, "odometry", record


PLANS = {"full": FULL, "small": SMALL}
POLL_INTERVAL_S = 0.5
"""How often the progress bar looks."""

_done: "list[Synchronized[int]]" = []
"""Pings of all processes, in a worker process."""


def make(folder: Path, plan: SurveyPlan, processes: int) -> list[Path]:
    """Record all dives of a plan that are not there yet; returns the recordings, in time."""
    todo = dives(plan)
    if processes == 1:
        recordings = [record(dive, folder / "dives") for dive in todo]
    else:
        recordings = record_all(todo, folder / "dives", processes)
    write_survey(folder, recordings)
    return recordings


def damage(folder: Path, recordings: Sequence[Path], seed: int) -> list[Damage]:
    """Cut a copy of the first recording and flip bytes in one of the second."""
    first, second, *others = recordings
    done = [
        cut(first, folder / "damaged" / f"{first.stem}.mcap", seed),
        flip(second, folder / "damaged" / f"{second.stem}.mcap", seed),
    ]
    write_survey(folder, [*(one.copy for one in done), *others], "damaged.yaml")
    (folder / "damage.json").write_bytes(msgspec.json.encode(done, enc_hook=str))
    return done


def record_all(todo: Sequence[SimulatedDive], folder: Path, processes: int) -> list[Path]:
    """Record dives in processes of their own, with a progress bar; what fails ends it soon."""
    # Forking would copy the threads' locks of whatever runs here; spawning does not.
    context = multiprocessing.get_context("spawn")
    done = context.Value("q", 0)
    pool = ProcessPoolExecutor(processes, context, _start, (done,))
    pings = sum(round(dive.duration_s * PING_RATE_HZ) for dive in todo)
    with pool, tqdm(total=pings, unit="ping", file=sys.stderr, disable=None) as bar:
        waiting = futures = [pool.submit(_record, dive, folder) for dive in todo]
        while waiting:
            over, left = wait(waiting, POLL_INTERVAL_S, FIRST_COMPLETED)
            if any(not future.cancelled() and future.exception() for future in over):
                pool.shutdown(wait=False, cancel_futures=True)
            waiting = [future for future in left if not future.cancelled()]
            bar.update(done.value - bar.n)
        return [future.result() for future in futures]


def _start(done: "Synchronized[int]") -> None:
    _done.append(done)


def _record(dive: SimulatedDive, folder: Path) -> Path:
    counted = 0

    def progress(pings: int, _of: int) -> None:
        nonlocal counted
        with _done[0].get_lock():
            _done[0].value += pings - counted
        counted = pings

    return record(dive, folder, progress)


def main(argv: Sequence[str] | None = None) -> int:
    """Make them."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    add = parser.add_argument
    add("--out", type=Path, default=Path("out/survey"), metavar="DIR")
    add("--scale", choices=list(PLANS), default="full", help="(default: full, two hours)")
    add("--beams", type=int, choices=(256, 512), help="of the sonar, in place of the scale's")
    add("--processes", type=int, default=os.cpu_count() or 1, help="change nothing in the files")
    add("--damage", action="store_true", help="also damage copies of the first two recordings")
    args = parser.parse_args(argv)
    plan: SurveyPlan = PLANS[args.scale]
    if args.beams is not None:
        plan = replace(plan, beams=args.beams)
    recordings = make(args.out, plan, args.processes)
    size_mb = sum(path.stat().st_size for path in recordings) / 1e6
    print(f"{args.out / 'survey.yaml'}: {len(recordings)} dives, {size_mb:.0f} MB")
    if args.damage:
        for one in damage(args.out, recordings, plan.seed):
            print(f"{one.copy}: {one.kind} at {', '.join(map(str, one.places))}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
