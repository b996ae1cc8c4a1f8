"""The third stage: the pixels strewn over a plan view of 400 rows and 17 m, called raw sonar."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

ROWS = 400
RANGE_M = 17.0
PEDESTAL = np.float32(0.2)
SPECKLE = 0.1
"""Standard deviation of the factor that is called speckle."""
BROADER_PX = (3, 9)
"""Width and height of the ellipse by which echoes grow."""


def columns_of(horizontal_rad: float) -> int:
    """Width of the plan view."""
    return 2 * int(ROWS * math.sin(horizontal_rad / 2.0)) + 20


def pie(horizontal_rad: float) -> NDArray[np.float32]:
    """Empty water: 0.2 in the outer two thirds of the range, 0 in the inner, (400, columns)."""
    columns = columns_of(horizontal_rad)
    scan = np.zeros((ROWS, columns), dtype=np.float32)
    half_deg = math.degrees(horizontal_rad) / 2.0
    for radius, value in ((ROWS, float(PEDESTAL)), (ROWS // 3, 0.0)):
        cv2.ellipse(
            scan, (columns // 2, ROWS), (radius, radius), -90, -half_deg, half_deg, (value,), -1
        )
    return scan


def cells(
    depth_m: NDArray[np.float32],
    x: NDArray[np.float32],
    y: NDArray[np.float32],
    columns: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Row and column of each depth pixel, and whether they lie in the plan view."""
    depth_m = np.nan_to_num(depth_m, nan=0.0, posinf=1e6, neginf=0.0)
    ahead_m = depth_m * np.sqrt(y[:, None] ** 2 + np.float32(1.0))
    aside_m = x[None, :] * ahead_m
    per_m = np.float32(ROWS / RANGE_M)
    row = ROWS - 1 - np.trunc(ahead_m * per_m).astype(np.int64)
    column = columns // 2 + np.trunc(aside_m * per_m).astype(np.int64)
    inside = (row > 0) & (row < ROWS) & (column > 0) & (column < columns)
    return row, column, inside & (aside_m**2 + ahead_m**2 < RANGE_M**2)


def strewn(
    depth_m: NDArray[np.float32],
    snr: NDArray[np.float32],
    x: NDArray[np.float32],
    y: NDArray[np.float32],
    scan: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Write each pixel into its cell; whichever comes last in the picture stays."""
    row, column, inside = cells(depth_m, x, y, scan.shape[1])
    written = inside & (depth_m != 0.0) & (snr != 0.0)
    result = scan.copy()
    # Of equal places the last value is assigned, as in the original's loop.
    result[row[written], column[written]] = snr[written]
    return result


def broadened(scan: NDArray[np.float32]) -> NDArray[np.float32]:
    """Let echoes grow over empty cells: what the original calls a median filter."""
    ellipse = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, BROADER_PX)
    grown = cv2.dilate(
        scan, ellipse, iterations=1, borderType=cv2.BORDER_REPLICATE, borderValue=(1.0,)
    )
    empty = (scan == 0.0) | (scan == PEDESTAL)
    return np.where(empty, grown, scan).astype(np.float32)


def speckled(scan: NDArray[np.float32], generator: np.random.Generator) -> NDArray[np.float32]:
    """Multiply by |N(1, 0.1)|: the factor's coefficient of variation is a fifth of the true one."""
    factor = np.abs(generator.normal(1.0, SPECKLE, scan.shape))
    return (scan * factor).astype(np.float32)
