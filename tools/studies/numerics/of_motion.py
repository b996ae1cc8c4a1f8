"""Long runs of motion: turns one after another, a way summed up, a clock fitted all along."""

import math
from fractions import Fraction

import mpmath as mp
import numpy as np
from numpy.typing import NDArray

from mapperd.geometry.frames import quaternion_product
from mapperd.odometry.reckoning import DeadReckoning
from mapperd.odometry.states import Attitude, carry_attitude
from oculus_driver.clock_fit import ClockFit
from studies.numerics.panel import Curve, Panel, checkpoints

__all__ = ["clock", "turns", "way"]

Floats = NDArray[np.float64]
S = 1_000_000_000
EPOCH_NS = 1_700_000_000 * S


def turns(updates: int) -> Panel:
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
    return Panel(
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


def way(updates: int, seed: int = 2) -> Panel:
    """Dead reckoning at 10 Hz and about 1 m/s: a million steps are 28 hours and 100 km."""
    speed = np.random.default_rng(seed).uniform(0.5, 1.5, updates + 1)
    at = checkpoints(updates)
    reckoning = DeadReckoning(S, 0.1)
    ours = np.empty(len(at))
    place = 0
    for k in range(updates + 1):
        reckoning.add(EPOCH_NS + k * S // 10, np.array([speed[k], 0.0, 0.0]), in_map=True)
        reckoning.go_on(lambda _t_ns: None, None)
        if place < len(at) and k == at[place]:
            end = reckoning.ways.newest
            ours[place] = math.nan if end is None else end.value.way_m[0]
            place += 1
    steps = 0.05 * (speed[1:] + speed[:-1])
    exact = _summed(speed, at)
    single = np.cumsum(steps.astype(np.float32), dtype=np.float32)[at - 1]
    return Panel(
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


def clock(updates: int, ppm: int = 87) -> Panel:
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
    return Panel(
        f"clock that drifts by {ppm} ppm, fitted all along",
        "s",
        at,
        (
            Curve("lower envelope in whole nanoseconds (ours)", ours, ours=True),
            Curve("running least squares of Unix seconds", squares, ours=False),
        ),
        "exact fractions",
    )
