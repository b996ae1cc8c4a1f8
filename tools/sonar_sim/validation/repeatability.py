"""Validation against fixed results: the classic pipeline, equal bytes (V18, V19)."""

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sonar_sim.classic import classic_camera, classic_images, defects, pipeline, scan
from sonar_sim.engine import PingEngine
from sonar_sim.scene.scene import Scene
from sonar_sim.validation.case import ValidationCheck, ValidationResult
from sonar_sim.validation.setups import (
    CHALK,
    MEAN,
    floor,
    narrow_sonar,
    pose_at,
    sphere,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.axes import Axes

ON_AXIS = np.zeros(1, dtype=np.float32)


def v18_classic() -> ValidationResult:
    """Focal lengths, the plan view's size, a row on the axis, levels before the frame's gain."""
    checks = [
        ValidationCheck(
            f"focal length at {width} px, px", focal, classic_camera(width).focal_px, 0.005
        )
        for width, focal in ((760, 389.08), (768, 393.17), (512, 262.11))
    ]
    empty = scan.sector_mask(classic_camera().horizontal_rad)
    checks += [
        ValidationCheck("rows of the plan view", 400, empty.shape[0], 0),
        ValidationCheck("columns of the plan view", 578, empty.shape[1], 0),
        ValidationCheck("row of z = 8.5 m on the axis", 199, _row_on_axis(8.5), 0),
        ValidationCheck("level at 1 m, channel 1, dB", 260, _level_db(1.0, 1.0), 1e-3),
        ValidationCheck("level at 17 m, channel 0, dB", 0, _level_db(17.0, 0.0), 1e-3),
    ]
    source = "uuv_simulator's gazebo_ros_image_sonar, computed"
    return ValidationResult("V18 the published pipeline", source, tuple(checks), _drawing())


def _row_on_axis(depth_m: float) -> int:
    row, _, _ = scan.cells(np.full((1, 1), depth_m, np.float32), ON_AXIS, ON_AXIS, 578)
    return int(row[0, 0])


def _level_db(depth_m: float, channel: float) -> float:
    depth = np.full((1, 1), depth_m, np.float32)
    return float(
        pipeline.level_db(depth, np.full((1, 1), channel, np.float32), ON_AXIS, ON_AXIS)[0, 0]
    )


def _drawing() -> "Callable[[Axes], None]":
    camera = classic_camera()
    depth_m, _ = defects.depth_image(
        camera, defects.floor(2.0), defects.wall(15.0), defects.sphere(8.75, 0.25)
    )
    fan = classic_images(depth_m, camera.horizontal_rad).fan

    def draw(axes: "Axes") -> None:
        axes.imshow(fan)
        axes.axhline(_row_on_axis(8.5), color="w", lw=0.5, ls=":")
        axes.set_xlabel("a ball at 8.5 m on the axis: row 199")
        axes.set_xticks([])
        axes.set_yticks([])

    return draw


PHYSICS = dataclasses.replace(
    MEAN, speckle=True, beam_width_rad=0.0175, range_spread=True, noise_level_db=90.0, tvg=True
)


def v19_determinism() -> ValidationResult:
    """One to five threads; another ping; another seed."""
    first = _picture(threads=1)
    checks = [
        ValidationCheck(
            f"cells that {n} threads change", 0.0, _differing(first, _picture(threads=n)), 0.0
        )
        for n in (1, 2, 3, 5)
    ]
    share = _differing(first, _picture(seed=1)) / first.size
    checks.append(ValidationCheck("share that another seed changes", 1.0, share, 0.01))
    return ValidationResult("V19 determinism", "bytes compared", tuple(checks), _draw)


def _picture(threads: int = 2, seed: int = 0) -> NDArray[np.float32]:
    scene = Scene((floor(-2.0), sphere((5.0, 0.0, 0.0), 0.5, CHALK)))
    engine = PingEngine(scene, narrow_sonar(10.0, 0.01, 128), seed, threads)
    return engine.ping(pose_at((0.0, 0.0, 0.0)), PHYSICS, ping_id=3).amplitude


def _differing(one: NDArray[np.float32], other: NDArray[np.float32]) -> float:
    return float(np.count_nonzero(one != other))


def _draw(axes: "Axes") -> None:
    difference = _picture(threads=1) - _picture(threads=2)
    axes.imshow(difference, aspect="auto", origin="lower", vmin=-1.0, vmax=1.0)
    axes.set_xlabel("beam")
    axes.set_ylabel("row")
