"""Whether the source is sure enough of itself: the quality gate."""

from mapperd.config.odometry import SlamQuality
from mapperd.reject import Reject

__all__ = ["ConfidenceGate"]


class ConfidenceGate:
    """Lets pings pass while the last confidence is fresh and high enough.

    Args:
        settings: threshold, times, and what a missing confidence means.

    Attributes:
        settings: may be set anew.
    """

    def __init__(self, settings: SlamQuality) -> None:
        self.settings = settings
        self._first_ns: int | None = None
        self._last: tuple[int, float] | None = None
        self.unchecked = 0
        """Pings that passed without a fresh confidence."""

    @property
    def confidence(self) -> float | None:
        """The newest one; None where none was ever said."""
        return None if self._last is None else self._last[1]

    def heard(self, t_ns: int, confidence: float | None) -> None:
        """Take note of a record, with or without a confidence."""
        if self._first_ns is None:
            self._first_ns = t_ns
        if confidence is not None:
            self._last = (t_ns, confidence)

    def check(self, t_ns: int) -> Reject | None:
        """Why a ping of that moment may not be mapped; None where it may."""
        settings = self.settings
        if self._last is None:
            grace_ns = round(settings.grace_period_sec * 1e9)
            if self._first_ns is None or t_ns - self._first_ns <= grace_ns:
                return None
            return self._missing("the odometry never said how sure it is")
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
