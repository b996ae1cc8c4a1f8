"""V17: what lies beyond the last row leaves the picture as it is."""

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sonar_sim.engine import Engine
from sonar_sim.scene.scene import Scene, Surface
from sonar_sim.validation.case import CaseResult, Check
from sonar_sim.validation.simple import (
    MEAN,
    floor,
    narrow_sonar,
    pose_at,
    rectangle,
    target,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RANGE_M = 10.0
PHYSICS = dataclasses.replace(MEAN, speckle=True, beam_width_rad=0.0175, range_spread=True)


def v17_no_wrap() -> CaseResult:
    """A loud target and a wall at 1.2 times the range."""
    alone = _picture(Scene((floor(-2.0),)))
    far = target((1.2 * RANGE_M, 0.0, 0.0))
    wall = _wall(1.2 * RANGE_M)
    checks = (
        Check("cells a target changes", 0.0, _changed(alone, Scene((floor(-2.0),), (far,))), 0.0),
        Check("cells a wall changes", 0.0, _changed(alone, Scene((floor(-2.0), wall))), 0.0),
    )
    return CaseResult("V17 no wrap-around", "nothing beyond the range is heard", checks, _draw)


def _wall(range_m: float) -> Surface:
    return dataclasses.replace(
        rectangle((range_m, 0.0, 0.0), (0.0, 40.0, 0.0), (0.0, 0.0, 4.0)), name="wall"
    )


def _picture(scene: Scene) -> NDArray[np.float32]:
    ping = Engine(scene, narrow_sonar(RANGE_M, 0.02)).ping(pose_at((0.0, 0.0, 0.0)), PHYSICS)
    return ping.amplitude


def _changed(alone: NDArray[np.float32], scene: Scene) -> float:
    return float(np.count_nonzero(_picture(scene) != alone))


def _draw(axes: "Axes") -> None:
    picture = _picture(Scene((floor(-2.0), _wall(1.2 * RANGE_M))))
    axes.imshow(20.0 * np.log10(np.maximum(picture, 1e-9)), aspect="auto", origin="lower")
    axes.set_xlabel("beam")
    axes.set_ylabel("row")
