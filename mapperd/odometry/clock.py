"""The time of an odometry record on the host, and the best of several messages.

If several messages of one sender carry the same quantity, the best one is used.

An autopilot may send its attitude as angles and as a quaternion. Both in one series would only
make it noisier, and out of order.
"""

from collections import deque
from dataclasses import replace
from typing import Any, NamedTuple

from mapperd.errors import Reject
from mapperd.odometry.records import Odometry
from oculus_driver.clock_fit import ClockFit, ClockFitState

__all__ = ["Leaders", "OdometryClock", "OdometryClockState", "Precedence"]

DISTRUST_AFTER = 10
"""So many Unix stamps in a row that cannot be are of a clock that was never set."""

STEP_NS = 50_000_000
"""The least delay of as many records in a row grown by more: the sender's clock was set back."""

AHEAD_NS = 5_000_000
"""A stamp so much later than its arrival is of a clock that is not ours."""


class OdometryClockState(NamedTuple):
    """State of an `OdometryClock`.

    Attributes:
        fit: of the sender's clock to the host's.
        off: records in a row whose stamp was too far from their arrival.
        distrusted: Unix stamps are fitted, too.
        delays_ns: the last delays.
        least_delay_ns: the least of them so far.
        offset_ns: newest Unix stamp minus its arrival where they disagree.
    """

    fit: ClockFitState
    off: int
    distrusted: bool
    delays_ns: list[int]
    least_delay_ns: int | None
    offset_ns: int | None = None


class OdometryClock:
    """Carries the stamps of one source over to the host's clock.

    Unix stamps are taken as they are while they agree with the arrivals; others are fitted. A
    clock that was always behind by less than `max_age_ns` agrees: it cannot be
    distinguished from a slow sender. A clock that is set back is noticed.

    Args:
        max_age_ns: stamps further than this from their arrival are refused.
        latency_ns: least delay of the link, which no fit can see; it is taken off.

    Attributes:
        max_age_ns: may change.
        offset_ns: newest Unix stamp minus its arrival where they disagree, else None.
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

    def state(self) -> OdometryClockState:
        """Everything that `restore` needs to continue exactly."""
        return OdometryClockState(
            self._fit.state(),
            self._off,
            self._distrusted,
            list(self._delays),
            self._min_delay_ns,
            self.offset_ns,
        )

    def restore(self, state: OdometryClockState) -> None:
        """Continue as the clock of which `state` was taken."""
        self._fit.restore(state.fit)
        self._off, self._distrusted = state.off, state.distrusted
        self._delays = deque(state.delays_ns, maxlen=DISTRUST_AFTER)
        self._min_delay_ns = state.least_delay_ns
        self.offset_ns = state.offset_ns

    def t_host_ns(self, odometry: Odometry, arrival_ns: int | None) -> int | Reject:
        """The record's host time, on the clock of the arrival stamps.

        Args:
            odometry: the record.
            arrival_ns: arrival; None if the recording has no time, which leaves
                only "unix" stamps of use.
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
        """Whether all of the last records came later after their stamps than any before them."""
        sent_ns = odometry.stamp_ns if odometry.sent_ns is None else odometry.sent_ns
        self._delays.append(arrival_ns - sent_ns)
        if len(self._delays) < DISTRUST_AFTER:
            return False
        min_ns, now_ns = self._min_delay_ns, min(self._delays)
        self._min_delay_ns = now_ns if min_ns is None else min(min_ns, now_ns)
        return min_ns is not None and now_ns - min_ns > STEP_NS

    def _carried_over(self, odometry: Odometry, arrival_ns: int) -> int | None:
        """By the fit of the stamps of sending, where there are some: they know the link's delay."""
        sent_ns = odometry.stamp_ns if odometry.sent_ns is None else odometry.sent_ns
        sent_host_ns = self._fit.to_host_ns(sent_ns, arrival_ns)
        if sent_host_ns is None:
            return None
        return sent_host_ns - self._latency_ns + odometry.stamp_ns - sent_ns


SILENCE_NS = 2 * 10**9
"""After so long without the better message the next best will do."""

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
"""Quantity of each field that several messages carry."""


Leaders = dict[str, tuple[int, int | None]]
"""Quantity to the rank of the message that it is taken from, and the last arrival of that."""


class Precedence:
    """Remembers which message provides each quantity.

    Args:
        order: messages, best first.
    """

    def __init__(self, order: tuple[str, ...]) -> None:
        self._rank = {name: rank for rank, name in enumerate(order)}
        self._leaders: Leaders = {}

    def state(self) -> Leaders:
        """Everything that `restore` needs to continue exactly."""
        return dict(self._leaders)

    def restore(self, state: Leaders) -> None:
        """Continue as the one of which `state` was taken."""
        self._leaders = dict(state)

    def filtered(self, name: str, odometry: Odometry, arrival_ns: int | None) -> Odometry | None:
        """Remove what a better message provides; None when nothing is left."""
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
                # A heading alone is the attitude of a level vehicle: it follows on from no other.
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
