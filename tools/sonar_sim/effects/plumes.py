"""What clouds of bubbles and sediment send back, as the coarse rays find them."""

import numpy as np
from numpy.typing import NDArray

from sonar_sim.effects.coarse import CoarseGrid
from sonar_sim.effects.echoes import COLUMNS, Fan
from sonar_sim.geometry.pose import Pose
from sonar_sim.propagation.beam_pattern import vertical_two_way_power
from sonar_sim.propagation.clouds import passage
from sonar_sim.propagation.physics import Cloud


def filled_by(
    cloud: Cloud,
    grid: CoarseGrid,
    fan: Fan,
    map_T_sonar: Pose,  # noqa: N803 frames in the name
    end_m: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Part of each cell's listened water that a cloud fills, as bright as it is, (rows, COLUMNS).

    Each ray fills its cone between entry and exit; the cloud swallows on the way what it does.

    Args:
        cloud: its box and what it does.
        grid: of the picture.
        fan: the coarse rays.
        map_T_sonar: where they start.
        end_m: where each ends, (N,).
    """
    direction = fan.directions @ map_T_sonar.rotation.T
    enter_m, leave_m = passage(
        cloud, map_T_sonar.position_m, direction.astype(np.float32), np.minimum(end_m, 1e6)
    )
    inside = np.flatnonzero(leave_m > enter_m)
    if len(inside) == 0:
        return np.zeros((grid.rows, COLUMNS))
    up, column = fan.directions[inside, 2], fan.column[inside]
    width_rad = grid.sonar.vertical_width_rad
    weight = vertical_two_way_power(up, width_rad) * fan.solid_angle_sr[inside] / fan.sine_step
    filled = _from(enter_m[inside] / grid.row_m, column, weight, grid.rows)
    filled -= _from(leave_m[inside] / grid.row_m, column, weight, grid.rows)
    total = np.maximum(np.bincount(column, weight, COLUMNS), 1e-30)
    mean_enter_m = np.bincount(column, weight * enter_m[inside], COLUMNS) / total
    depth_m = np.maximum(grid.range_m[:, None] - mean_enter_m, 0.0)
    swallowed = 10.0 ** (-0.2 * cloud.attenuation_db_per_m * depth_m)
    w = np.linspace(-1.0, 1.0, 401)
    whole = float(np.trapezoid(vertical_two_way_power(w, width_rad), w))
    part: NDArray[np.float64] = np.maximum(filled, 0.0) * swallowed / whole
    return part


def _from(
    start_row: NDArray[np.float64],
    column: NDArray[np.int64],
    weight: NDArray[np.float64],
    rows: int,
) -> NDArray[np.float64]:
    """Weights of rays summed over all rows from each one's start on, (rows, COLUMNS)."""
    whole = np.minimum(start_row, rows).astype(np.int64)
    part = np.where(whole < rows, start_row - whole, 0.0)
    size = (rows + 2) * COLUMNS
    steps = np.bincount(whole * COLUMNS + column, weight * (1.0 - part), size)
    steps = steps + np.bincount((whole + 1) * COLUMNS + column, weight * part, size)
    summed = np.cumsum(steps.reshape(rows + 2, COLUMNS), axis=0, dtype=np.float64)
    return summed[:rows]
