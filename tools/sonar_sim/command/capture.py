"""`sonar-sim capture`: a scene's survey as a recording, faster than real time."""

import argparse
import os
import sys
import time
from pathlib import Path

from tqdm import tqdm

from oculus_driver.command_line import ExitCode
from sonar_sim.capture import CaptureSettings, write_capture
from sonar_sim.command.arguments import count, seed
from sonar_sim.scene_file import load_scenario

NAME = "capture"
HELP = "record a scene's survey: sonar bytes and odometry, as a vehicle's links deliver them"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add = parser.add_argument
    add("scene", metavar="SCENE", help="name of a shipped scene, or a YAML file")
    add("--out", metavar="FILE", type=Path, required=True, help="the recording (MCAP)")
    add("--seen", metavar="NPZ", type=Path, help="also save the visible surface")
    add("--seed", type=seed, default=CaptureSettings().seed, help="seed of all random numbers")
    processes = os.cpu_count() or 1
    add(
        "--processes",
        metavar="N",
        type=count,
        default=processes,
        help="processes to use; FILE does not depend on it",
    )


def run(args: argparse.Namespace) -> int:
    """Record, with a progress bar."""
    scenario = load_scenario(args.scene)
    settings = CaptureSettings(seed=args.seed, processes=args.processes)
    began_s = time.perf_counter()
    with tqdm(unit="ping", file=sys.stderr, disable=None) as bar:

        def progress(done: int, of: int) -> None:
            bar.total = of
            bar.update(done - bar.n)

        seen = write_capture(args.out, scenario, settings, progress)
    wall_s = time.perf_counter() - began_s
    if args.seen is not None:
        seen.save(args.seen)
    path_s = scenario.trajectory.duration_s
    print(
        f"{args.out}: {args.out.stat().st_size / 1e6:.1f} MB, {path_s:.1f} s simulated "
        f"in {wall_s:.1f} s ({path_s / wall_s:.1f} times as fast)"
    )
    return ExitCode.OK
