"""One experiment: errors after so many updates."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction

import mpmath as mp
import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import Config
from mapperd.geometry.frames import quaternion_product
from mapperd.localization.models import filter_params
from mapperd.localization.particle_filter import ParticleFilter
from mapperd.mapping.sonar_map import SonarMap
from mapperd.odometry.reckoning import DeadReckoning
from mapperd.odometry.states import Attitude, carry_attitude
from oculus_driver.clock_fit import ClockFit

__all__ = [
    "Curve",
    "GrowthPanel",
    "checkpoints",
    "clock",
    "echoes",
    "log_odds",
    "turns",
    "way",
    "weights",
]


Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Curve:
    """What one way of computing is off by.

    Attributes:
        label: in the legend.
        error: at every checkpoint; NaN where the numbers are not finite.
        ours: the product's; others are what a plain program would do.
    """

    label: str
    error: Floats
    ours: bool


@dataclass(frozen=True, slots=True)
class GrowthPanel:
    """One picture.

    Attributes:
        title: what is updated.
        unit: of the error.
        updates: number of updates at every checkpoint.
        curves: ours first.
        oracle: by what they are judged.
    """

    title: str
    unit: str
    updates: NDArray[np.int64]
    curves: tuple[Curve, ...]
    oracle: str


def checkpoints(updates: int, count: int = 90) -> NDArray[np.int64]:
    """Numbers of updates, evenly on a logarithmic scale, the last of them all."""
    return np.unique(np.geomspace(1, updates, count).round().astype(np.int64))


UNIT = 2.0**-24
"""Of log-odds as the map hands them out; it holds whole multiples of 2^-11."""

OCCUPIED_SHARE = 0.45


def log_odds(updates: int, seed: int = 1) -> GrowthPanel:
    """A voxel that is seen now free, now occupied, at all intensities."""
    chance = np.random.default_rng(seed)
    # Stretches of one kind, so that both clamps, and the way between them, are visited.
    kind = np.repeat(chance.random(updates // 7 + 1) < OCCUPIED_SHARE, 7)[:updates]
    intensity = chance.uniform(0.0, 255.0, updates)
    at = checkpoints(updates)
    ours = _held(kind, intensity, at)
    exact = _followed(kind, intensity, at, single=False)
    single = _followed(kind, intensity, at, single=True)
    return GrowthPanel(
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


S = 1_000_000_000
EPOCH_NS = 1_700_000_000 * S


def turns(updates: int) -> GrowthPanel:
    """A vehicle that turns by some thousandths of a radian, a million times about one axis."""
    axis, step = np.array([0.36, -0.48, 0.8]), 0.003
    at = checkpoints(updates)
    wanted = set(at.tolist())
    half = step / 2
    turn = np.array([math.cos(half), *(math.sin(half) * axis)])
    matrix = _matrix32(turn)
    attitude = Attitude(np.array([1.0, 0, 0, 0]), step * axis, np.eye(3))
    plain, single = attitude.map_q_base, np.eye(3, dtype=np.float32)
    errors: list[tuple[float, float, float]] = []
    for k in range(1, updates + 1):
        carried = carry_attitude(attitude, 1.0)
        if carried is None:
            raise ValueError("an attitude with a rate goes on")
        attitude = carried
        plain = quaternion_product(plain, turn)
        single = single @ matrix
        if k in wanted:
            with mp.workdps(40):
                exact = mp.mpf(step) * k / 2
                ends = (float(mp.cos(exact)), *(float(mp.sin(exact)) * axis))
            errors.append(
                (
                    float(np.abs(attitude.map_q_base - ends).max()),
                    abs(float(np.linalg.norm(plain)) - 1.0),
                    float(np.abs(single @ single.T - np.eye(3)).max()),
                )
            )
    ours, norm, sheared = np.array(errors).T
    return GrowthPanel(
        "attitude carried on by small turns",
        "rad; part",
        at,
        (
            Curve("attitude, made of unit length each time (ours)", ours, ours=True),
            Curve("length, never made 1 again", norm, ours=False),
            Curve("shear of a single-precision matrix", sheared, ours=False),
        ),
        "the angle times the number of turns, 40 digits",
    )


def _matrix32(turn: Floats) -> NDArray[np.float32]:
    w, x, y, z = turn
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(rows, dtype=np.float32)


def way(updates: int, seed: int = 2) -> GrowthPanel:
    """Dead reckoning at 10 Hz and about 1 m/s: a million steps are 28 hours and 100 km."""
    speed = np.random.default_rng(seed).uniform(0.5, 1.5, updates + 1)
    at = checkpoints(updates)
    reckoning = DeadReckoning(S, 0.1)
    ours = np.empty(len(at))
    place = 0
    for k in range(updates + 1):
        reckoning.add(EPOCH_NS + k * S // 10, np.array([speed[k], 0.0, 0.0]), in_map=True)
        reckoning.advance(lambda _t_ns: None, None)
        if place < len(at) and k == at[place]:
            end = reckoning.displacements.newest
            ours[place] = math.nan if end is None else end.value.displacement_m[0]
            place += 1
    steps = 0.05 * (speed[1:] + speed[:-1])
    exact = _summed(speed, at)
    single = np.cumsum(steps.astype(np.float32), dtype=np.float32)[at - 1]
    return GrowthPanel(
        "way summed up by dead reckoning",
        "m",
        at,
        (
            Curve("double precision (ours)", np.abs(ours - exact), ours=True),
            Curve("single precision", np.abs(single - exact), ours=False),
        ),
        "exact fractions",
    )


def _summed(speed: Floats, at: NDArray[np.int64]) -> Floats:
    """The trapezoids, summed up in whole numbers: each speed is a multiple of 2^-60."""
    whole = [int(Fraction(value) * 2**60) for value in speed.tolist()]
    held, total, place = [], 0, 0
    for k in range(1, len(whole)):
        total += whole[k - 1] + whole[k]
        if place < len(at) and k == at[place]:
            held.append(float(Fraction(total, 20 * 2**60)))
            place += 1
    return np.array(held)


def clock(updates: int, ppm: int = 87) -> GrowthPanel:
    """A sender's clock that drifts, followed by a record every 2 s: a million are 23 days."""
    at = checkpoints(updates)
    wanted = set(at.tolist())
    fit, slow = ClockFit(), Fraction(1_000_000 - ppm, 1_000_000)
    n = sx = sy = sxx = sxy = 0.0
    errors: list[tuple[float, float]] = []
    for k in range(1, updates + 1):
        true_ns = 2 * S * k
        stamp_ns = round(true_ns * slow)
        host = fit.to_host_ns(stamp_ns, EPOCH_NS + true_ns)
        # What a running least-squares line over Unix seconds does.
        x, y = (EPOCH_NS + true_ns) / S, (EPOCH_NS + true_ns - stamp_ns) / S
        n, sx, sy, sxx, sxy = n + 1, sx + x, sy + y, sxx + x * x, sxy + x * y
        if k in wanted:
            over = n * sxx - sx * sx
            slope = (n * sxy - sx * sy) / over if over else 0.0
            plain = stamp_ns / S + (sy - slope * sx) / n + slope * x
            error = math.nan if host is None else (host - EPOCH_NS - true_ns) / S
            errors.append((abs(error), abs(plain - x)))
    ours, squares = np.array(errors).T
    return GrowthPanel(
        f"clock that drifts by {ppm} ppm, fitted all along",
        "s",
        at,
        (
            Curve("lower envelope in whole nanoseconds (ours)", ours, ours=True),
            Curve("running least squares of Unix seconds", squares, ours=False),
        ),
        "exact fractions",
    )


PARTICLES = 64
GRAIN = 2.0**-12
"""Log-likelihoods are whole multiples of this, so that a double holds their sums exactly."""


def weights(updates: int, seed: int = 3) -> GrowthPanel:
    """Particles weighed a million times and never resampled."""
    chance = np.random.default_rng(seed)
    particles = ParticleFilter(filter_params(Config()), 1)
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
    return GrowthPanel(
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


def echoes(updates: int, seed: int = 4) -> GrowthPanel:
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
    return GrowthPanel(
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
