"""`sonar-sim render`: what the sonar hears in a scene, as pictures, arrays and points."""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from oculus_driver.command_line import ExitCode
from oculus_driver.render import COLOURS, Style
from sonar_sim.classic import classic_camera
from sonar_sim.classic.scan import RANGE_M
from sonar_sim.classic.writer import write_classic
from sonar_sim.command.arguments import count, names, pose, positive, seed, size, time_on
from sonar_sim.effects.plan import AUTO
from sonar_sim.errors import SonarSimError
from sonar_sim.geometry.pose import FramePose
from sonar_sim.products import PRODUCTS, ProductRenderer, write_products
from sonar_sim.products.writer import ProductSettings
from sonar_sim.raycast.depth_camera import DepthCamera, pinhole_of
from sonar_sim.scene.scenario import Scenario, sonar_motion, sonar_pose
from sonar_sim.scene_file import load_scenario

NAME = "render"
HELP = "write pings of a scene with their ground truth as PNG, NPZ and PLY"

PUBLISHED_NAMES = {
    "point_cloud": "points",
    "image_depth": "depth",
    "image_depth_normals": "normals",
    "image_depth_multibeam": "snr",
    "image_depth_raw_sonar": "raw_scan",
    "image_depth_sonar": "fan",
}
"""Product by its topic of the published plugin."""

HEIGHT_PX, COLOUR_MAP = 900, "inferno"

Draw = Callable[[Path, int, float, FramePose], list[Path]]
"""Writes a ping into a folder: number, time, and the sonar's pose."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add = parser.add_argument
    add("scene", metavar="SCENE", help="a shipped scene's name, or a YAML file")
    add("--out", metavar="DIR", type=Path, required=True)
    add("--mode", choices=("physical", "classic"), default="physical")
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--pings", metavar="N", type=count, default=1, help="pings along the trajectory"
    )
    where.add_argument("--time", metavar="S", type=float, help="one ping at this time")
    where.add_argument(
        "--pose", metavar="X,Y,Z,ROLL,PITCH,YAW", type=pose, help="one ping at this pose"
    )
    add("--only", metavar="A,B", type=names, default=(), help=f"products: {', '.join(PRODUCTS)}")
    add(
        "--effects",
        help="auto, all, none or names, separated by commas; then +name and -name (default: auto)",
    )
    add(
        "--range",
        metavar="M",
        type=positive,
        dest="range_m",
        help="range (default: the scene's; classic: 17)",
    )
    add("--seed", metavar="N", type=seed, default=0)
    add("--camera", metavar="WxH", type=size, help="pixels of the depth and normal images")
    add("--height", metavar="PX", type=count, help="height of the fan picture (default: 900)")
    add("--scan-rows", metavar="N", type=count, default=400, help="rows of the raw scan")
    add("--colours", choices=tuple(COLOURS), help="colours of the fan picture (default: inferno)")


def run(args: argparse.Namespace) -> int:
    """Write, one folder a ping if there are several."""
    scenario = load_scenario(args.scene)
    args.only = tuple(PUBLISHED_NAMES.get(name, name) for name in args.only)
    if args.range_m is not None and args.mode == "physical":
        sonar = replace(scenario.sonar, demanded_range_m=args.range_m)
        scenario = replace(scenario, sonar=sonar)
    stops = list(_stops(args, scenario))
    files: list[Path] = []
    make = _classic if args.mode == "classic" else _physical
    draw = make(args, scenario)
    for ping_id, (time_s, map_T_sonar) in enumerate(tqdm(stops, unit="ping", disable=None)):  # noqa: N806
        folder = args.out / f"{ping_id:06d}" if len(stops) > 1 else args.out
        files += draw(folder, ping_id, time_s, map_T_sonar)
    print(f"{len(files)} files in {args.out}")
    return ExitCode.OK


def _stops(args: argparse.Namespace, scenario: Scenario) -> Iterator[tuple[float, FramePose]]:
    """Time and sonar's pose of each ping, evenly over the trajectory."""
    if args.pose is not None:
        yield 0.0, args.pose
        return
    share = (np.arange(args.pings) + 0.5) / args.pings
    times_s = share * scenario.trajectory.duration_s
    if args.time is not None:
        times_s = np.array([time_on(scenario.trajectory, args.time)])
    for time_s in times_s:
        yield float(time_s), sonar_pose(scenario, float(time_s))


def _physical(args: argparse.Namespace, scenario: Scenario) -> Draw:
    """The simulator's own products."""
    camera = pinhole_of(scenario.sonar)
    if args.camera is not None:
        camera = replace(camera, width=args.camera[0], height=args.camera[1])
    sounder = ProductRenderer(
        scenario.scene, scenario.sonar, camera, args.seed, effects=args.effects or AUTO
    )
    style = Style(height_px=args.height or HEIGHT_PX, colours=args.colours or COLOUR_MAP)
    look = ProductSettings(style, args.scan_rows)

    def draw(folder: Path, ping_id: int, time_s: float, map_T_sonar: FramePose) -> list[Path]:  # noqa: N803
        moving = None if args.pose is not None else sonar_motion(scenario, time_s)
        sounding = sounder.at(map_T_sonar, ping_id, time_s, moving)
        return write_products(folder, sounding, args.only, look)

    return draw


def _classic(args: argparse.Namespace, scenario: Scenario) -> Draw:
    """The published pipeline's products, from the same place.

    Raises:
        SonarSimError: an option that the pipeline has nothing for.
    """
    for option in ("effects", "height", "colours"):
        if getattr(args, option) is not None:
            raise SonarSimError(f"--{option} has no effect in classic mode")
    range_m = args.range_m or RANGE_M
    width, height = args.camera or (760, 169)
    camera = classic_camera(width, height, far_m=range_m)

    def draw(folder: Path, ping_id: int, time_s: float, map_T_sonar: FramePose) -> list[Path]:  # noqa: N803
        view = DepthCamera(scenario.scene, time_s).look(camera, map_T_sonar)
        seed = args.seed + ping_id
        return write_classic(folder, view, seed, args.only, rows=args.scan_rows, range_m=range_m)

    return draw
