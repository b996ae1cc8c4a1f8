"""V18: the published pipeline's own constants, which the mode `classic` keeps."""

from typing import TYPE_CHECKING

import numpy as np

from sonar_sim.classic import classic_camera, classic_images, scan, shapes, snr
from sonar_sim.validation.case import CaseResult, Check

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.axes import Axes

ON_AXIS = np.zeros(1, dtype=np.float32)


def v18_classic() -> CaseResult:
    """Focal lengths, the plan view's size, a row on the axis, levels before the frame's gain."""
    checks = [
        Check(f"focal length at {width} px, px", focal, classic_camera(width).focal_px, 0.005)
        for width, focal in ((760, 389.08), (768, 393.17), (512, 262.11))
    ]
    empty = scan.pie(classic_camera().horizontal_rad)
    checks += [
        Check("rows of the plan view", 400, empty.shape[0], 0),
        Check("columns of the plan view", 578, empty.shape[1], 0),
        Check("row of z = 8.5 m on the axis", 199, _row_on_axis(8.5), 0),
        Check("level at 1 m, channel 1, dB", 260, _level_db(1.0, 1.0), 1e-3),
        Check("level at 17 m, channel 0, dB", 0, _level_db(17.0, 0.0), 1e-3),
    ]
    source = "uuv_simulator's gazebo_ros_image_sonar, computed"
    return CaseResult("V18 the published pipeline", source, tuple(checks), _drawing())


def _row_on_axis(depth_m: float) -> int:
    row, _, _ = scan.cells(np.full((1, 1), depth_m, np.float32), ON_AXIS, ON_AXIS, 578)
    return int(row[0, 0])


def _level_db(depth_m: float, channel: float) -> float:
    depth = np.full((1, 1), depth_m, np.float32)
    return float(snr.level_db(depth, np.full((1, 1), channel, np.float32), ON_AXIS, ON_AXIS)[0, 0])


def _drawing() -> "Callable[[Axes], None]":
    camera = classic_camera()
    depth_m, _ = shapes.seen(
        camera, shapes.floor(2.0), shapes.wall(15.0), shapes.sphere(8.75, 0.25)
    )
    fan = classic_images(depth_m, camera.horizontal_rad).fan

    def draw(axes: "Axes") -> None:
        axes.imshow(fan)
        axes.axhline(_row_on_axis(8.5), color="w", lw=0.5, ls=":")
        axes.set_xlabel("a ball at 8.5 m on the axis: row 199")
        axes.set_xticks([])
        axes.set_yticks([])

    return draw
