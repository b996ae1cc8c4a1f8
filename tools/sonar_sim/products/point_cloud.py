"""The points that the camera sees, as a PLY that CloudCompare, MeshLab and Blender read."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

POINT = np.dtype(
    [
        *((axis, "<f4") for axis in "xyz"),
        *((channel, "u1") for channel in ("red", "green", "blue")),
        ("intensity", "<f4"),
        ("surface", "<i4"),
    ]
)
"""One point. The file is about one ping, so single precision serves."""

_PLY_TYPES = {"<f4": "float", "|u1": "uchar", "<i4": "int"}


def hit_points(
    points_m: NDArray[np.float64],
    colours: NDArray[np.uint8],
    intensity: NDArray[np.float32],
    surface: NDArray[np.int32],
) -> NDArray[np.void]:
    """Gather points into records.

    Args:
        points_m: (N, 3).
        colours: (N, 3), red first.
        intensity: (N,), the ping's sample over full scale, NaN outside the ping.
        surface: (N,), place in the scene's surfaces.
    """
    cloud = np.empty(len(points_m), dtype=POINT)
    for axis, name in enumerate("xyz"):
        cloud[name] = points_m[:, axis]
    for channel, name in enumerate(("red", "green", "blue")):
        cloud[name] = colours[:, channel]
    cloud["intensity"] = intensity
    cloud["surface"] = surface
    return cloud


def write_cloud(path: Path, cloud: NDArray[np.void], frame: str) -> None:
    """Write binary little endian; a comment names the frame."""
    fields = [(name, POINT[name].str) for name in POINT.names or ()]
    head = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment sonar-sim points, {frame}, metres",
        f"element vertex {len(cloud)}",
        *(f"property {_PLY_TYPES[kind]} {name}" for name, kind in fields),
        "end_header",
        "",
    ]
    path.write_bytes("\n".join(head).encode("ascii") + cloud.tobytes())
