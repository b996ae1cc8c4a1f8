"""`sonar-sim list`: the scenes that are shipped."""

import argparse

from sonar_sim.command.arguments import OK
from sonar_sim.scene_file import load_scenario, scene_names

NAME = "list"
HELP = "list the shipped scenes"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what may be said."""
    parser.add_argument("--names", action="store_true", help="names alone, one a line")


def run(arguments: argparse.Namespace) -> int:
    """Tell each scene's name, sonar, size and description."""
    for name in scene_names():
        if arguments.names:
            print(name)
            continue
        scenario = load_scenario(name)
        triangles = sum(len(surface.faces) for surface in scenario.scene.surfaces)
        sonar = scenario.sonar
        print(
            f"{name:12}  {sonar.model} mode {sonar.mode}, {sonar.range_m:.3g} m"
            f"  {triangles:7d} triangles  {scenario.description}"
        )
    return OK
