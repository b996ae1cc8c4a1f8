"""Host time of an odometry record: its own clock carried over, or its arrival."""

from mapperd.odometry.records import Odometry
from mapperd.reject import Reject
from oculus_driver.envelope import LowerEnvelope

__all__ = ["OdometryClock"]


class OdometryClock:
    """Carries the stamps of one source over to the host's clock.

    Args:
        max_age_ns: stamps further than this from their arrival are refused.
    """

    def __init__(self, max_age_ns: int) -> None:
        self._max_age_ns = max_age_ns
        self._boot = LowerEnvelope()

    def t_host_ns(self, odometry: Odometry, arrival_ns: int | None) -> int | Reject:
        """The record's host time, on the clock of the arrival stamps.

        Args:
            odometry: the record.
            arrival_ns: when it arrived; None where the recording does not say, which leaves
                only "unix" stamps of use.
        """
        if arrival_ns is None:
            if odometry.clock == "unix":
                return odometry.stamp_ns
            return Reject("no_arrival_time", f"the clock is {odometry.clock}, arrival unknown")
        if odometry.clock == "arrival":
            return arrival_ns
        stamp: int | None = odometry.stamp_ns
        if odometry.clock == "boot":
            stamp = self._boot.to_host_ns(odometry.stamp_ns, arrival_ns)
        if stamp is None or abs(stamp - arrival_ns) > self._max_age_ns:
            return Reject("clock_off", "the stamp and the arrival are too far apart")
        return stamp
