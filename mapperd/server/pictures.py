"""What one ping met, and what it looked like, no finer than a person sees."""

import numpy as np
import zstandard
from numpy.typing import NDArray

from mapperd.config.tree import Config
from mapperd.errors import MapError
from mapperd.geometry.frames import Pose as Place
from mapperd.imaging.ping_image import Echo, display_units, echo_of
from mapperd.pipeline.executor import Treated
from mapperd.pipeline.step import Mapped
from mapperd.wire.messages import Image, Returns
from oculus_driver.ping import Ping

__all__ = ["IMAGE_SIZES", "first_returns", "image_message", "returns_message"]

IMAGE_SIZES = ((512, 256), (256, 128), (128, 64))
"""Rows and beams at most, the finest first: slower links get a coarser image."""

_COMPRESSOR = zstandard.ZstdCompressor(level=1)


def returns_message(treated: Treated, sonar: Place | None, config: Config) -> Returns | None:
    """The first return of each beam; None where the ping is no image of a fan.

    Args:
        treated: the ping.
        sonar: where it was, in the map; None where nobody knows.
        config: the settings.
    """
    result, ping = treated.result, treated.settled.ping
    echo = result.echo if isinstance(result, Mapped) else None
    if echo is None:
        try:
            echo = echo_of(ping, config.sonar)
        except MapError:
            return None
    points, intensities = first_returns(echo, config)
    turn = None if sonar is None else sonar.map_q_base.tolist()
    return Returns(
        stamp_ns=max(treated.settled.complete_ns or 0, 0),
        ping_id=ping.ping_id,
        sonar_position_m=None if sonar is None else tuple(sonar.position_m.tolist()),
        sonar_orientation_xyzw=None if turn is None else (*turn[1:], turn[0]),
        outcome="mapped" if isinstance(result, Mapped) else result.reason,
        points=points.astype("<f4").tobytes(),
        intensities=intensities.tobytes(),
    )


def first_returns(echo: Echo, config: Config) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """The nearest sample of each beam above `filtering.intensity_threshold`.

    Returns:
        (N, 3) points in the sonar's frame, and their (N,) intensities.
    """
    step_m = echo.range_resolution_m
    nearest = int(np.ceil(config.filtering.min_range / step_m))
    above = echo.intensity[nearest:] > config.filtering.intensity_threshold
    if not len(above):
        return np.zeros((0, 3), np.float32), np.zeros(0, np.uint8)
    row = above.argmax(axis=0)
    beam = np.flatnonzero(above[row, np.arange(above.shape[1])])
    row = row[beam] + nearest
    range_m, bearing = (row + 0.5) * step_m, echo.bearings_rad[beam]
    points = np.zeros((len(beam), 3), np.float32)
    points[:, 0] = range_m * np.cos(bearing)
    points[:, 1] = -range_m * np.sin(bearing)
    return points, np.clip(np.rint(echo.intensity[row, beam]), 0, 255).astype(np.uint8)


def image_message(ping: Ping, stamp_ns: int, most: tuple[int, int]) -> Image:
    """The image with at most so many rows and beams: each pixel the highest of its samples."""
    rows, beams = ping.image.shape
    by_row, by_beam = -(-rows // most[0]), -(-beams // most[1])
    row, beam = np.arange(0, rows, by_row), np.arange(0, beams, by_beam)
    highest = np.maximum.reduceat(np.maximum.reduceat(ping.image, row, axis=0), beam, axis=1)
    pixels = np.clip(np.rint(display_units(highest, ping.full_scale)), 0, 255).astype(np.uint8)
    number = np.diff(np.append(beam, beams))
    bearings = np.add.reduceat(ping.bearings_rad, beam) / number
    return Image(
        stamp_ns=max(stamp_ns, 0),
        ping_id=ping.ping_id,
        rows=len(row),
        beams=len(beam),
        range_resolution_m=ping.range_resolution_m * by_row,
        bearings_rad=bearings.astype("<f4").tobytes(),
        body=_COMPRESSOR.compress(pixels.tobytes()),
    )
