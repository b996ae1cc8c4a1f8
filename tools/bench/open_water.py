"""Milliseconds a ping over open water, by range: nothing returns, and all of the fan is freed.

Prints, as JSON, the median milliseconds a ping of each range in metres.
"""

import statistics
import time

import msgspec
import numpy as np

from bench.inputs import SETTINGS
from bench.our_contender import config_of
from bench.scene import mounting, path
from mapperd.imaging.ping_image import PingImage
from mapperd.mapping.sonar_map import SonarMap
from oculus_driver.encode import bearing_table_cdeg

RANGES_M = (5.0, 10.0, 20.0, 40.0)
RESOLUTION_M = 0.1
PINGS = 12
PITCH_DEG = 10.0


def median_ms(range_m: float) -> float:
    """Of pings along the benchmark's path, into one map."""
    sonar = SETTINGS[0].sonar
    bearings_rad = np.radians(bearing_table_cdeg(sonar.beams, sonar.half_aperture_rad) / 100.0)
    silent = np.zeros((sonar.rows, sonar.beams), dtype=np.float32)
    echo = PingImage(silent, bearings_rad, range_m / sonar.rows)
    sonar_map = SonarMap(config_of("grid", RESOLUTION_M, carve_no_return=True))
    trajectory = path()
    times_ms = []
    for time_s in np.linspace(0.0, trajectory.duration_s, PINGS):
        pose = trajectory.pose(float(time_s)) @ mounting(PITCH_DEG).pose
        map_T_sonar = np.eye(4)  # noqa: N806 frames are named
        map_T_sonar[:3, :3], map_T_sonar[:3, 3] = pose.rotation, pose.position_m
        began_s = time.perf_counter()
        sonar_map.integrate(echo, map_T_sonar)
        times_ms.append(1e3 * (time.perf_counter() - began_s))
    return statistics.median(times_ms)


def main() -> None:
    """Measure and print."""
    times_ms = {f"{range_m:g}": median_ms(range_m) for range_m in RANGES_M}
    print(msgspec.json.encode(times_ms).decode())


if __name__ == "__main__":
    main()
