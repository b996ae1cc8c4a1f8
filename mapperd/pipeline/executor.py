"""Carries out, in order, what the engine gives: the pings' way into the map."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mapperd.config.tree import Config
from mapperd.errors import Reject, StoreError
from mapperd.localization.stage import LocalizationStage
from mapperd.odometry.fusion import FusedPose
from mapperd.pipeline.decoder import NewSettings, PosedPing, Work
from mapperd.pipeline.persistence import MapPersistence
from mapperd.pipeline.step import Mapped, StepRunner
from mapperd.session_log import Remarks, Request, Reset

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["PingExecutor", "PingResult"]

LOCALIZATION_OFF = Reject("localization_off", "localization.mode is off")

TOO_SLOW = ("too_slow", "pings came faster than they could be mapped")


@dataclass(frozen=True, slots=True, eq=False)
class PingResult:
    """A ping, and what became of it.

    Attributes:
        settled: the ping.
        pose: that it was mapped at, or why it has none.
        result: in the map, or why not.
    """

    settled: PosedPing
    pose: FusedPose | Reject
    result: Mapped | Reject


class PingExecutor:
    """One thread does one piece of work after the other.

    Args:
        stepping: the pings' way.
        keep: of the map.
        remarks: of a session that is mapped again.
        onboard: localizes; None where that is off.

    Attributes:
        stepping, onboard: as given.
        newest: pose that the newest ping with one was mapped at, or localized where none is.
        on_ping: called with each ping and what became of it; it neither waits nor raises.
    """

    def __init__(
        self,
        stepping: StepRunner,
        keep: MapPersistence,
        remarks: Remarks | None = None,
        onboard: LocalizationStage | None = None,
    ) -> None:
        self.stepping = stepping
        self.onboard = onboard
        self.newest: FusedPose | None = None
        self.on_ping: Callable[[PingResult], None] = lambda _: None
        self._keep = keep
        remarks = remarks or Remarks()
        self._drops = remarks.drops
        self._failed = remarks.failed

    def do(self, work: Work) -> None:
        """Map a ping or count why not, change the settings, empty the map, or localize anew.

        Raises:
            StoreError: the map cannot be emptied.
            CheckpointError: the known map that a recorded request names is not there any more.
        """
        match work:
            case PosedPing():
                self._ping(work)
            case NewSettings(config):
                self._take(config)
            case Reset(number):
                self._reset(number)
            case _:
                self.ask(work)
                return
        self._keep.done(work)

    def ask(self, request: Request) -> Reject | None:
        """Do what localization is asked for; returns why not. Raises as `do`."""
        refused = LOCALIZATION_OFF if self.onboard is None else self.onboard.ask(request)
        self._keep.done(request)
        return refused

    def pass_by(self, work: Work) -> None:
        """Let work go that is in the map already; localization is not in it, and does it again."""
        match work:
            case PosedPing(number) if number not in self._drops:
                self._place(work)
            case NewSettings(config):
                self._take(config)
            case PosedPing() | Reset():
                pass
            case _ if self.onboard is not None:
                self.onboard.ask(work)

    def _take(self, config: Config) -> None:
        self.stepping.take(config)
        if self.onboard is not None:
            self.onboard.take(config)

    def _place(self, settled: PosedPing) -> FusedPose | Reject:
        if self.onboard is None:
            return settled.pose
        return self.onboard.place(settled.ping, settled.pose, settled.t_ns)

    def _reset(self, number: int) -> None:
        if number in self._failed:
            return
        try:
            self._keep.reset()
        except StoreError:
            self._keep.done(Reset(number))  # it will not be asked for again
            raise

    def drop(self, work: PosedPing) -> None:
        """Count a ping that had to wait for too long."""
        self.stepping.counters.drop(*TOO_SLOW)
        self.on_ping(PingResult(work, work.pose, Reject(*TOO_SLOW)))
        self._keep.done(work)

    def _ping(self, settled: PosedPing) -> None:
        number = settled.number
        if number in self._drops:
            self.stepping.counters.drop(*TOO_SLOW)
        else:
            pose = self._place(settled)
            result = self.stepping.step(settled.ping, pose)
            if isinstance(result, Mapped):
                self.newest = pose if isinstance(pose, FusedPose) else None
            self.on_ping(PingResult(settled, pose, result))
