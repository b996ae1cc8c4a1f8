"""Draw the simulator's pages: `python -m studies simulator-pictures [--out docs/images]`."""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from sonar_sim.classic import classic_camera, classic_images
from sonar_sim.geometry.pose import FramePose, rotation_of
from sonar_sim.products import PingProducts, ProductRenderer
from sonar_sim.products.arrays import lookup_pixels, raw_scan, snr_arrays
from sonar_sim.products.images import fan_picture, label_picture, level_picture, normal_picture
from sonar_sim.raycast.depth_camera import DepthCamera, pinhole_of
from sonar_sim.scene.scenario import Scenario, sonar_pose
from sonar_sim.scene_file import load_scenario, scene_names
from sonar_sim.validation import tank
from sonar_sim.validation import tank as v20_tank
from sonar_sim.validation.recording import read_recording, simulate_floor, simulate_recording

from oculus_driver.render import Style

Picture = tuple[str, NDArray[Any]]
LOOKING_AHEAD = FramePose(np.array([1.5, -10.5, -3.6]), rotation_of(0.0, 0.16, np.pi / 2.0))
"""Over the harbour's floor, at the wreck, the piles and the quay."""
AHEAD_M = 17.0
FAN_PX = 640
COLUMN_IN, TITLE_IN = 4.4, 0.35
PLAIN = Style(height_px=FAN_PX, gamma=0.5, labels=False)


def main() -> None:
    """Draw all."""
    parser = argparse.ArgumentParser(description="Draw the simulator's pages.")
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    parser.add_argument("--recording", type=Path, help="public recording of three pings")
    arguments = parser.parse_args()
    out: Path = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    ahead = harbour_ahead()
    draw(out / "simulator-classic.png", classic_page(ahead), 2)
    draw(out / "simulator-products.png", product_page(ahead), 3)
    draw(out / "simulator-tank.png", tank_page(), 4)
    if arguments.recording is not None:
        draw(out / "simulator-recording.png", recording_page(arguments.recording), 3)
    draw(out / "simulator-pings.png", [scene_ping(name) for name in scene_names()], 3)


def recording_page(path: Path) -> list[Picture]:
    """A recorded ping beside its simulations, range upwards."""
    recorded = read_recording(path)
    pictures = (
        ("recorded: M1200d, 2.1 MHz, 2 m", recorded.pixels[0]),
        ("simulated from its echoes up to 1.3 m", simulate_recording(recorded, 1)[0]),
        ("simulated over an even floor", simulate_floor(recorded, 1)[0]),
    )
    return [(title, pixels[::-1]) for title, pixels in pictures]


def harbour_ahead() -> PingProducts:
    """One ping of the harbour from a pose that shows all of it."""
    scenario = load_scenario("harbour")
    sonar = replace(scenario.sonar, demanded_range_m=AHEAD_M, gain_percent=50.0)
    return one_ping(replace(scenario, sonar=sonar), LOOKING_AHEAD, 0.0)


def one_ping(scenario: Scenario, map_T_sonar: FramePose, time_s: float) -> PingProducts:  # noqa: N803
    """One ping of a scenario."""
    camera = pinhole_of(scenario.sonar)
    return ProductRenderer(scenario.scene, scenario.sonar, camera).at(map_T_sonar, time_s=time_s)


def classic_page(ours: PingProducts) -> list[Picture]:
    """The published pipeline above, the simulator below: the same scene from the same place."""
    camera = classic_camera()
    view = DepthCamera(ours.scene).look(camera, ours.map_T_sonar)
    theirs = classic_images(view.depth_m, camera.horizontal_rad)
    snr_db = lookup_pixels(ours.snr_db, view, ours.sonar)
    return [
        ("published pipeline: normals", theirs.normals),
        ("here: normals", rgb(normal_picture(view.normals))),
        ("published pipeline: SNR, on this frame's own scale", theirs.snr),
        ("here: expected SNR, -20 to 60 dB", rgb(level_picture(snr_db, "grey"))),
        ("published pipeline: fan, 17 m", theirs.fan),
        ("here: fan of an M750d, 17 m", rgb(fan_picture(ours, PLAIN))),
    ]


def product_page(ours: PingProducts) -> list[Picture]:
    """All products of one ping."""
    depth = ours.view.depth_m
    return [
        ("polar ping: rows x beams", np.sqrt(ours.level)),
        ("truth of its pixels: surface", rgb(label_picture(ours.truth.surface))),
        ("truth of its pixels: incidence", ours.truth.incidence_rad),
        ("depth", np.where(depth > 0.0, depth, np.nan)),
        ("normals", rgb(normal_picture(ours.view.normals))),
        ("SNR of what the camera sees", rgb(level_picture(snr_arrays(ours)["camera_db"]))),
        ("truth of the camera's pixels: surface", rgb(label_picture(ours.view.surface))),
        ("raw scan", np.sqrt(raw_scan(ours.level, ours.sonar))),
        ("fan picture", rgb(fan_picture(ours, Style(height_px=FAN_PX, gamma=0.5)))),
    ]


def tank_page() -> list[Picture]:
    """V20: each target in both bands."""
    return [
        (
            f"{target}, {v20_tank.band(mode).frequency_hz / 1e6:.1f} MHz",
            rgb(v20_tank.picture(target, mode)),
        )
        for mode in (1, 2)
        for target in tank.TARGETS
    ]


def scene_ping(name: str) -> Picture:
    """The ping in the middle of a scene's trajectory."""
    scenario = load_scenario(name)
    time_s = scenario.trajectory.duration_s / 2.0
    ping = one_ping(scenario, sonar_pose(scenario, time_s), time_s)
    return name, rgb(fan_picture(ping, PLAIN))


def draw(path: Path, pictures: Sequence[Picture], columns: int) -> None:
    """Lay pictures out in rows, each under its title, rows as high as their pictures."""
    rows = [pictures[start : start + columns] for start in range(0, len(pictures), columns)]
    heights = [max(p.shape[0] / p.shape[1] for _, p in row) * COLUMN_IN + TITLE_IN for row in rows]
    figure = Figure(figsize=(COLUMN_IN * columns, sum(heights)), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(rows), columns, squeeze=False, height_ratios=heights)
    colours = mpl.colormaps["gray"].with_extremes(bad=(0.08, 0.10, 0.13))
    for axes, (title, picture) in zip(grid.ravel(), pictures, strict=True):
        axes.imshow(picture, cmap=colours)
        axes.set_title(title, fontsize=10)
        axes.set_axis_off()
    figure.savefig(path, dpi=80)


def rgb(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Turn OpenCV's order of colours round."""
    return cv2.cvtColor(picture, cv2.COLOR_BGR2RGB).astype(np.uint8)


if __name__ == "__main__":
    main()
