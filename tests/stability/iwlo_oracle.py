"""The update rule of docs/mapping.md in decimal arithmetic of fifty digits, step by step."""

from __future__ import annotations

from dataclasses import dataclass

import mpmath
from mpmath import mp, mpf

mp.dps = 50

UNIT = mpf(2) ** -24
"""Log-odds are held in whole units of this."""


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


def sigmoid(x: mpf) -> mpf:
    """1 / (1 + exp(-x))."""
    return 1 / (1 + mpmath.exp(-x))


def log_odds(p: float) -> mpf:
    """log(p / (1 - p)) of the very number that a double holds."""
    return mpmath.log(mpf(p) / (1 - mpf(p)))
