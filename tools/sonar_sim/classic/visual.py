"""The fourth stage: the plan view in colours."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

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
