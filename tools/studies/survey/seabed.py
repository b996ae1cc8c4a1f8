"""The seabed of the survey: waves of sand with wrecks of boxes, barrels and pipes all over it.

It is a scene file of the simulator, so what lies where is known to the last triangle.
"""

import math
from typing import Any

import numpy as np

Tree = dict[str, Any]

DEPTH_M = 30.0
LONGEST_WAVE_M, SHORTEST_WAVE_M = 200.0, 8.0
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
                "longest_m": LONGEST_WAVE_M,
                "shortest_m": SHORTEST_WAVE_M,
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
