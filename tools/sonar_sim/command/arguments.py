"""Types of command-line arguments, and exit codes."""

import argparse
import math

import numpy as np

from sonar_sim.errors import SonarSimError
from sonar_sim.geometry.pose import FramePose, rotation_of
from sonar_sim.geometry.trajectory import Trajectory

POSE_NUMBERS = 6
MAX_PIXELS = 1 << 24
"""Limit of a camera's pixels: some GB of arrays."""


def pose(text: str) -> FramePose:
    """Read `x,y,z,roll,pitch,yaw` in metres and degrees."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != POSE_NUMBERS or not all(map(math.isfinite, numbers)):
        raise argparse.ArgumentTypeError(f"{text!r} is not x,y,z,roll,pitch,yaw (metres, degrees)")
    roll, pitch, yaw = (math.radians(number) for number in numbers[3:])
    return FramePose(np.array(numbers[:3]), rotation_of(roll, pitch, yaw))


def size(text: str) -> tuple[int, int]:
    """Read `WIDTHxHEIGHT`."""
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal() and int(width) > 1 and int(height) > 1):
        raise argparse.ArgumentTypeError(f"{text!r} is not WIDTHxHEIGHT in pixels")
    if int(width) * int(height) > MAX_PIXELS:
        raise argparse.ArgumentTypeError(f"{text!r} is more than {MAX_PIXELS} pixels")
    return int(width), int(height)


def count(text: str) -> int:
    """Read a number of at least 1."""
    if not (text.isdecimal() and int(text) > 0):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of at least 1")
    return int(text)


def positive(text: str) -> float:
    """Read a number above 0."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not 0.0 < number < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number above 0")
    return number


def seed(text: str) -> int:
    """Read a seed: a whole number of at least 0."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least 0")
    return int(text)


def time_on(path: Trajectory, time_s: float) -> float:
    """Check that a time lies on the path.

    Raises:
        SonarSimError: the time is not on the path, or not a number.
    """
    if not 0.0 <= time_s <= path.duration_s:
        raise SonarSimError(f"time {time_s:g} s is not 0 to {path.duration_s:.3f} s of the path")
    return time_s


def names(text: str) -> tuple[str, ...]:
    """Read `a,b,c`."""
    return tuple(part.strip() for part in text.split(",") if part.strip())
