"""Map every shipped scene and compare each map with the scene's truth: numbers and one picture.

Each scene's own survey is simulated with its vehicle's errors, mapped by `mapperd --replay`, and
measured as the demo is. What moves is no part of the truth: a map that shows it is wrong there.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import msgspec
import numpy as np
import yaml
from demo.map_truth import MapAccuracy, accuracy_of
from demo.picture import read_ping
from demo.ply_points import VoxelCloud, read_voxels
from demo.run import replay
from demo.true_surface import TrueSurface, read_triangles
from numpy.typing import NDArray
from sonar_sim import CaptureSettings, Scenario, load_scenario, scene_names, write_capture
from tqdm import tqdm

from studies.scene_maps_picture import Panel, draw_panels

ROOT = Path(__file__).resolve().parents[2]
PICTURE = ROOT / "docs" / "images" / "scene-maps.png"
MOST_PINGS = 300
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
    voxels: VoxelCloud
    error_m: NDArray[np.float64]
    accuracy: MapAccuracy


def main(argv: Sequence[str] | None = None) -> int:
    """Map the scenes; 0 if every replay ran."""
    parser = argparse.ArgumentParser(prog="scene_maps", description=__doc__.partition("\n")[0])
    parser.add_argument("scenes", nargs="*", help="shipped names or files; all shipped if none")
    parser.add_argument("--out", type=Path, default=Path("out/scenes"), help="folder of results")
    parser.add_argument("--pings", type=int, default=MOST_PINGS, help="at most, of each scene")
    parser.add_argument("--picture", type=Path, default=PICTURE, help="PNG to write")
    said = parser.parse_args(argv)
    panels = []
    for name in said.scenes or scene_names():
        scenario = _thinned(load_scenario(name), said.pings)
        out: Path = said.out / scenario.name
        made = map_scene(scenario, out)
        if made is None:
            return 1
        print(f"{scenario.name}: {made.accuracy.sentences()}\n", flush=True)
        panels.append(_panel(made, out))
    draw_panels(said.picture, panels)
    print(f"picture: {said.picture}")
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


def _thinned(scenario: Scenario, most_pings: int) -> Scenario:
    """The same survey with no more pings than asked for, evenly spread."""
    rate_hz = min(scenario.ping_rate_hz, most_pings / scenario.trajectory.duration_s)
    return replace(scenario, ping_rate_hz=rate_hz)


def _panel(made: SceneMap, out: Path) -> Panel:
    accuracy = made.accuracy
    pings = int(made.scenario.trajectory.duration_s * made.scenario.true_ping_rate_hz)
    return Panel(
        name=made.scenario.name,
        truth_m=made.truth_m,
        seen_m=made.seen_m,
        voxels=made.voxels,
        error_m=made.error_m,
        ping=read_ping(out / "capture.bin", pings // 3),
        caption=f"{accuracy.occupied_voxels} voxels: {accuracy.median_m:.2f} m median, "
        f"{accuracy.p95_m:.2f} m 95 %; {accuracy.coverage:.0%} of what was seen is mapped",
    )


if __name__ == "__main__":
    sys.exit(main())
