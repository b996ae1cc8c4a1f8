"""The second stage: a sonar equation of fixed numbers, called multibeam."""

import numpy as np
from numpy.typing import NDArray

from sonar_sim.classic.normals import stretched

SOURCE_LEVEL_DB = 200.0
NOISE_LEVEL_DB = 30.0
DIRECTIVITY_DB = 0.0
TARGET_STRENGTH_DB = 100.0
"""Of the third channel of the "normals" at 1."""
LOSS_DB_PER_M = 5.0
"""One way, in place of spreading and absorption."""


def level_db(
    depth_m: NDArray[np.float32],
    third_channel: NDArray[np.float32],
    x: NDArray[np.float32],
    y: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Signal over noise before the frame's own gain: 170 - 10 R + 100 n, nothing below 0.

    Args:
        depth_m: (height, width) along the axis.
        third_channel: of the stretched "normals", (height, width).
        x: of each column in units of the focal length, (width,).
        y: of each row, (height,).
    """
    slant = np.sqrt(x[None, :] ** 2 + y[:, None] ** 2 + np.float32(1.0))
    loss_db = np.float32(LOSS_DB_PER_M) * depth_m * slant
    gain_db = np.float32(SOURCE_LEVEL_DB - (NOISE_LEVEL_DB - DIRECTIVITY_DB))
    with np.errstate(invalid="ignore"):
        snr_db = gain_db - 2.0 * loss_db + np.float32(TARGET_STRENGTH_DB) * third_channel
        snr_db[snr_db < 0.0] = 0.0
    result: NDArray[np.float32] = snr_db.astype(np.float32)
    return result


def snr(
    depth_m: NDArray[np.float32],
    third_channel: NDArray[np.float32],
    x: NDArray[np.float32],
    y: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Stretch the levels to 0 .. 1 over this frame, (height, width)."""
    return stretched(level_db(depth_m, third_channel, x, y))
