"""Facts of localization as tests want them."""

import math
from typing import Any

import numpy as np

from mapperd.config.tree import AmclConfig
from mapperd.geometry.gaussian import Belief, PlanarGaussian
from mapperd.localization.known_map import KnownMap
from mapperd.localization.maps import FREE, OCCUPIED, UNKNOWN, GridMap
from mapperd.localization.odom_correction import MapFromOdom
from mapperd.localization.particle_filter import Cluster
from mapperd.localization.status import LocalizationSnapshot, diagnose

STAMP_NS = 1_700_000_000_000_000_000


def gaussian(x_m: float = 1.0, y_m: float = 2.0, yaw_rad: float = 0.5, std: float = 0.1) -> Any:
    return PlanarGaussian(x_m, y_m, yaw_rad, np.diag([std**2, (2 * std) ** 2, 0.01**2]))


def known(path: str = "/maps/tank.yaml") -> KnownMap:
    """A walled tank of 8 m by 6 m from -1, -1 on, and nothing around it."""
    cells = np.full((80, 100), UNKNOWN, np.int8)
    cells[10:70, 10:90] = OCCUPIED
    cells[11:69, 11:89] = FREE
    return KnownMap(path, "00", GridMap(cells, 0.1, -2.0, -2.0))


def snapshot(
    elsewhere: float | None = 0.0, *, std: float = 0.1, **more: Any
) -> LocalizationSnapshot:
    """A status whose belief has this share elsewhere; None has no belief yet."""
    best = gaussian(std=std)
    belief = None
    if elsewhere is not None:
        masses = np.array([1 - elsewhere, elsewhere])
        belief = Belief(best, gaussian(1.5), masses, elsewhere, 80.0)
    rng = np.random.default_rng(1)
    particles = np.column_stack([rng.normal((1, 2, 0.5), 0.1, (200, 3)), np.full(200, 1 / 200)])
    values: dict[str, Any] = {
        "state": "localizing",
        "counts": {"moved": 3, "no_filter": 1},
        "updates": 3,
        "stamp_ns": None if belief is None else STAMP_NS,
        "belief": belief,
        "clusters": () if belief is None else (Cluster(1 - elsewhere, best),),  # type: ignore[operator]
        "transform": MapFromOdom(STAMP_NS + 10**9, 3.0, -4.0, math.pi / 2),
        "odom": None,
        "pose": None,
        "odom_ns": None,
        "sure": belief is not None,
        "diagnosis": diagnose(None if belief is None else best, AmclConfig()),
        "warning": None,
        "particle_count": 5000,
        "particles": particles,
        "scan_points_m": np.array([[5.0, 2.0, 0.0], [np.nan, 0.0, 0.0]]),
        "known": known(),
    }
    return LocalizationSnapshot(**values | more)
