"""Which dives a survey has: lawnmower lines next to each other, and some dives across them."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from sonar_sim.scene_file.objects import path_of
from sonar_sim.scene_file.schema import PathSection

Tree = dict[str, Any]

DEPTH_M = 30.0
MAX_WAVE_M, MIN_WAVE_M = 200.0, 8.0
RELIEF_M = 0.6
CELL_M = 2.0
"""Of the floor's triangles; a quarter of the shortest wave."""

AREA_PER_OBJECT_M2 = 2500.0
"""One in a square of fifty metres: every ping but a few has none or one in sight."""

_SHAPES: tuple[tuple[str, Tree, str], ...] = (
    ("container", {"kind": "box", "size_m": [6.1, 2.4, 2.6]}, "rusty_steel"),
    ("crate", {"kind": "box", "size_m": [1.5, 1.2, 1.0]}, "wood"),
    ("boulder", {"kind": "sphere", "radius_m": [1.2, 0.9, 0.8]}, "rock"),
    ("pile", {"kind": "cylinder", "radius_m": 0.4, "height_m": 5.0}, "overgrown_concrete"),
    (
        "pipe",
        {"kind": "capsule", "start_m": [-6, 0, 0], "end_m": [6, 0, 0], "radius_m": 0.3},
        "overgrown_steel",
    ),
)


def seabed(x_m: tuple[float, float], y_m: tuple[float, float], seed: int) -> Tree:
    """Sections `water`, `terrain` and `objects` of a scene file.

    Args:
        x_m: from where to where the floor reaches eastward.
        y_m: and northward.
        seed: of the waves and of what lies where.
    """
    return {
        "water": {"temperature_c": 9, "salinity_ppt": 34, "depth_m": 25},
        "terrain": {
            "relief": {
                "kind": "procedural",
                "depth_m": DEPTH_M,
                "relief_m": RELIEF_M,
                "longest_m": MAX_WAVE_M,
                "shortest_m": MIN_WAVE_M,
                "seed": seed,
            },
            "x_m": list(x_m),
            "y_m": list(y_m),
            "cell_m": CELL_M,
            "material": "sand",
        },
        "objects": _objects(x_m, y_m, seed),
    }


def _objects(x_m: tuple[float, float], y_m: tuple[float, float], seed: int) -> list[Tree]:
    """By turns one of each shape, anywhere and turned by chance."""
    generator = np.random.default_rng([seed, 1])
    area_m2 = (x_m[1] - x_m[0]) * (y_m[1] - y_m[0])
    made = []
    for k in range(math.ceil(area_m2 / AREA_PER_OBJECT_M2)):
        name, shape, material = _SHAPES[k % len(_SHAPES)]
        place = [generator.uniform(*x_m), generator.uniform(*y_m), 0.3]
        turned = generator.uniform(-180.0, 180.0)
        made.append(
            {
                "name": f"{name} {k}",
                "shape": shape,
                "material": material,
                "position_m": [round(float(v), 3) for v in place],
                "yaw_deg": round(float(turned), 3),
                "on_floor": True,
                "cell_m": 1.0,
            }
        )
    return made


SPEED_MPS = 2.5
"""As an AUV of some hundred kilograms goes."""

ALTITUDE_M = 6.0
RANGE_M = 12.0
"""The floor is seen out to 60 degrees from straight down, 21 m wide. From higher up an imaging
sonar's fan, 20 degrees thick, locates a level floor so poorly that most of its echoes come to lie
under it: 12 m up and looking 30 m far, a ping marks a thousand cubic metres."""

GAIN_PERCENT = 50
"""With it 2 % of the samples are above the threshold that is set by default."""

PING_RATE_HZ = 5.0
MARGIN_M = 30.0
"""Of the floor around the paths: more than the sonar reaches and a turn takes."""

PAUSE_S = 300.0
"""From a dive's end to the next one's start."""


@dataclass(frozen=True, slots=True)
class SurveyPlan:
    """What is dived.

    Attributes:
        along: dives along the first axis, each out on one line and back on the next.
        across: dives across them.
        leg_m: length of a line.
        spacing_m: from a dive's first line to the next one's.
        beside_m: from its last line to the next dive's first: less than a swath, so that dives
            overlap all along.
        beams: of the sonar, 256 or 512.
        seed: of the seabed, the noise and the odometry.
    """

    along: int = 8
    across: int = 2
    leg_m: float = 880.0
    spacing_m: float = 96.0
    beside_m: float = 8.0
    beams: int = 512
    seed: int = 1

    @property
    def width_m(self) -> float:
        """From the first line to the last."""
        return self.along * self.spacing_m - self.beside_m


FULL = SurveyPlan()
"""Ten dives of about twelve minutes, two hours in all, over 880 m times 760 m."""

SMALL = SurveyPlan(along=1, across=1, leg_m=4.0, spacing_m=6.0, beside_m=3.0, beams=256)
"""Two dives of seconds, for tests and first steps."""


@dataclass(frozen=True, slots=True)
class SimulatedDive:
    """One of a survey.

    Attributes:
        name: of its files.
        start_s: since the first dive's start.
        duration_s: of its path.
        scene: the scene file, of this dive's path.
        seed: of its noise and odometry.
    """

    name: str
    start_s: float
    duration_s: float
    scene: Tree
    seed: int


def dives(plan: SurveyPlan) -> list[SimulatedDive]:
    """All of a plan, in time."""
    made: list[SimulatedDive] = []
    start_s = 0.0
    spans = ((-MARGIN_M, plan.leg_m + MARGIN_M), (-MARGIN_M, plan.width_m + MARGIN_M))
    ground = seabed(*spans, plan.seed)
    for k, corners in enumerate(_paths(plan)):
        scene = {**ground, **_carried(plan, corners)}
        dive = SimulatedDive(
            f"dive-{k + 1:02}", start_s, _duration_s(scene), scene, 1000 * plan.seed + k
        )
        start_s += dive.duration_s + PAUSE_S
        made.append(dive)
    return made


Corner = tuple[float, float, float]
"""x, y (m) and heading (deg, unwrapped)."""


def _paths(plan: SurveyPlan) -> Iterator[list[Corner]]:
    """Out on one line and back on the next one to port; the heading turns there, not at the end."""
    for k in range(plan.along):
        near_m = k * plan.spacing_m
        far_m = near_m + plan.spacing_m - plan.beside_m
        yield _u_turn((0.0, near_m), (plan.leg_m, near_m), (plan.leg_m, far_m), (0.0, far_m), 0.0)
    for k in range(plan.across):
        right_m = plan.leg_m * (2 * k + 1.5) / (2 * plan.across)
        left_m = plan.leg_m * (2 * k + 0.5) / (2 * plan.across)
        top_m = plan.width_m
        yield _u_turn((right_m, 0.0), (right_m, top_m), (left_m, top_m), (left_m, 0.0), 90.0)


def _u_turn(
    start: tuple[float, float],
    first: tuple[float, float],
    second: tuple[float, float],
    end: tuple[float, float],
    heading_deg: float,
) -> list[Corner]:
    across_deg, back_deg = heading_deg + 90.0, heading_deg + 180.0
    return [
        (*start, heading_deg),
        (*first, heading_deg),
        (*first, across_deg),
        (*second, across_deg),
        (*second, back_deg),
        (*end, back_deg),
    ]


def _duration_s(scene: Tree) -> float:
    return path_of(msgspec.convert(scene["trajectory"], PathSection)).duration_s


def _carried(plan: SurveyPlan, corners: list[Corner]) -> dict[str, Any]:
    """Sections of the sonar, its mounting straight down, the path, and navigation by beacons."""
    depth_m = DEPTH_M - ALTITUDE_M
    return {
        "sonar": {
            "model": "M750d",
            "mode": 1,
            "range_m": RANGE_M,
            "beams": plan.beams,
            "ping_rate_hz": PING_RATE_HZ,
            "gain_percent": GAIN_PERCENT,
        },
        "mounting": {"position_m": [0.3, 0.0, -0.4], "pitch_deg": 90},
        "trajectory": {
            "speed_mps": SPEED_MPS,
            "waypoints": [
                {"position_m": [x_m, y_m, -depth_m], "yaw_deg": yaw} for x_m, y_m, yaw in corners
            ],
        },
        "vehicle": {
            "name": "survey AUV",
            "odometry": {"position_noise_m": 0.01, "attitude_noise_deg": 0.05},
        },
    }
