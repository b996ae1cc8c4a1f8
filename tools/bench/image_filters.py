"""What the filters on an image cost, take away and leave: the tables of docs/reports/mapping.md.

A simulated M750d (512 beams, 625 rows, 10 m) over sand and in the harbour, at three pitches;
stripes of Rayleigh amplitude are added. A return is a sample above the threshold.
"""

import argparse
import math
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from sonar_sim import MATERIALS, FramePose, Scene, Simulator, SonarSettings, Surface, load_scenario
from sonar_sim.geometry.pose import rotation_of

from mapperd.config.tree import CrosstalkConfig, RobotDetectionConfig, TerrainDetectionConfig
from mapperd.imaging.crosstalk import notched, without_stripes
from mapperd.imaging.robots import find_robots, terrain_of

THRESHOLD = 35.0
STRIPES = ((400, 3, 120.0), (550, 2, 60.0))
PITCHES_DEG = (30, 60, 90)

Image = NDArray[np.float32]


def sand() -> Scene:
    """A level floor 4.5 m below the sonar."""
    corners = np.array([[-60.0, -60], [60, -60], [60, 60], [-60, 60]])
    vertices = np.column_stack([corners, np.full(4, -6.0)])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return Scene((Surface("floor", vertices, faces, MATERIALS["sand"]),))


def with_stripes(image: Image) -> Image:
    """Both stripes, of random phase to what is there."""
    generator = np.random.default_rng(3)
    out = image.copy()
    for row, thickness, level in STRIPES:
        stripe = level * generator.rayleigh(math.sqrt(2 / math.pi), (thickness, image.shape[1]))
        out[row : row + thickness] = np.minimum(np.hypot(out[row : row + thickness], stripe), 255)
    return out


def median_ms(work: Callable[[], object], times: int) -> float:
    """Median of so many runs."""
    took_s = []
    for _ in range(times):
        began_s = time.perf_counter()
        work()
        took_s.append(time.perf_counter() - began_s)
    return 1e3 * float(np.median(took_s))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=50, help="runs of each (default: 50)")
    times = parser.parse_args().times
    sonar = SonarSettings()
    edge = math.sin(sonar.half_aperture_rad)
    bearings = np.asarray(np.arcsin(np.linspace(-edge, edge, sonar.beams)), dtype=np.float64)
    filters: dict[str, Callable[[Image], Image]] = {
        "crosstalk": lambda image: without_stripes(image, bearings, CrosstalkConfig(), THRESHOLD),
        "notch": lambda image: notched(image, CrosstalkConfig()),
    }
    print("| scene, pitch | filter | echoes lost without a stripe | stripes left | echoes lost |")
    print("|---|---|---:|---:|---:|")
    striped = np.zeros((0, 0), dtype=np.float32)
    for name, scene in (("sand", sand()), ("harbour", load_scenario("harbour").scene)):
        simulator = Simulator(scene, sonar, 1)
        for pitch_deg in PITCHES_DEG:
            pose = FramePose(np.array([0, 0, -1.5]), rotation_of(0.0, math.radians(pitch_deg), 0.0))
            image = simulator.ping(pose, 1).image.astype(np.float32)
            striped = with_stripes(image)
            true = image > THRESHOLD
            false = (striped > THRESHOLD) & ~true
            for title, work in filters.items():
                plain, out = work(image) > THRESHOLD, work(striped) > THRESHOLD
                numbers = (1 - plain[true].mean(), out[false].mean(), 1 - out[true].mean())
                cells = " | ".join(f"{100 * number:.1f} %" for number in numbers)
                print(f"| {name}, {pitch_deg}° | {title} | {cells} |")
    robots, terrain = RobotDetectionConfig(keep_out=True), TerrainDetectionConfig()
    timed: dict[str, Callable[[], object]] = {
        "crosstalk": lambda: filters["crosstalk"](striped),
        "notch": lambda: filters["notch"](striped),
        "robots": lambda: find_robots(striped, bearings, 0.016, robots),
        "robots kept out": lambda: terrain_of(striped, terrain, robots),
    }
    print("\n| filter | ms an image |\n|---|---:|")
    for title, timed_work in timed.items():
        print(f"| {title} | {median_ms(timed_work, times):.1f} |")


if __name__ == "__main__":
    main()
