"""Converts times of odometry records to the host's clock, and selects the best of several messages.

An autopilot may send one quantity in several messages, for example the attitude as angles and as a
quaternion. Only the best of them is used: both in one series would be noisier and out of order.
"""

from collections import deque
from dataclasses import replace
from typing import Any, NamedTuple

from mapperd.errors import Reject
from mapperd.odometry.records import Odometry
from oculus_driver.clock_fit import ClockFit, ClockFitState

__all__ = ["Leaders", "OdometryClock", "OdometryClockState", "Precedence"]

DISTRUST_AFTER = 10
"""Consecutive impossible Unix stamps after which the sender's clock counts as not set."""

STEP_NS = 50_000_000
"""Growth of the minimum delay that shows that the sender's clock was set back."""

AHEAD_NS = 5_000_000
"""Lead of a stamp over its arrival that shows that the clocks differ."""


class OdometryClockState(NamedTuple):
    """State of an `OdometryClock`.

    Attributes:
        fit: fit of the sender's clock to the host's.
        off: consecutive records whose stamp was too far from their arrival.
        distrusted: Unix stamps are fitted too.
        delays_ns: the last delays.
        least_delay_ns: minimum delay so far.
        offset_ns: newest Unix stamp minus its arrival if they disagree.
    """

    fit: ClockFitState
    off: int
    distrusted: bool
    delays_ns: list[int]
    least_delay_ns: int | None
    offset_ns: int | None = None


class OdometryClock:
    """Converts the stamps of one source to the host's clock.

    Unix stamps are used as they are while they agree with the arrivals; others are fitted. A clock
    that is always behind by less than `max_age_ns` agrees, because it looks like a slow sender. A
    clock that is set back is detected.

    Args:
        max_age_ns: stamps further than this from their arrival are refused.
        latency_ns: minimum delay of the link, which no fit can measure; it is subtracted.

    Attributes:
        max_age_ns: may be changed.
        offset_ns: newest Unix stamp minus its arrival if they disagree, else None.
    """

    offset_ns: int | None = None

    def __init__(self, max_age_ns: int, latency_ns: int = 0) -> None:
        self.max_age_ns = max_age_ns
        self._latency_ns = latency_ns
        self._fit = ClockFit()
        self._off = 0  # records in a row
        self._distrusted = False
        self._delays: deque[int] = deque(maxlen=DISTRUST_AFTER)
        self._min_delay_ns: int | None = None

    @property
    def is_distrusted(self) -> bool:
        """Whether Unix stamps are fitted, as the sender's clock was found wrong."""
        return self._distrusted

    def state(self) -> OdometryClockState:
        """Return the state for `restore`."""
        return OdometryClockState(
            self._fit.state(),
            self._off,
            self._distrusted,
            list(self._delays),
            self._min_delay_ns,
            self.offset_ns,
        )

    def restore(self, state: OdometryClockState) -> None:
        """Restore the state of a clock."""
        self._fit.restore(state.fit)
        self._off, self._distrusted = state.off, state.distrusted
        self._delays = deque(state.delays_ns, maxlen=DISTRUST_AFTER)
        self._min_delay_ns = state.least_delay_ns
        self.offset_ns = state.offset_ns

    def t_host_ns(self, odometry: Odometry, arrival_ns: int | None) -> int | Reject:
        """Return the record's host time, on the clock of the arrival stamps.

        Args:
            odometry: the record.
            arrival_ns: arrival time; None if the recording has none; then only "unix" stamps
                are usable.
        """
        if arrival_ns is None:
            if odometry.clock == "unix":
                return odometry.stamp_ns
            return Reject("no_arrival_time", f"the clock is {odometry.clock}, arrival unknown")
        if odometry.clock == "arrival":
            return arrival_ns - self._latency_ns
        if odometry.clock == "unix" and not self._distrusted:
            stamp: int | None = odometry.stamp_ns
        else:
            stamp = self._carried_over(odometry, arrival_ns)
        self.offset_ns = self._disagreement(odometry, arrival_ns)
        off = stamp is None or abs(stamp - arrival_ns) > self.max_age_ns
        ahead = stamp is not None and stamp - arrival_ns > AHEAD_NS
        self._off = self._off + 1 if off or ahead else 0
        if (
            odometry.clock == "unix"
            and not self._distrusted
            and self._stepped_back(odometry, arrival_ns)
        ):
            self._distrusted = True
            return Reject("clock_off", "the sender's clock was set back; it is fitted from now on")
        # A clock that was never set still gives valid intervals between records.
        self._distrusted = self._distrusted or self._off >= DISTRUST_AFTER
        if stamp is None or off:
            return Reject("clock_off", "the stamp and the arrival are too far apart")
        return stamp

    def _disagreement(self, odometry: Odometry, arrival_ns: int) -> int | None:
        """Return by how much a fitted Unix stamp is off; None within the delay of a link."""
        if odometry.clock != "unix" or not self._distrusted:
            return None
        offset_ns = odometry.stamp_ns - arrival_ns
        return None if -STEP_NS <= offset_ns <= AHEAD_NS else offset_ns

    def _stepped_back(self, odometry: Odometry, arrival_ns: int) -> bool:
        """Whether each of the last records had a larger delay than any before."""
        sent_ns = odometry.stamp_ns if odometry.sent_ns is None else odometry.sent_ns
        self._delays.append(arrival_ns - sent_ns)
        if len(self._delays) < DISTRUST_AFTER:
            return False
        min_ns, now_ns = self._min_delay_ns, min(self._delays)
        self._min_delay_ns = now_ns if min_ns is None else min(min_ns, now_ns)
        return min_ns is not None and now_ns - min_ns > STEP_NS

    def _carried_over(self, odometry: Odometry, arrival_ns: int) -> int | None:
        """Return the time by the fit, preferably of the stamps of sending."""
        sent_ns = odometry.stamp_ns if odometry.sent_ns is None else odometry.sent_ns
        sent_host_ns = self._fit.to_host_ns(sent_ns, arrival_ns)
        if sent_host_ns is None:
            return None
        return sent_host_ns - self._latency_ns + odometry.stamp_ns - sent_ns


SILENCE_NS = 2 * 10**9
"""Silence of the better message after which the next best is used."""

QUANTITIES = {
    "position_m": "position",
    "geo": "position",
    "pose_covariance": "position",
    "velocity_mps": "velocity",
    "velocity_map_mps": "velocity",
    "velocity_east_north_mps": "velocity",
    "twist_covariance": "velocity",
    "map_q_base": "attitude",
    "heading_rad": "attitude",
    "rate_radps": "attitude",
}
"""Quantities that several messages carry, by field."""


Leaders = dict[str, tuple[int, int | None]]
"""Rank of the message that provides each quantity, and its last arrival."""


class Precedence:
    """Remembers which message provides each quantity.

    Args:
        order: messages, best first.
    """

    def __init__(self, order: tuple[str, ...]) -> None:
        self._rank = {name: rank for rank, name in enumerate(order)}
        self._leaders: Leaders = {}

    def state(self) -> Leaders:
        """Return the state for `restore`."""
        return dict(self._leaders)

    def restore(self, state: Leaders) -> None:
        """Restore a state that `state` returned."""
        self._leaders = dict(state)

    def filtered(self, name: str, odometry: Odometry, arrival_ns: int | None) -> Odometry | None:
        """Remove the quantities that a better message provides; None if nothing is left."""
        carried = {
            field: quantity
            for field, quantity in QUANTITIES.items()
            if getattr(odometry, field) is not None
        }
        if name not in self._rank or not carried:
            return odometry
        better = {
            quantity
            for quantity in set(carried.values())
            if not self._leads(
                quantity,
                self._rank[name],
                # A heading alone is the attitude of a level vehicle: never compare its time.
                None if quantity == "attitude" and odometry.map_q_base is None else arrival_ns,
            )
        }
        without: dict[str, Any] = {field: None for field, q in carried.items() if q in better}
        if not without:
            return odometry
        rest = replace(odometry, **without)
        return rest if len(without) < len(carried) else None

    def _leads(self, quantity: str, rank: int, arrival_ns: int | None) -> bool:
        """Return whether this message provides the quantity now, and remember it."""
        leader, heard_ns = self._leaders.get(quantity, (rank, None))
        silent = (
            arrival_ns is not None and heard_ns is not None and arrival_ns - heard_ns > SILENCE_NS
        )
        if rank > leader and not silent:
            return False
        self._leaders[quantity] = (rank, arrival_ns)
        return True
