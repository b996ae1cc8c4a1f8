"""Carries out, in order, what the engine gives: the pings' way into the map."""

from mapperd.decisions import Remarks, Reset
from mapperd.engine import NewSettings, Settled, Work
from mapperd.errors import StoreError
from mapperd.keeping import Keeping
from mapperd.stepping import Stepping

__all__ = ["Integration"]

TOO_SLOW = ("too_slow", "pings came faster than they could be mapped")


class Integration:
    """One thread does one piece of work after the other.

    Args:
        stepping: the pings' way.
        keep: of the map.
        remarks: of a session that is mapped again.

    Attributes:
        stepping: as given.
    """

    def __init__(self, stepping: Stepping, keep: Keeping, remarks: Remarks | None = None) -> None:
        self.stepping = stepping
        self._keep = keep
        remarks = remarks or Remarks()
        self._drops = remarks.drops
        self._failed = remarks.failed
        self._bounds = list(reversed(remarks.bounds))

    def do(self, work: Work) -> None:
        """Map a ping or count why not, change the settings, or empty the map.

        Raises:
            StoreError: the map cannot be emptied.
        """
        match work:
            case Settled(number):
                self._ping(number, work)
            case NewSettings(config):
                self.stepping.take(config)
            case Reset(number):
                self._reset(number)
        self._keep.done(work)

    def _reset(self, number: int) -> None:
        if number in self._failed:
            return
        try:
            self._keep.reset()
        except StoreError:
            self._keep.done(Reset(number))  # it will not be asked for again
            raise

    def drop(self, work: Settled) -> None:
        """Count a ping that had to wait for too long."""
        self.stepping.counters.drop(*TOO_SLOW)
        self._keep.done(work)

    def _ping(self, number: int, settled: Settled) -> None:
        while self._bounds and self._bounds[-1][0] <= number:
            self.stepping.error_bound = self._bounds.pop()[1]
        if number in self._drops:
            self.stepping.counters.drop(*TOO_SLOW)
        else:
            self.stepping.step(settled.ping, settled.pose)
