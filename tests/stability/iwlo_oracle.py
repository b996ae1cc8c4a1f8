"""The update rule of docs/concepts/mapping.md in fifty digits and in the map's whole units."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mpmath
import numpy as np
from mpmath import mp, mpf

mp.dps = 50

UNIT = mpf(2) ** -24
"""Outside the map log-odds are whole numbers of this; inside, of 2^-11 or coarser ones."""


@dataclass(frozen=True)
class Rule:
    """The settings that a case varies; the others are the defaults."""

    L_occ: float = 3.5
    L_free: float = -3.0
    L_min: float = -10.0
    L_max: float = 10.0
    sharpness: float = 3.0
    decay_rate: float = 0.1
    min_alpha: float = 0.1
    intensity_threshold: float = 35.0
    intensity_max: float = 255.0
    adaptive_update: bool = True
    adaptive_threshold: float = 0.5
    adaptive_max_ratio: float = 0.3
    adaptive_min_ratio: float = 0.25
    protect_occupied: bool = True

    def alpha(self, count: int) -> mpf:
        """The learning rate."""
        return max(mpf(self.min_alpha), 1 / (1 + mpf(self.decay_rate) * count))

    def weight(self, intensity: float) -> mpf:
        """w(I)."""
        threshold, most = mpf(self.intensity_threshold), mpf(self.intensity_max)
        if not mpf(intensity) > threshold:
            return mpf(0)
        x = min((mpf(intensity) - threshold) / (most - threshold), mpf(1))
        return sigmoid(mpf(self.sharpness) * (x - mpf("0.5")))

    def occupied_step(self, log_odds: float, count: int, weight: float) -> mpf:
        """Of a return."""
        full, p = mpf(self.L_occ) * mpf(weight), sigmoid(mpf(log_odds))
        rate = self.alpha(count)
        threshold = mpf(self.adaptive_threshold)
        if self.adaptive_update and p < threshold:
            rate = max(
                rate * p / threshold * mpf(self.adaptive_max_ratio), mpf(self.adaptive_min_ratio)
            )
        return full * rate

    def free_step(self, log_odds: float, count: int) -> mpf:
        """Of water that was seen through."""
        scale, p, threshold = mpf(1), sigmoid(mpf(log_odds)), mpf(self.adaptive_threshold)
        excess = p - (1 - threshold)
        if self.adaptive_update and self.protect_occupied and excess > 0:
            ratio = mpf(self.adaptive_max_ratio)
            scale = ratio + (1 - ratio) * (1 - excess / threshold)
        return mpf(self.L_free) * self.alpha(count) * scale

    def after(self, log_odds: float, count: int, *, occupied: bool, weight: float = 1.0) -> mpf:
        """The log-odds after one ping, not rounded to units."""
        step = (
            self.occupied_step(log_odds, count, weight)
            if occupied
            else self.free_step(log_odds, count)
        )
        return min(max(mpf(log_odds) + step, mpf(self.L_min)), mpf(self.L_max))


class WholeRule:
    """The rule in whole units and in factors of 2^-15, a ping at a time; with Python's integers.

    Written down a second time from cpp/map/include/mapperd/map/iwlo.hpp.

    Attributes:
        shift: a unit is 2^-shift.
        unit: of log-odds.
        settled: counts stop there.
    """

    def __init__(self, rule: Rule) -> None:
        self.rule = rule
        span = rule.L_max - rule.L_min
        largest = max(-rule.L_min, rule.L_max, min(rule.L_occ, span), min(-rule.L_free, span))
        self.shift = max(s for s in range(12) if largest * 2**s <= 127 * 2**8)
        self.unit = 2.0**-self.shift
        self.low, self.high = self._whole(rule.L_min), self._whole(rule.L_max)
        learns = rule.decay_rate > 0 and rule.min_alpha < 1
        settles = (1 / rule.min_alpha - 1) / rule.decay_rate if learns else 1
        self.settled = max(1, math.ceil(settles))

    def after_ping(self, units: int, count: int, code: int | None = None) -> tuple[int, int]:
        """A voxel's state after a ping: occupied with that code of a weight, or free."""
        if code is None:
            step = -self._free(units, count)
        else:
            step = self._occupied(units, count, self.full_of(code))
        return self._counted(units + step, count)

    def after_point(
        self, units: int, count: int, *, occupied: bool, factor: float = 1.0
    ) -> tuple[int, int]:
        """After a point of full scale, or a free one, without adaptive update: rounded once."""
        rule = self.rule
        assert not rule.adaptive_update
        full = rule.L_occ / (1 + math.exp(-rule.sharpness / 2)) if occupied else rule.L_free
        alpha = max(rule.min_alpha, 1 / (1 + rule.decay_rate * count))
        return self._counted(units + round(factor * (full * alpha) / self.unit), count)

    def full_of(self, code: int) -> int:
        """An occupied step before rate and scale; codes 2 to 255 divide the weights evenly."""
        least, largest = (
            self._whole(self.rule.L_occ / (1 + math.exp(half * self.rule.sharpness)))
            for half in (0.5, -0.5)
        )
        slope = _nearest((largest - least) * 2**15 / (253 * 128))
        return least + _times((code - 2) * 128, slope)

    def _free(self, units: int, count: int) -> int:
        rule = self.rule
        down = _times(self._whole(-rule.L_free), self._alpha(count))
        excess = _sigmoid(units * self.unit) - (1 - rule.adaptive_threshold)
        if not (rule.adaptive_update and rule.protect_occupied and excess > 0):
            return down
        ratio = rule.adaptive_max_ratio
        return _times(down, _q15(1 - (1 - ratio) * (excess / rule.adaptive_threshold)))

    def _occupied(self, units: int, count: int, full: int) -> int:
        rule, p, alpha = self.rule, _sigmoid(units * self.unit), self._alpha(count)
        if not rule.adaptive_update or p >= rule.adaptive_threshold:
            return _times(full, alpha)
        scale = _q15(p / rule.adaptive_threshold * rule.adaptive_max_ratio)
        return _times(full, max(_times(alpha, scale), _q15(rule.adaptive_min_ratio)))

    def _alpha(self, count: int) -> int:
        one = np.float32(1)
        exact = one / (one + np.float32(self.rule.decay_rate) * np.float32(count))
        rate = max(np.float32(self.rule.min_alpha), exact)
        return min(int(rate * np.float32(2**15) + np.float32(0.5)), 2**15 - 1)

    def _counted(self, units: int, count: int) -> tuple[int, int]:
        return min(max(units, self.low), self.high), min(count + 1, self.settled)

    def _whole(self, value: float) -> int:
        return _nearest(value * 2**self.shift)


def _nearest(value: float) -> int:
    """Halves away from 0."""
    return int(math.copysign(math.floor(abs(value) + 0.5), value))


def _times(a: int, b: int) -> int:
    """In parts of 2^15, halves up."""
    return (a * b + 2**14) >> 15


def _q15(value: float) -> int:
    return min(_nearest(value * 2**15), 2**15 - 1)


def _sigmoid(x: float) -> float:
    return 1 / (1 + math.exp(-x))


def sigmoid(x: mpf) -> mpf:
    """1 / (1 + exp(-x))."""
    return 1 / (1 + mpmath.exp(-x))


def log_odds(p: float) -> mpf:
    """log(p / (1 - p)) of the very number that a double holds."""
    return mpmath.log(mpf(p) / (1 - mpf(p)))
