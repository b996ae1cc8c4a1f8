"""A room with pillars, a vehicle in it whose odometry drifts, and what its sonar sees.

The room is a grid, 12 m x 9 m; beams are cast in it, each a bright wall at its range. The truth is
an ellipse driven once round and a part again; the odometry is 5 % too long and turns away.
"""

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mapperd.localization.map_io import write_nav2_map
from mapperd.localization.maps import FREE, OCCUPIED, GridMap
from mapperd.localization.models import core_grid
from mapperd.localization.particle_filter import RangeMap
from tests.mapperd.conftest import make_odometry, make_ping

Floats = NDArray[np.float64]

CELL_M = 0.1
ROWS, BEAMS, ROW_M = 80, 65, 0.1
BEARINGS_CDEG = np.linspace(-6000, 6000, BEAMS).round().astype(np.int16)
PERIOD_S = 0.2


def room() -> GridMap:
    cells = np.full((90, 120), FREE, np.int8)
    cells[:2] = cells[-2:] = OCCUPIED
    cells[:, :2] = cells[:, -2:] = OCCUPIED
    for row, column in ((20, 30), (30, 85), (60, 60), (66, 20), (70, 100), (44, 58)):
        cells[row : row + 5, column : column + 5] = OCCUPIED
    cells[2:25, 48:52] = OCCUPIED
    return GridMap(cells, CELL_M, -6.0, -4.5)


@dataclass(frozen=True, slots=True, eq=False)
class Dive:
    """Poses (N, 3) of x, y, yaw: true and by odometry; the deviation (N,) of x and y it states."""

    truth: Floats
    odometry: Floats
    deviation_m: Floats | None = None


def dive(steps: int = 120) -> Dive:
    phase = np.linspace(0, 2 * math.pi * steps / 100, steps)
    x, y = 4.0 * np.cos(phase), 2.7 * np.sin(phase)
    yaw = np.unwrap(np.arctan2(2.7 * np.cos(phase), -4.0 * np.sin(phase)))
    truth = np.column_stack([x, y, yaw])
    odometry = [truth[0]]
    for before, now in itertools.pairwise(truth):
        turn = odometry[-1][2] - before[2]
        c, s = math.cos(turn), math.sin(turn)
        dx, dy = 1.05 * (now - before)[:2]
        step = np.array([c * dx - s * dy, s * dx + c * dy, now[2] - before[2] + 0.002])
        odometry.append(odometry[-1] + step)
    return Dive(truth, np.array(odometry))


def images(grid: GridMap, poses: Floats) -> list[NDArray[np.uint8]]:
    """(ROWS, BEAMS) of each pose, the nearest row first."""
    bearings = np.radians(BEARINGS_CDEG / 100)
    rays = [[x, y, yaw - bearing] for x, y, yaw in poses for bearing in bearings]
    ranges = RangeMap(core_grid(grid)).cast(np.array(rays), ROWS * ROW_M)
    found = []
    for row in np.asarray(ranges).reshape(len(poses), BEAMS):
        image = np.zeros((ROWS, BEAMS), np.uint8)
        for beam, range_m in enumerate(row):
            if 0 < range_m < (ROWS - 4) * ROW_M:
                first = int(range_m / ROW_M)
                image[first : first + 3, beam] = 200
        found.append(image)
    return found


def pings(grid: GridMap, poses: Floats) -> Iterator[bytes]:
    for k, image in enumerate(images(grid, poses)):
        yield make_ping(
            k + 1,
            image=image,
            range_m=ROWS * ROW_M,
            range_resolution_m=ROW_M,
            bearings_cdeg=BEARINGS_CDEG,
            start_time=50 + PERIOD_S * k,
        )


def events(grid: GridMap, track: Dive) -> list[tuple[str, bytes, float]]:
    """As `write_recording` takes them; each ping's odometry is of its own moment."""
    found: list[tuple[str, bytes, float]] = []
    for k, data in enumerate(pings(grid, track.truth)):
        for dt in (-0.02, 0.05):
            x, y, yaw = track.odometry[k].tolist()
            stated = {}
            if track.deviation_m is not None:
                variances = np.diag([track.deviation_m[k] ** 2] * 2 + [1e-4] * 4)
                stated["pc"] = tuple(variances[np.triu_indices(6)].tolist())
            record = make_odometry(
                p=(x, y, 0.0), q=(math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)), **stated
            )
            found.append(("odometry", record, PERIOD_S * k + dt + 1))
        found.append(("ping", data, PERIOD_S * k + 1))
    return sorted(found, key=lambda event: event[2])


def settings(map_path: Path | str, **ours: object) -> str:
    """YAML of a vehicle that knows where it begins."""
    reported = "".join(f", {name}: {value}" for name, value in ours.items())
    return (
        "octree: {voxel_resolution: 0.1}\nmounting: {orientation: {pitch: 0}}\n"
        "sonar: {vertical_aperture: 4}\n"
        "amcl: {set_initial_pose: true, initial_pose_x: 4.0, initial_pose_a: 1.5707963,\n"
        "  initial_cov_xx: 0.02, initial_cov_yy: 0.02, initial_cov_aa: 0.003,\n"
        "  min_particles: 300, max_particles: 1000, update_min_d: 0.15, update_min_a: 0.1,\n"
        "  odom_alpha1: 0.02, odom_alpha2: 0.02, odom_alpha3: 0.02, odom_alpha4: 0.02,\n"
        "  recovery_alpha_slow: 0, recovery_alpha_fast: 0,\n"
        "  laser_sigma_hit: 0.1, laser_max_range: 8.0}\n"
        f"localization: {{mode: track, map_path: '{map_path}'{reported}}}\n"
    )


def write_room(folder: Path) -> Path:
    path = folder / "room.yaml"
    write_nav2_map(room(), path)
    return path


Recorder = Callable[[Path, list[tuple[str, bytes, float]]], list[int]]
