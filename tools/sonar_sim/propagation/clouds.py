"""Bubbles and sediment in boxes: what they swallow on the way, and what they send back."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sonar_sim.propagation.beam_pattern import vertical_two_way_power
from sonar_sim.propagation.physics import Cloud, Physics
from sonar_sim.raycast.fan import solid_angle_sr
from sonar_sim.raycast.tracing import Trace
from sonar_sim.scene.sonar import SonarSettings

MAX_EXPONENT = 300.0
"""Of a factor of power; more is silence."""


def box_crossing(
    cloud: Cloud,
    origin_m: NDArray[np.float64],
    direction: NDArray[np.float32],
    reach_m: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Ranges between which rays are inside a cloud, (N,) each; equal where they miss it.

    Args:
        cloud: its box.
        origin_m: of the rays, (3,).
        direction: map frame, (N, 3).
        reach_m: where the rays end, (N,).
    """
    tiny = np.where(np.abs(direction) < 1e-12, 1e-12, direction).astype(np.float64)  # noqa: PLR2004
    to_low = (cloud.low_m - origin_m) / tiny
    to_high = (cloud.high_m - origin_m) / tiny
    enter = np.maximum(np.minimum(to_low, to_high).max(axis=1), 0.0)
    leave = np.minimum(np.maximum(to_low, to_high).min(axis=1), reach_m)
    return np.minimum(enter, np.maximum(leave, 0.0)), np.maximum(leave, 0.0)


def cloud_gain(
    clouds: Sequence[Cloud],
    origin_m: NDArray[np.float64],
    direction: NDArray[np.float32],
    range_m: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Pressure that the clouds leave to echoes, there and back, (N,)."""
    loss_db = np.zeros(len(direction))
    for cloud in clouds:
        enter, leave = box_crossing(cloud, origin_m, direction, range_m)
        loss_db += 2.0 * cloud.attenuation_db_per_m * (leave - enter)
    gain: NDArray[np.float32] = (10.0 ** (-loss_db / 20.0)).astype(np.float32)
    return gain


def cloud_power(
    physics: Physics, sonar: SonarSettings, trace: Trace, loss: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Mean power that the clouds send back, (rows, columns).

    Each ray fills its cone between entry and exit: Sv dOmega dR / R² of the source's power, less
    what the cloud has swallowed so far (its own mean there and back to each row).

    Args:
        physics: the clouds, spreading, the vertical pattern.
        sonar: settings.
        trace: what hides the clouds.
        loss: pressure that the way to each row and back leaves, (rows,).
    """
    first = trace.met[0]
    end = np.where(first.face >= 0, first.range_m, np.inf).astype(np.float64)
    row_m = sonar.range_resolution_m / physics.range_scale
    power = np.zeros((sonar.rows, trace.fan.columns))
    middle_m = sonar.row_centres_m[:, None] / physics.range_scale
    for cloud in physics.clouds:
        enter, leave = box_crossing(cloud, trace.origin_m, trace.direction, end)
        inside = np.flatnonzero(leave > enter)
        column = trace.fan.column[inside]
        share = solid_angle_sr(*trace.fan.cell[inside].T.astype(np.float64))
        if physics.vertical_width_rad is not None:
            up = trace.fan.directions[inside, 2].astype(np.float64)
            share *= vertical_two_way_power(up, physics.vertical_width_rad)
        filled = _filled(enter[inside] / row_m, leave[inside] / row_m, column, share, power.shape)
        total = np.maximum(np.bincount(column, share, trace.fan.columns), 1e-30)
        mean_enter = np.bincount(column, share * enter[inside], trace.fan.columns) / total
        # exp(-k (R - entry)) beyond the entry, as a product of a row's and a column's part.
        per_m = 0.2 * math.log(10.0) * cloud.attenuation_db_per_m
        begin_m = float(mean_enter.min(initial=0.0))
        behind = np.exp(np.minimum(per_m * (mean_enter - begin_m), MAX_EXPONENT))
        faded = np.exp(-np.minimum(per_m * (middle_m - begin_m), MAX_EXPONENT))
        filled *= np.minimum(faded * behind, 1.0)
        filled *= 10.0 ** (cloud.volume_strength_db / 10.0) * row_m
        power += filled
    if not physics.spreading:
        power *= np.square(np.square(middle_m))
    power *= np.square(loss[:, None].astype(np.float64) / middle_m)
    return power.astype(np.float32)


def _filled(
    enter_row: NDArray[np.float64],
    leave_row: NDArray[np.float64],
    column: NDArray[np.int32],
    weight: NDArray[np.float64],
    shape: tuple[int, int],
) -> NDArray[np.float64]:
    """Weights of rays summed over the rows between entry and exit, in parts of a row, (R, C)."""
    rows, columns = shape
    cells, weights = [], []
    for start_row, sign in ((enter_row, 1.0), (leave_row, -1.0)):
        whole = np.minimum(start_row, rows).astype(np.int64)
        part = np.where(whole < rows, start_row - whole, 0.0)
        cells += [whole * columns + column, (whole + 1) * columns + column]
        weights += [sign * weight * (1.0 - part), sign * weight * part]
    steps = np.bincount(np.concatenate(cells), np.concatenate(weights), (rows + 2) * columns)
    summed = np.cumsum(steps.reshape(rows + 2, columns)[:rows], axis=0, dtype=np.float64)
    return np.maximum(summed, 0.0, out=summed)
