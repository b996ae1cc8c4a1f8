"""Bubbles and sediment in boxes: what they swallow on the way, and what they send back."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sonar_sim.propagation.beam_pattern import vertical_two_way_power
from sonar_sim.propagation.physics import Cloud, Physics
from sonar_sim.raycast.tracing import Trace
from sonar_sim.scene.sonar import SonarSettings


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
    weight = trace.fan.solid_angle_sr
    if physics.vertical_width_rad is not None:
        up = trace.fan.directions[:, 2].astype(np.float64)
        weight = weight * vertical_two_way_power(up, physics.vertical_width_rad)
    middle_m = sonar.row_centres_m[:, None] / physics.range_scale
    for cloud in physics.clouds:
        enter, leave = box_crossing(cloud, trace.origin_m, trace.direction, end)
        inside = np.flatnonzero(leave > enter)
        column = trace.fan.column[inside]
        share = weight[inside]
        filled = _filled(enter[inside] / row_m, column, share, power.shape)
        filled -= _filled(leave[inside] / row_m, column, share, power.shape)
        total = np.maximum(np.bincount(column, share, trace.fan.columns), 1e-30)
        mean_enter = np.bincount(column, share * enter[inside], trace.fan.columns) / total
        depth_m = np.maximum(middle_m - mean_enter, 0.0)
        swallowed = 10.0 ** (-0.2 * cloud.attenuation_db_per_m * depth_m)
        strength = 10.0 ** (cloud.volume_strength_db / 10.0) * row_m
        power += strength * np.maximum(filled, 0.0) * swallowed
    if not physics.spreading:
        power *= np.square(np.square(middle_m))
    total_power: NDArray[np.float32] = (
        power * np.square(loss[:, None].astype(np.float64)) / np.square(middle_m)
    ).astype(np.float32)
    return total_power


def _filled(
    start_row: NDArray[np.float64],
    column: NDArray[np.int32],
    weight: NDArray[np.float64],
    shape: tuple[int, int],
) -> NDArray[np.float64]:
    """Weights of rays summed over all rows from each one's start on."""
    rows, columns = shape
    whole = np.minimum(start_row, rows).astype(np.int64)
    part = np.where(whole < rows, start_row - whole, 0.0)
    size = (rows + 2) * columns
    steps = np.bincount(whole * columns + column, weight * (1.0 - part), size)
    steps = steps + np.bincount((whole + 1) * columns + column, weight * part, size)
    summed = np.cumsum(steps.reshape(rows + 2, columns), axis=0, dtype=np.float64)
    return summed[:rows]
