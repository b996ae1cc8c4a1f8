"""V19: equal seed, pose and scene give equal bytes, whatever the number of threads."""

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sonar_sim.engine import Engine
from sonar_sim.scene.scene import Scene
from sonar_sim.validation.case import CaseResult, Check
from sonar_sim.validation.simple import (
    CHALK,
    MEAN,
    floor,
    narrow_sonar,
    pose_at,
    sphere,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PHYSICS = dataclasses.replace(
    MEAN, speckle=True, beam_width_rad=0.0175, range_spread=True, noise_level_db=90.0, tvg=True
)


def v19_determinism() -> CaseResult:
    """One to five threads; another ping; another seed."""
    first = _picture(threads=1)
    checks = [
        Check(f"cells that {n} threads change", 0.0, _differing(first, _picture(threads=n)), 0.0)
        for n in (1, 2, 3, 5)
    ]
    share = _differing(first, _picture(seed=1)) / first.size
    checks.append(Check("share that another seed changes", 1.0, share, 0.01))
    return CaseResult("V19 determinism", "bytes compared", tuple(checks), _draw)


def _picture(threads: int = 2, seed: int = 0) -> NDArray[np.float32]:
    scene = Scene((floor(-2.0), sphere((5.0, 0.0, 0.0), 0.5, CHALK)))
    engine = Engine(scene, narrow_sonar(10.0, 0.01, 128), seed, threads)
    return engine.ping(pose_at((0.0, 0.0, 0.0)), PHYSICS, ping_id=3).amplitude


def _differing(one: NDArray[np.float32], other: NDArray[np.float32]) -> float:
    return float(np.count_nonzero(one != other))


def _draw(axes: "Axes") -> None:
    difference = _picture(threads=1) - _picture(threads=2)
    axes.imshow(difference, aspect="auto", origin="lower", vmin=-1.0, vmax=1.0)
    axes.set_xlabel("beam")
    axes.set_ylabel("row")
