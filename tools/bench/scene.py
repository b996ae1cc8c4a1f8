"""Looking ahead: a path through a harbour basin with something in sight at 30 m.

The demo's harbour ends 8 m from its middle; a survey that looks ahead at 30 m needs more of the
same: a sandy floor 4 m below the sonar, quays on two sides, rows of piles before them, and caissons
on the floor.
"""

import math

import numpy as np
from sonar_sim import MATERIALS, FramePose, Motion, Mounting, Scene, Trajectory, Waypoint

from bench.shapes import box, floor, floor_height_m, pile, surface

FLOOR_X_M = (-30.0, 28.0)
FLOOR_Y_M = (-28.0, 30.0)
SONAR_Z_M = -2.5
"""4 m above the mean floor."""
QUAY_X_M, QUAY_Y_M = 27.0, 29.0
PITCH_DEG = {10.0: 25.0, 30.0: 10.0}
"""By range: the tilt that an operator would choose."""
PILE_RADIUS_M = 0.3
PILES_XY_M = (
    *((22.0, float(y)) for y in range(-20, 24, 4)),
    *((float(x), 24.0) for x in range(-18, 22, 4)),
    *((6.5, -3.5), (8.0, 5.5), (12.0, 1.0), (1.5, 10.0)),
)
CAISSONS_M = (
    ((10.0, -4.0, -6.0), (3.0, 2.0, 2.6)),
    ((15.0, 9.0, -6.0), (4.0, 4.0, 3.4)),
    ((-4.0, 16.0, -6.0), (5.0, 3.0, 3.0)),
    ((5.0, 15.0, -6.0), (2.0, 2.0, 2.0)),
)
"""Centres and edges."""


def basin() -> Scene:
    """Build the scene; the same every time."""
    piles = [
        surface(
            f"pile {i}", pile((x, y, -4.0), PILE_RADIUS_M, 8.0), MATERIALS["overgrown_concrete"]
        )
        for i, (x, y) in enumerate(PILES_XY_M, start=1)
    ]
    caissons = [
        surface(f"caisson {i}", box(centre_m, edges_m), MATERIALS["overgrown_concrete"])
        for i, (centre_m, edges_m) in enumerate(CAISSONS_M, start=1)
    ]
    east = box((QUAY_X_M + 0.5, 0.0, -4.0), (1.0, 60.0, 8.0))
    north = box((0.0, QUAY_Y_M + 0.5, -4.0), (60.0, 1.0, 8.0))
    return Scene(
        (
            surface("floor", floor(FLOOR_X_M, FLOOR_Y_M, floor_height_m), MATERIALS["sand"]),
            surface("east quay", east, MATERIALS["sheet_piling"]),
            surface("north quay", north, MATERIALS["sheet_piling"]),
            *piles,
            *caissons,
        )
    )


def mounting(pitch_deg: float) -> Mounting:
    """A sonar that looks ahead, tilted down."""
    return Mounting(position_m=(0.0, 0.0, 0.0), pitch_deg=pitch_deg)


def path() -> Trajectory:
    """Ten metres: one straight ahead, then a quarter turn to port."""
    radius_m = 9.0 / (math.pi / 2.0)
    turn = [
        Waypoint(
            1.0 + radius_m * math.sin(math.radians(yaw_deg)),
            radius_m * (1.0 - math.cos(math.radians(yaw_deg))),
            SONAR_Z_M,
            yaw_deg,
        )
        for yaw_deg in range(0, 91, 10)
    ]
    return Trajectory([Waypoint(0.0, 0.0, SONAR_Z_M, 0.0), *turn], Motion(speed_mps=0.5))


def poses(range_m: float, pings: int) -> list[FramePose]:
    """Of the sonar in the map, evenly along the path."""
    trajectory, mounted = path(), mounting(PITCH_DEG[range_m]).pose
    times_s = np.linspace(0.0, trajectory.duration_s, pings)
    return [trajectory.pose(float(t)) @ mounted for t in times_s]
