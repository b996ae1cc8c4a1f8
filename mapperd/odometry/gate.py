"""Checks odometry records: finite numbers, and enough confidence.

Decoders check data from a wire against the limits of each quantity. Records may also come from a
program that uses the library, so every record is checked again: one NaN would stay in the series
and spoil all poses next to it.
"""

from typing import NamedTuple

from mapperd.config.odometry import SlamQualityConfig
from mapperd.errors import Reject
from mapperd.geometry.frames import UNIT_TOLERANCE
from mapperd.odometry.records import Odometry, bad_numbers

__all__ = ["ConfidenceGate", "GateState", "bad_record"]


class GateState(NamedTuple):
    """State of a `ConfidenceGate`: time of the first record, last confidence and its time."""

    first_ns: int | None
    last: tuple[int, float] | None
    unchecked: int


class ConfidenceGate:
    """Lets pings pass while the last confidence is fresh and high enough.

    Args:
        settings: threshold, times, and the meaning of a missing confidence.

    Attributes:
        settings: may be changed.
    """

    def __init__(self, settings: SlamQualityConfig) -> None:
        self.settings = settings
        self._first_ns: int | None = None
        self._last: tuple[int, float] | None = None
        self.unchecked = 0
        """Number of pings that passed without a fresh confidence."""

    def state(self) -> GateState:
        """Return the state for `restore`."""
        return GateState(self._first_ns, self._last, self.unchecked)

    def restore(self, state: GateState) -> None:
        """Restore the state of a gate."""
        self._first_ns, self._last, self.unchecked = state

    @property
    def confidence(self) -> float | None:
        """The newest confidence, or None before the first."""
        return None if self._last is None else self._last[1]

    def heard(self, t_ns: int, confidence: float | None) -> None:
        """Note a record, with or without a confidence."""
        if self._first_ns is None:
            self._first_ns = t_ns
        if confidence is not None:
            self._last = (t_ns, confidence)

    def check(self, t_ns: int) -> Reject | None:
        """Return why a ping at that time must not be mapped; None if it may."""
        settings = self.settings
        if self._last is None:
            grace_ns = round(settings.grace_period_sec * 1e9)
            if self._first_ns is None or t_ns - self._first_ns <= grace_ns:
                return None
            return self._missing("the odometry never reported its confidence")
        age_s = (t_ns - self._last[0]) / 1e9
        if age_s > settings.stale_timeout_sec:
            return self._missing(f"the last confidence is {age_s:.1f} s old")
        if self._last[1] < settings.threshold:
            return Reject(
                "low_confidence", f"confidence {self._last[1]:g}; at least {settings.threshold:g}"
            )
        return None

    def _missing(self, why: str) -> Reject | None:
        if self.settings.fail_mode == "closed":
            return Reject("no_confidence", f"{why}, and slam_quality.fail_mode is closed")
        self.unchecked += 1
        return None


MAX_NUMBER = 1e12
"""Limit of any number in its unit; no valid value is larger."""

ARRAYS = (
    "position_m",
    "velocity_mps",
    "rate_radps",
    "velocity_map_mps",
    "velocity_east_north_mps",
    "specific_force_mps2",
    "pose_covariance",
    "twist_covariance",
)
NUMBERS = ("depth_m", "heading_rad", "altitude_m", "confidence")


def bad_record(odometry: Odometry) -> Reject | None:
    """Return why a record is invalid: a number that is not finite or impossible, or no rotation."""
    for key in ARRAYS:
        array = getattr(odometry, key)
        if array is not None and (bad := bad_numbers(key, array.ravel().tolist(), MAX_NUMBER)):
            return bad
    scalars = [getattr(odometry, key) for key in NUMBERS]
    if (geo := odometry.geo) is not None:
        scalars += [geo.latitude_rad, geo.longitude_rad, geo.altitude_m]
    given = [number for number in scalars if number is not None]
    if bad := bad_numbers("the record", given, MAX_NUMBER):
        return bad
    if (turn := odometry.map_q_base) is None:
        return None
    square = sum(number * number for number in turn.tolist())
    if not abs(square - 1.0) <= UNIT_TOLERANCE:  # also where it is NaN
        return Reject("no_rotation", f"map_q_base has the norm {square**0.5:.4g}, not 1")
    return None
