"""The published plugin's plan view and its colours."""

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


def columns_of(horizontal_rad: float, rows: int = ROWS) -> int:
    """Width of the plan view."""
    return 2 * int(rows * math.sin(horizontal_rad / 2.0)) + 20


def sector_mask(horizontal_rad: float, rows: int = ROWS) -> NDArray[np.float32]:
    """Empty water: 0.2 in the outer two thirds of the range, 0 in the inner, (rows, columns)."""
    columns = columns_of(horizontal_rad, rows)
    scan = np.zeros((rows, columns), dtype=np.float32)
    half_deg = math.degrees(horizontal_rad) / 2.0
    for radius, value in ((rows, float(PEDESTAL)), (rows // 3, 0.0)):
        cv2.ellipse(
            scan, (columns // 2, rows), (radius, radius), -90, -half_deg, half_deg, (value,), -1
        )
    return scan


def cells(
    depth_m: NDArray[np.float32],
    x: NDArray[np.float32],
    y: NDArray[np.float32],
    columns: int,
    *,
    rows: int = ROWS,
    range_m: float = RANGE_M,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Row and column of each depth pixel, and whether they lie in the plan view."""
    depth_m = np.nan_to_num(depth_m, nan=0.0, posinf=1e6, neginf=0.0)
    ahead_m = depth_m * np.sqrt(y[:, None] ** 2 + np.float32(1.0))
    aside_m = x[None, :] * ahead_m
    per_m = np.float32(rows / range_m)
    row = rows - 1 - np.trunc(ahead_m * per_m).astype(np.int64)
    column = columns // 2 + np.trunc(aside_m * per_m).astype(np.int64)
    inside = (row > 0) & (row < rows) & (column > 0) & (column < columns)
    return row, column, inside & (aside_m**2 + ahead_m**2 < range_m**2)


def projected(
    depth_m: NDArray[np.float32],
    snr: NDArray[np.float32],
    x: NDArray[np.float32],
    y: NDArray[np.float32],
    scan: NDArray[np.float32],
    *,
    range_m: float = RANGE_M,
) -> NDArray[np.float32]:
    """Write each pixel into its cell; whichever comes last in the picture stays."""
    rows, columns = scan.shape
    row, column, inside = cells(depth_m, x, y, columns, rows=rows, range_m=range_m)
    written = inside & (depth_m != 0.0) & (snr != 0.0)
    result = scan.copy()
    # Of equal places the last value is assigned, as in the original's loop.
    result[row[written], column[written]] = snr[written]
    return result


def blurred(scan: NDArray[np.float32]) -> NDArray[np.float32]:
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


BLUE = (15, 48, 102)  # red, green, blue
WHITE = (255, 255, 255)
KNEE = 0.8
"""Where the colours jump."""
BORDER_PX = 3
SPOKES = 5
SLACK_DEG = 0.5


def colours(value: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Colour of each value, (..., 3), red first."""
    a = value.astype(np.float64)
    low = np.stack([318.75 * a, 198.9 * a, 127.5 * a], axis=-1)
    high = np.stack([255.0 * a, 255.0 * (1.88 * a - 0.88), 255.0 * (1.99 - 1.99 * a)], axis=-1)
    top = np.broadcast_to(np.array([255.0, 255.0, 0.0]), low.shape)
    level = a[..., None]
    chosen = np.where(level < KNEE, low, np.where(level < 1.0, high, top))
    whole: NDArray[np.uint8] = np.trunc(np.nan_to_num(chosen)).clip(0.0, 255.0).astype(np.uint8)
    return whole


def picture(scan: NDArray[np.float32], horizontal_rad: float) -> NDArray[np.uint8]:
    """Draw the plan view with its grid, (rows, columns, 3), red first."""
    rows, columns = scan.shape
    half_deg = math.degrees(horizontal_rad) / 2.0
    frame = np.full((rows, columns, 3), BLUE, dtype=np.uint8)
    apex, radius = (columns // 2, rows), rows + BORDER_PX
    cv2.ellipse(frame, apex, (radius, radius), -90, -half_deg, half_deg, (0, 0, 0), -1)
    echo = scan != 0.0
    frame[echo] = colours(scan)[echo]
    _draw_arc(frame, radius, -half_deg - SLACK_DEG, half_deg)
    for share in (2.0 / 3.0, 1.0 / 3.0):
        _draw_arc(frame, int(share * rows), -half_deg, half_deg)
    for index in range(SPOKES):
        angle = math.radians(
            -half_deg - SLACK_DEG + (2.0 * half_deg + SLACK_DEG) * index / (SPOKES - 1)
        )
        end = (columns // 2 + int(rows * math.sin(angle)), rows - int(rows * math.cos(angle)))
        cv2.line(frame, apex, end, WHITE, 1, cv2.LINE_AA)
    return frame


def _draw_arc(frame: NDArray[np.uint8], radius: int, first_deg: float, last_deg: float) -> None:
    rows, columns = frame.shape[:2]
    apex = (columns // 2, rows)
    cv2.ellipse(frame, apex, (radius, radius), -90, first_deg, last_deg, WHITE, 1, cv2.LINE_AA)
