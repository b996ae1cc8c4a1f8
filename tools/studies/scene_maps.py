"""Map every shipped scene and compare each map with the scene's truth: numbers and one picture.

Each scene's own survey is simulated with its vehicle's errors, mapped by `mapperd --replay`, and
measured as the demo is. What moves is no part of the truth: a map that shows it is wrong there.
"""

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import matplotlib as mpl
import msgspec
import numpy as np
import yaml
from demo.map_truth import (
    MapAccuracy,
    OccupiedVoxels,
    TrueSurface,
    accuracy_of,
    read_triangles,
    read_voxels,
)
from demo.picture import INK, WATER, Camera, cubes, draw_fan, read_ping, render
from demo.run import replay
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from sonar_sim import CaptureSettings, Scenario, load_scenario, scene_names, write_capture
from tqdm import tqdm

from oculus_driver.ping import Ping

PIXELS = (560, 400)
FIELD_OF_VIEW_DEG = 40.0
VIEWS_DEG = {"ship_hull": (-65.0, -28.0), "tank": (-100.0, 62.0), "open_water": (-150.0, 10.0)}
"""Azimuth and elevation of the eye about what was seen, where it is not the usual."""
USUAL_DEG = (-120.0, 32.0)
REACH = 0.62
"""Of the seen part's diagonal that has to fit beside its middle."""
WORST_M = 0.3
"""The error that is drawn reddest."""


@dataclass(frozen=True, slots=True, eq=False)
class ScenePanel:
    """What is drawn of one scene; the fields are those of `scene_maps.SceneMap`."""

    name: str
    truth_m: NDArray[np.float64]
    seen_m: NDArray[np.float64]
    voxels: OccupiedVoxels
    error_m: NDArray[np.float64]
    ping: Ping
    caption: str


def draw_panels(path: Path, panels: Sequence[ScenePanel]) -> None:
    """Write the picture: one row a scene."""
    figure = Figure(figsize=(15.0, 3.9 * len(panels)), facecolor=WATER)
    FigureCanvasAgg(figure)
    rows = figure.subplots(len(panels), 3, squeeze=False)
    for (left, middle, right), panel in zip(rows, panels, strict=True):
        _draw_row(left, middle, right, panel)
    figure.subplots_adjust(
        left=0.005, right=0.995, top=1.0 - 0.3 / (3.9 * len(panels)), bottom=0.004, wspace=0.02
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=80)


def _draw_row(left: Axes, middle: Axes, right: Axes, panel: ScenePanel) -> None:
    camera = _camera(panel)
    triangles_m = _facing_parts(panel)
    heights = _shades("viridis", triangles_m.mean(axis=1)[:, 2], panel.seen_m[:, 2])
    left.imshow(render(triangles_m, heights, camera, WATER))
    left.set_title(panel.name, color=INK)
    draw_fan(middle, panel.ping)
    share = np.clip(panel.error_m / WORST_M, 0.0, 1.0)
    colours = mpl.colormaps["RdYlGn_r"](np.repeat(share, 12))[:, :3]
    boxes = cubes(panel.voxels.centres_m, panel.voxels.edge_m)
    right.imshow(render(boxes, colours, camera, WATER))
    right.set_title(panel.caption, color=INK)
    for axes in (left, middle, right):
        axes.set_axis_off()


def _shades(
    name: str, values: NDArray[np.float64], scale: NDArray[np.float64]
) -> NDArray[np.float64]:
    low, high = float(scale.min()), float(scale.max())
    share = np.clip((values - low) / max(high - low, 0.5), 0.0, 1.0)
    colours = mpl.colormaps[name](0.25 + 0.75 * share)
    return np.array(colours[:, :3], dtype=np.float64)


def _facing_parts(panel: ScenePanel) -> NDArray[np.float64]:
    """The truth; where the eye is below, without what lies lower than what was seen of interest."""
    if VIEWS_DEG.get(panel.name, USUAL_DEG)[1] > 0.0:
        return panel.truth_m
    floor_m = panel.truth_m[..., 2].min() + 1.0
    above: NDArray[np.float64] = panel.truth_m[panel.truth_m[..., 2].max(axis=1) > floor_m]
    return above


def _camera(panel: ScenePanel) -> Camera:
    low, high = np.percentile(panel.seen_m, [1.0, 99.0], axis=0)
    middle, reach_m = (low + high) / 2.0, REACH * float(np.linalg.norm(high - low))
    azimuth, elevation = np.radians(VIEWS_DEG.get(panel.name, USUAL_DEG))
    distance_m = reach_m / math.tan(math.radians(FIELD_OF_VIEW_DEG / 2.0))
    towards = np.array(
        [
            math.cos(elevation) * math.cos(azimuth),
            math.cos(elevation) * math.sin(azimuth),
            math.sin(elevation),
        ]
    )
    eye = middle + distance_m * towards
    width, height = PIXELS
    x, y, z = (float(part) for part in eye)
    to_x, to_y, to_z = (float(part) for part in middle)
    return Camera((x, y, z), (to_x, to_y, to_z), width, height, FIELD_OF_VIEW_DEG)


ROOT = Path(__file__).resolve().parents[2]
PICTURE = ROOT / "docs" / "images" / "scene-maps.png"
MAX_PINGS = 300
EXACT_WITHIN_M = 0.5
VOXEL_M = 0.1
BOTH_WAYS = 2.0**0.5
"""A beam is so much wider one way than where half the power is left after both."""
STILL_M = 0.01
"""What was seen farther than this from all that stands still was a moving object."""


@dataclass(frozen=True, slots=True, eq=False)
class SceneMap:
    """One scene and its map.

    Attributes:
        scenario: what was surveyed.
        truth_m: triangles of what stands still, cut small, (F, 3, 3).
        seen_m: of it, what the sonar had in sight, (N, 3).
        voxels: the map.
        error_m: distance of each voxel's centre to the truth, (V,).
        accuracy: how well they fit.
    """

    scenario: Scenario
    truth_m: NDArray[np.float64]
    seen_m: NDArray[np.float64]
    voxels: OccupiedVoxels
    error_m: NDArray[np.float64]
    accuracy: MapAccuracy


def main(argv: Sequence[str] | None = None) -> int:
    """Map the scenes; 0 if every replay ran."""
    parser = argparse.ArgumentParser(prog="scene_maps", description=__doc__.partition("\n")[0])
    parser.add_argument("scenes", nargs="*", help="shipped names or files; all shipped if none")
    parser.add_argument("--out", type=Path, default=Path("out/scenes"), help="folder of results")
    parser.add_argument("--pings", type=int, default=MAX_PINGS, help="at most, of each scene")
    parser.add_argument("--picture", type=Path, default=PICTURE, help="PNG to write")
    args = parser.parse_args(argv)
    panels = []
    for name in args.scenes or scene_names():
        scenario = _thinned(load_scenario(name), args.pings)
        out: Path = args.out / scenario.name
        made = map_scene(scenario, out)
        if made is None:
            return 1
        print(f"{scenario.name}: {made.accuracy.sentences()}\n", flush=True)
        panels.append(_panel(made, out))
    draw_panels(args.picture, panels)
    print(f"picture: {args.picture}")
    return 0


def map_scene(scenario: Scenario, out: Path) -> SceneMap | None:
    """Simulate, map and measure one scene; None if the replay failed."""
    out.mkdir(parents=True, exist_ok=True)
    with tqdm(desc=scenario.name, unit="ping", disable=None) as bar:

        def progress(done: int, of: int) -> None:
            bar.total = of
            bar.update(done - bar.n)

        seen = write_capture(out / "capture.bin", scenario, CaptureSettings(), progress)
    scenario.scene.save(out / "scene.ply", seen.points_m)
    config = out / "config.yaml"
    config.write_text(yaml.safe_dump(config_of(scenario)))
    if replay(out, config) != 0:
        return None
    surface = TrueSurface(read_triangles(out / "scene.ply"), EXACT_WITHIN_M)
    still = surface.distance_m(seen.points_m) < STILL_M
    voxels = read_voxels(out / "map.ply")
    seen_m = seen.points_m[still]
    error_m = surface.distance_m(voxels.centres_m)
    accuracy = accuracy_of(voxels.centres_m, voxels.edge_m, error_m, seen_m)
    (out / "accuracy.json").write_bytes(msgspec.json.format(msgspec.json.encode(asdict(accuracy))))
    return SceneMap(scenario, surface.triangles_m, seen_m, voxels, error_m, accuracy)


def config_of(scenario: Scenario) -> dict[str, object]:
    """Mapperd's settings for a scenario's sonar and mounting; all else by default."""
    mounting, sonar = scenario.mounting, scenario.sonar
    x, y, z = mounting.position_m
    return {
        "sonar": {
            "horizontal_fov": round(float(np.degrees(2.0 * sonar.half_aperture_rad)), 3),
            "vertical_aperture": round(float(np.degrees(sonar.vertical_width_rad)) / BOTH_WAYS, 1),
        },
        "mounting": {
            "position": {"x": x, "y": y, "z": z},
            "orientation": {
                "roll": mounting.roll_deg,
                "pitch": mounting.pitch_deg,
                "yaw": mounting.yaw_deg,
            },
        },
        "octree": {"voxel_resolution": VOXEL_M},
    }


def _thinned(scenario: Scenario, max_pings: int) -> Scenario:
    """The same survey with no more pings than asked for, evenly spread."""
    rate_hz = min(scenario.ping_rate_hz, max_pings / scenario.trajectory.duration_s)
    return replace(scenario, ping_rate_hz=rate_hz)


def _panel(made: SceneMap, out: Path) -> ScenePanel:
    accuracy = made.accuracy
    pings = int(made.scenario.trajectory.duration_s * made.scenario.true_ping_rate_hz)
    return ScenePanel(
        name=made.scenario.name,
        truth_m=made.truth_m,
        seen_m=made.seen_m,
        voxels=made.voxels,
        error_m=made.error_m,
        ping=read_ping(out / "capture.bin", pings // 3),
        caption=f"{accuracy.median_m:.2f} m median, {accuracy.p95_m:.2f} m 95 %; "
        f"{accuracy.coverage:.0%} mapped",
    )


if __name__ == "__main__":
    sys.exit(main())
