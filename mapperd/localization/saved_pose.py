"""The last estimate in a small file, to go on there after a restart."""

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
    """When it is time to save.

    Attributes:
        rate_hz: 0 or less is never.
        last_s: of the last save, on any steady clock; None is before the first.
    """

    rate_hz: float
    last_s: float | None = None

    def is_due(self, now_s: float) -> bool:
        """Whether an estimate that is there now is to be saved."""
        if not self.rate_hz > 0:
            return False
        return self.last_s is None or now_s - self.last_s >= 1 / self.rate_hz

    def saved(self, now_s: float) -> "SavePace":
        """The pace after a save, or an attempt: a full disk is not asked at every scan."""
        return SavePace(self.rate_hz, now_s)


def save_pose(path: Path, pose: PlanarGaussian, frame: str, unix_ns: int) -> None:
    """Write the estimate, whole or not at all.

    Args:
        path: of the file.
        pose: the estimate.
        frame: name of the map's frame.
        unix_ns: now.

    Raises:
        ExportError: it cannot be written; the last one is as it was.
    """
    a, b, c = ((float(x), float(y), float(z)) for x, y, z in pose.covariance)
    saved = _Saved(frame, unix_ns, (pose.x_m, pose.y_m, pose.yaw_rad), (a, b, c))
    with atomic_file(path) as file:
        file.write(msgspec.json.encode(saved) + b"\n")


def load_pose(path: Path, frame: str) -> PlanarGaussian | None:
    """Read the estimate of `save_pose`.

    Args:
        path: of the file.
        frame: name of the map's frame now.

    Returns:
        None where there is no file.

    Raises:
        MapError: it cannot be read, is no saved pose, or one in another frame (`bad_saved_pose`).
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
