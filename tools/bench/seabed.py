"""Looking down: a straight survey line over a gently undulating seabed, with objects under it.

The seabed lies at 0.6 of the range, so that one scene serves every range; what lies farther to the
sides is in reach of the long one alone.
"""

import numpy as np
from sonar_sim import MATERIALS, FramePose, Motion, Mounting, Scene, Trajectory, Waypoint

from bench.shapes import (
    MEAN_DEPTH_M,
    Floats,
    ball,
    box,
    floor,
    floor_height_m,
    pile,
    surface,
)

DEPTH_M = 24.0
ALTITUDE_BY_RANGE = 0.6
SPEED_MPS = 0.5
PERIOD_S = 0.1
LINE_X_M = (-10.0, 10.0)
FLOOR_X_M = (-8.0, 8.0)
FLOOR_Y_M = (-30.0, 30.0)
PILLARS_M = ((0.0, 3.0, 0.3, 3.0), (0.5, -13.0, 0.5, 8.0))
"""x, y, radius, height."""
BALLS_M = ((0.2, -2.5, 0.8), (-0.5, 11.0, 1.5))
"""x, y, radius; they lie on the seabed."""
CAISSON_M = ((0.0, 6.0, -DEPTH_M), (2.0, 2.0, 2.4))
"""Middle and edges."""


def seabed() -> Scene:
    """Build the scene; the same every time."""
    pillars = [
        pile((x, y, height_m / 2.0 - DEPTH_M), radius_m, height_m)
        for x, y, radius_m, height_m in PILLARS_M
    ]
    balls = [ball((x, y, radius_m - DEPTH_M), radius_m) for x, y, radius_m in BALLS_M]
    objects = [*pillars, *balls, box(*CAISSON_M)]
    return Scene(
        (
            surface("floor", floor(FLOOR_X_M, FLOOR_Y_M, height_m), MATERIALS["sand"]),
            *(
                surface(f"object {i}", mesh, MATERIALS["overgrown_concrete"])
                for i, mesh in enumerate(objects, start=1)
            ),
        )
    )


def height_m(x_m: Floats, y_m: Floats) -> Floats:
    """Height of the seabed: the swells of the demo's harbour, deeper."""
    return floor_height_m(x_m, y_m) + (MEAN_DEPTH_M - DEPTH_M)


def poses(range_m: float, pings: int) -> list[FramePose]:
    """Of the sonar in the map: one each `PERIOD_S`, about the middle of the line."""
    z_m = ALTITUDE_BY_RANGE * range_m - DEPTH_M
    ends = [Waypoint(x_m, 0.0, z_m, 0.0) for x_m in LINE_X_M]
    line = Trajectory(ends, Motion(speed_mps=SPEED_MPS))
    mounted = Mounting(position_m=(0.0, 0.0, 0.0)).pose
    times_s = line.duration_s / 2.0 + PERIOD_S * (np.arange(pings) - (pings - 1) / 2.0)
    return [line.pose(float(t)) @ mounted for t in times_s]
