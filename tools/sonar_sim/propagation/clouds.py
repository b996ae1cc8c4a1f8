"""Bubbles and sediment in boxes: what they swallow on the way, and what they send back."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sonar_sim import _core
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
    box_m = np.stack([cloud.low_m, cloud.high_m])
    return _core.box_crossing(box_m, origin_m, direction, reach_m)


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
    columns = trace.fan.columns
    power = np.zeros((sonar.rows, columns), dtype=np.float32)
    middle_m = sonar.row_centres_m / physics.range_scale
    level = np.square(loss.astype(np.float64) * (1.0 if physics.spreading else middle_m**2))
    level /= np.square(middle_m)
    for cloud in physics.clouds:
        enter, leave = box_crossing(cloud, trace.origin_m, trace.direction, end)
        inside = np.flatnonzero(leave > enter)
        enter, leave, column = enter[inside], leave[inside], trace.fan.column[inside]
        share = solid_angle_sr(*trace.fan.cell[inside].T.astype(np.float64))
        if physics.vertical_width_rad is not None:
            up = trace.fan.directions[inside, 2].astype(np.float64)
            share *= vertical_two_way_power(up, physics.vertical_width_rad)
        total = np.maximum(np.bincount(column, share, columns), 1e-30)
        mean_enter = np.bincount(column, share * enter, columns) / total
        # exp(-k (R - entry)) beyond the entry, as a product of a row's and a column's part.
        per_m = 0.2 * math.log(10.0) * cloud.attenuation_db_per_m
        begin_m = float(mean_enter.min(initial=0.0))
        _core.add_cloud(
            power,
            enter / row_m,
            leave / row_m,
            column,
            share,
            np.exp(-np.minimum(per_m * (middle_m - begin_m), MAX_EXPONENT)),
            np.exp(np.minimum(per_m * (mean_enter - begin_m), MAX_EXPONENT)),
            level * 10.0 ** (cloud.volume_strength_db / 10.0) * row_m,
        )
    return power
