"""Which blocks of the stream lie in what a client is interested in, and how far away they are."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapperd.wire.messages import Interest, Vector

__all__ = ["LEAVE", "distances_m", "in_box", "vector_of", "within"]

LEAVE = 1.1
"""A block that was told is forgotten beyond so many times the radius: at its edge none flickers."""


def vector_of(position_m: ArrayLike | None) -> Vector | None:
    """A position as plain numbers."""
    if position_m is None:
        return None
    x, y, z = np.asarray(position_m, float).tolist()
    return x, y, z


def distances_m(keys: NDArray[np.int32], block_m: float, position_m: Vector) -> NDArray[np.float64]:
    """From a point to the nearest point of each block (N,).

    Args:
        keys: (N, 3).
        block_m: edge of a block.
        position_m: map frame.
    """
    away = np.abs((keys + 0.5) * block_m - np.asarray(position_m)) - block_m / 2
    outside: NDArray[np.float64] = np.linalg.norm(np.maximum(away, 0.0), axis=1)
    return outside


def in_box(keys: NDArray[np.int32], block_m: float, interest: Interest) -> NDArray[np.bool_]:
    """Which blocks (N,) have a part inside the box of an interest."""
    if interest.box is None:
        return np.ones(len(keys), bool)
    low = keys * float(block_m)
    touching = (low < interest.box.high_m) & (low + block_m > interest.box.low_m)
    inside: NDArray[np.bool_] = np.all(touching, axis=1)
    return inside


def within(
    keys: NDArray[np.int32],
    block_m: float,
    interest: Interest,
    position_m: Vector | None,
    held: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    """Which blocks (N,) a client is to be told of.

    Args:
        keys: (N, 3).
        block_m: edge of a block.
        interest: of the client.
        position_m: of the vehicle; where nobody knows it, nothing lies in a radius about it.
        held: (N,), those that it was told of: they go later than they came.
    """
    inside = in_box(keys, block_m, interest)
    if interest.radius_m == 0:
        return inside
    if position_m is None:
        return inside & held
    limit = np.where(held, LEAVE * interest.radius_m, interest.radius_m)
    return inside & (distances_m(keys, block_m, position_m) <= limit)
