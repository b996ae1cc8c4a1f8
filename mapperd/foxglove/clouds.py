"""Point clouds of the map and of what the sonar met."""

import numpy as np
from foxglove.messages import PointCloud
from numpy.typing import NDArray

from mapperd.client.cells import Cells
from mapperd.foxglove.geometry import cloud, pose
from mapperd.wire.messages import Localization, Returns

__all__ = ["changes_cloud", "map_cloud", "map_rows", "returns_cloud", "scan_cloud"]

NS = 1e9

_CELL = [
    ("x", "<f4"),
    ("y", "<f4"),
    ("z", "<f4"),
    ("probability", "<f4"),
    ("age_s", "<f4"),
    ("count", "<u4"),
]
_CHANGED_CELL = [*_CELL, ("occupied", "u1")]
_RETURN = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "u1")]
_POINT = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]


def map_rows(cells: Cells, stamp_ns: int) -> NDArray[np.void]:
    """Points of cells; `age_s` since their block changed last, `count` 0 where nobody tells it."""
    return _rows(cells, _CELL, stamp_ns)


def map_cloud(rows: NDArray[np.void], frame: str, stamp_ns: int) -> PointCloud:
    """All of `map_rows` as of one moment."""
    return cloud(rows, frame, stamp_ns)


def changes_cloud(
    cells: Cells, gone_m: NDArray[np.float64], frame: str, stamp_ns: int
) -> PointCloud:
    """Cells that are occupied now, and the centres (N, 3) of those that are not any more."""
    here = _rows(cells, _CHANGED_CELL, stamp_ns)
    here["occupied"] = 1
    gone = np.zeros(len(gone_m), _CHANGED_CELL)
    _place(gone, gone_m)
    return cloud(np.concatenate([here, gone]), frame, stamp_ns)


def returns_cloud(returns: Returns, map_frame: str, sonar_frame: str) -> PointCloud:
    """What one ping met, where the sonar was then if that is known."""
    rows = _points(returns.points, 3, _RETURN)
    rows["intensity"] = np.frombuffer(returns.intensities, np.uint8)
    where, how = returns.sonar_position_m, returns.sonar_orientation_xyzw
    if where is None or how is None:
        return cloud(rows, sonar_frame, returns.stamp_ns)
    return cloud(rows, map_frame, returns.stamp_ns, pose(where, how))


def scan_cloud(localization: Localization, frame: str, stamp_ns: int) -> PointCloud:
    """The scan that localization weighed last."""
    return cloud(_points(localization.scan, 3, _POINT), frame, stamp_ns)


def _rows(cells: Cells, kind: list[tuple[str, str]], stamp_ns: int) -> NDArray[np.void]:
    rows = np.zeros(len(cells), kind)
    _place(rows, cells.centres_m)
    rows["probability"] = cells.probability
    rows["age_s"] = np.maximum(stamp_ns - cells.changed_ns, 0) / NS
    rows["count"] = cells.count
    return rows


def _points(data: bytes, columns: int, kind: list[tuple[str, str]]) -> NDArray[np.void]:
    table = np.frombuffer(data, "<f4").reshape(-1, columns)
    rows = np.zeros(len(table), kind)
    _place(rows, table)
    return rows


def _place(rows: NDArray[np.void], xyz: NDArray[np.float64] | NDArray[np.float32]) -> None:
    rows["x"], rows["y"], rows["z"] = xyz.T
