"""`sonar-sim list`: the scenes that are shipped."""

import argparse

from oculus_driver.command_line import ExitCode
from sonar_sim.scene_file import load_scenario, scene_names

NAME = "list"
HELP = "list the shipped scenes"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--names", action="store_true", help="print names only, one per line")


def run(args: argparse.Namespace) -> int:
    """Print each scene's name, sonar, size and description."""
    for name in scene_names():
        if args.names:
            print(name)
            continue
        scenario = load_scenario(name)
        triangles = sum(len(surface.faces) for surface in scenario.scene.surfaces)
        sonar = scenario.sonar
        print(
            f"{name:12}  {sonar.model} mode {sonar.mode}, {sonar.range_m:.3g} m"
            f"  {triangles:7d} triangles  {scenario.description}"
        )
    return ExitCode.OK
