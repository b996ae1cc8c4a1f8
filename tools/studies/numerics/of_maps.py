"""Long runs of the map: one voxel under a million mixed steps."""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import Config
from mapperd.mapping.sonar_map import SonarMap
from studies.numerics.panel import Curve, Panel, checkpoints

__all__ = ["log_odds"]

Floats = NDArray[np.float64]
UNIT = 2.0**-24
"""Of log-odds as the map hands them out; it holds whole multiples of 2^-11."""

OCCUPIED_SHARE = 0.45


def log_odds(updates: int, seed: int = 1) -> Panel:
    """A voxel that is seen now free, now occupied, at all intensities."""
    chance = np.random.default_rng(seed)
    # Stretches of one kind, so that both clamps, and the way between them, are visited.
    kind = np.repeat(chance.random(updates // 7 + 1) < OCCUPIED_SHARE, 7)[:updates]
    intensity = chance.uniform(0.0, 255.0, updates)
    at = checkpoints(updates)
    ours = _held(kind, intensity, at)
    exact = _followed(kind, intensity, at, single=False)
    single = _followed(kind, intensity, at, single=True)
    return Panel(
        "log-odds of a voxel",
        "log-odds",
        at,
        (
            Curve("whole units of 2^-11 (ours)", np.abs(ours - exact), ours=True),
            Curve("single precision", np.abs(single - exact), ours=False),
        ),
        "the same rule in double precision",
    )


def _held(kind: NDArray[np.bool_], intensity: Floats, at: NDArray[np.int64]) -> Floats:
    """What the map holds at the checkpoints."""
    core = SonarMap(Config()).core
    held = np.empty(len(at))
    first = 0
    for place, last in enumerate(at):
        points = np.full((last - first, 3), 0.01)
        core.observe(points, intensity[first:last], kind[first:last], None)
        _, units, counts = core.blocks()
        held[place] = units[counts > 0][0] * UNIT
        first = int(last)
    return held


def _followed(
    kind: NDArray[np.bool_], intensity: Floats, at: NDArray[np.int64], *, single: bool
) -> Floats:
    """The rule of docs/concepts/mapping.md, a second time; `single` rounds what is stored."""
    wanted, held = set(at.tolist()), []
    for count, value in enumerate(_states(kind.tolist(), intensity.tolist(), single=single), 1):
        if count in wanted:
            held.append(value)
    return np.array(held)


def _states(kind: list[bool], intensity: list[float], *, single: bool) -> Iterator[float]:
    settings = Config()
    rule, adaptive = settings.iwlo, settings.adaptive
    low = settings.filtering.intensity_threshold
    rounded = np.float32 if single else float
    value = 0.0
    for count, (occupied, echo) in enumerate(zip(kind, intensity, strict=True)):
        alpha = max(rule.min_alpha, 1.0 / (1.0 + rule.decay_rate * count))
        p = 1.0 / (1.0 + math.exp(-value))
        if occupied:
            share = min(max((echo - low) / (rule.intensity_max - low), 0.0), 1.0)
            weight = 1.0 / (1.0 + math.exp(-rule.sharpness * (share - 0.5))) if echo > low else 0.0
            rate = alpha
            if adaptive.update and p < adaptive.threshold:
                rate = max(alpha * p / adaptive.threshold * adaptive.max_ratio, adaptive.min_ratio)
            step = rule.L_occ * weight * rate
        else:
            scale, excess = 1.0, p - (1.0 - adaptive.threshold)
            if adaptive.update and adaptive.protect_occupied and excess > 0:
                part = excess / adaptive.threshold
                scale = adaptive.max_ratio + (1.0 - adaptive.max_ratio) * (1.0 - part)
            step = rule.L_free * alpha * scale
        value = float(rounded(min(max(value + step, rule.L_min), rule.L_max)))
        yield value
