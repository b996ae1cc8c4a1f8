"""Products of long arrays with small matrices and vectors, on this thread alone.

The algebra library gives a product of some size to a pool of threads that goes on waiting busily
for more: with two cores that takes more CPU than a whole ping.
"""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Real = TypeVar("Real", np.float32, np.float64)

MAX_MULTIPLICATIONS = 2**17
"""Multiplications of one call; the library begins to share them out at twice as many."""


def chunked_matmul(rows: NDArray[Real], matrix: NDArray[Real]) -> NDArray[Real]:
    """The matrix product rows @ matrix, (N, K) by (K, M)."""
    out = np.empty((len(rows), matrix.shape[1]), dtype=np.result_type(rows, matrix))
    step = max(MAX_MULTIPLICATIONS // matrix.size, 1)
    for start in range(0, len(rows), step):
        np.matmul(rows[start : start + step], matrix, out=out[start : start + step])
    return out


def rows_dot(rows: NDArray[np.floating], vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """The products of rows (N, K) with one vector, (N,)."""
    products: NDArray[np.float64] = np.einsum("ij,j->i", rows, vector)
    return products
