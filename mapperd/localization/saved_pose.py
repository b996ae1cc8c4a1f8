"""Saves the last estimate in a small file, so that a restart continues from it."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta, Struct

from mapperd.errors import MapError, os_reason
from mapperd.geometry.gaussian import PlanarGaussian
from mapperd.io import atomic_file

__all__ = ["SavePace", "load_pose", "save_pose"]

MAX_FILE_BYTES = 4096

Row = tuple[float, float, float]


class _Saved(Struct, frozen=True, forbid_unknown_fields=True):
    frame: Annotated[str, Meta(max_length=64)]
    saved_unix_ns: int
    mean: Row
    covariance: tuple[Row, Row, Row]
    version: Literal[1] = 1


@dataclass(frozen=True, slots=True)
class SavePace:
    """Decides when to save.

    Attributes:
        rate_hz: saves per second; 0 or less never saves.
        last_s: time of the last save on a monotonic clock; None before the first.
    """

    rate_hz: float
    last_s: float | None = None

    def is_due(self, now_s: float) -> bool:
        """Whether to save an estimate now."""
        if not self.rate_hz > 0:
            return False
        return self.last_s is None or now_s - self.last_s >= 1 / self.rate_hz

    def saved(self, now_s: float) -> "SavePace":
        """Return the pace after a save or a failed attempt; both wait for the next period."""
        return SavePace(self.rate_hz, now_s)


def save_pose(path: Path, pose: PlanarGaussian, frame: str, unix_ns: int) -> None:
    """Write the estimate atomically.

    Args:
        path: of the file.
        pose: the estimate.
        frame: name of the map's frame.
        unix_ns: current time.

    Raises:
        ExportError: it cannot be written; the previous file is unchanged.
    """
    a, b, c = ((float(x), float(y), float(z)) for x, y, z in pose.covariance)
    saved = _Saved(frame, unix_ns, (pose.x_m, pose.y_m, pose.yaw_rad), (a, b, c))
    with atomic_file(path) as file:
        file.write(msgspec.json.encode(saved) + b"\n")


def load_pose(path: Path, frame: str) -> PlanarGaussian | None:
    """Read an estimate that `save_pose` wrote.

    Args:
        path: of the file.
        frame: current name of the map's frame.

    Returns:
        The estimate; None if there is no file.

    Raises:
        MapError: it cannot be read, is not a saved pose, or is in another frame
            (`bad_saved_pose`).
    """
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise MapError(f"{path}: cannot be read: {os_reason(error)}", "bad_saved_pose") from error
    try:
        saved = msgspec.json.decode(data, type=_Saved)
        pose = PlanarGaussian(*saved.mean, np.array(saved.covariance))
    except (msgspec.MsgspecError, ValueError) as error:
        raise MapError(f"{path}: no saved pose: {error}", "bad_saved_pose") from error
    if saved.frame != frame:
        raise MapError(f"{path}: a pose in {saved.frame!r}, the map is {frame!r}", "bad_saved_pose")
    if abs(saved.mean[2]) > math.tau:
        raise MapError(f"{path}: not a saved pose: its heading is not an angle", "bad_saved_pose")
    return pose
