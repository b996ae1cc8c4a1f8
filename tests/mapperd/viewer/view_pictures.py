"""Pictures of cells by a projection of our own, to be held against those of a browser."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


def camera_towards(at: ArrayLike, target: ArrayLike) -> Floats:
    """Rotation (3, 3) of a camera whose z looks at a target, its y downwards, to the map."""
    forward = np.subtract(target, at).astype(float)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0, 0, 1))
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward], axis=1)


def quaternion_of(rotation: Floats) -> tuple[float, float, float, float]:
    """w, x, y, z: the eigenvector of Bar-Itzhack's matrix (2000)."""
    (a, b, c), (d, e, f), (g, h, i) = rotation
    matrix = np.array(
        [
            [a - e - i, 0, 0, 0],
            [d + b, e - a - i, 0, 0],
            [g + c, h + f, i - a - e, 0],
            [h - f, c - g, d - b, a + e + i],
        ]
    )
    x, y, z, w = np.linalg.eigh(matrix / 3)[1][:, -1]
    return float(w), float(x), float(y), float(z)


def picture_of(
    centres: Floats,
    colours: NDArray[np.uint8],
    *,
    at: ArrayLike,
    rotation: Floats,
    fov: float,
    size: tuple[int, int],
    edge_m: float,
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Squares of an edge that face the camera, the nearest in front: (rows, columns, 3) and where.

    The edge is that of the square through a cell's centre, `fov` is vertical.
    """
    rows, columns = size
    focal = rows / 2 / np.tan(fov / 2)
    x, y, z = ((centres - np.asarray(at, float)) @ rotation).T
    seen = z > 0.1
    image = np.zeros((rows, columns, 3), np.uint8)
    covered = np.zeros((rows, columns), np.bool_)
    order = np.flatnonzero(seen)[np.argsort(-z[seen])]  # far ones first
    for k in order:
        u, v = columns / 2 + focal * x[k] / z[k], rows / 2 + focal * y[k] / z[k]
        half = focal * edge_m / z[k] / 2
        left, right = int(np.ceil(u - half - 0.5)), int(np.ceil(u + half - 0.5))
        top, bottom = int(np.ceil(v - half - 0.5)), int(np.ceil(v + half - 0.5))
        if right <= 0 or bottom <= 0:
            continue
        part = (slice(max(top, 0), bottom), slice(max(left, 0), right))
        image[part] = colours[k]
        covered[part] = True
    return image, covered
