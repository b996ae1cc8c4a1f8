"""Long runs of sums: logarithms of weights, and echoes that fall into one cell."""

import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import Config
from mapperd.localization.models import filter_rule
from mapperd.localization.particle_filter import ParticleFilter
from studies.numerics.panel import Curve, Panel, checkpoints

__all__ = ["echoes", "weights"]

Floats = NDArray[np.float64]
PARTICLES = 64
GRAIN = 2.0**-12
"""Log-likelihoods are whole multiples of this, so that a double holds their sums exactly."""


def weights(updates: int, seed: int = 3) -> Panel:
    """Particles weighed a million times and never resampled."""
    chance = np.random.default_rng(seed)
    particles = ParticleFilter(filter_rule(Config()), 1)
    particles.start_with(chance.normal(size=(PARTICLES, 3)))
    at = checkpoints(updates)
    wanted = set(at.tolist())
    exact = np.zeros(PARTICLES)
    product, single = np.ones(PARTICLES), np.zeros(PARTICLES, np.float32)
    errors: list[tuple[float, float, float]] = []
    for k in range(1, updates + 1):
        # Pulled back towards their mean, or one particle soon has all the weight; and all of them
        # unlikely, as a scan of many beams is.
        pull = -0.02 * (exact - exact.mean())
        logs = GRAIN * np.rint((pull + chance.normal(0.0, 0.2, PARTICLES) - 5.0) / GRAIN)
        particles.weigh(logs, 1)
        exact += logs
        product *= np.exp(logs)
        single += logs.astype(np.float32)
        if k in wanted:
            truth = _shares(exact)
            with np.errstate(invalid="ignore"):
                plain = product / product.sum()
            errors.append(
                (
                    float(np.abs(particles.weights / truth - 1.0).max()),
                    float(np.abs(plain / truth - 1.0).max()),
                    float(np.abs(_shares(single.astype(np.float64)) / truth - 1.0).max()),
                )
            )
    ours, multiplied, rounded = np.array(errors).T
    return Panel(
        "weights of particles, never resampled",
        "part of the weight",
        at,
        (
            Curve("logarithms, brought to sum 1 (ours)", ours, ours=True),
            Curve("products (0 / 0 where the curve ends)", multiplied, ours=False),
            Curve("logarithms in single precision", rounded, ours=False),
        ),
        "sums of whole multiples of 2^-12",
    )


def _shares(logs: Floats) -> Floats:
    shares = np.exp(logs - logs.max())
    return np.asarray(shares / shares.sum())


def echoes(updates: int, seed: int = 4) -> Panel:
    """Echoes of random phase in one cell of the simulator, whose cells are single precision."""
    chance = np.random.default_rng(seed)
    phase = chance.uniform(0.0, 2.0 * np.pi, updates)
    field = np.exp(1j * phase).astype(np.complex64)
    at = checkpoints(updates)
    exact = np.cumsum(field, dtype=np.complex128)[at - 1]
    single = np.cumsum(field, dtype=np.complex64)[at - 1].astype(np.complex128)
    decibels = 20.0 * np.abs(np.log10(np.abs(single) / np.abs(exact)))
    levels = _levels32(updates, set(at.tolist()))
    equal = np.abs(levels - 10.0 * np.log10(at))
    return Panel(
        "echoes added up in one cell",
        "dB",
        at,
        (
            Curve("fields in single precision (ours)", decibels, ours=True),
            Curve("levels of equal echoes added in single precision", equal, ours=False),
        ),
        "the same numbers added in double precision",
    )


def _levels32(updates: int, wanted: set[int]) -> Floats:
    """Echoes of 0 dB added as levels: each sum is a level again."""
    ten, one = np.float32(10.0), np.float32(1.0)
    held, level = [], np.float32(0.0)
    for k in range(1, updates + 1):
        if k > 1:
            level = ten * np.log10(ten ** (level / ten) + one)
        if k in wanted:
            held.append(float(level))
    return np.array(held)
