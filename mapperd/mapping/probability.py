"""Between probabilities and log-odds."""

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["log_odds_of", "probabilities_of"]

LARGEST_EXPONENT = 700.0
"""Beyond it exp overflows a double; a probability of so many log-odds is 1e-304."""


def log_odds_of(probability: float, name: str) -> float:
    """Natural log-odds of a probability.

    Args:
        probability: strictly between 0 and 1.
        name: what to call it in the message.

    Raises:
        ValueError: it lies outside.
    """
    if not 0 < probability < 1:
        raise ValueError(f"{name} must lie between 0 and 1, not {probability!r}")
    return math.log(probability / (1 - probability))


def probabilities_of(log_odds: NDArray[np.floating]) -> NDArray[np.float64]:
    """Probabilities, float64, of log-odds of any shape."""
    exponent = np.minimum(-log_odds.astype(np.float64), LARGEST_EXPONENT)
    return np.asarray(1 / (1 + np.exp(exponent)), dtype=np.float64)
