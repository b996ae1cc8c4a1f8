"""Carries out the decoder's work in order: pings, settings, resets, requests to localization."""

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from mapperd.config.tree import Config
from mapperd.errors import Reject, StoreError
from mapperd.imaging.filter_chain import check_filters
from mapperd.imaging.robots import Sighting, Sightings
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.decoder import NewSettings, PosedPing, Work
from mapperd.pipeline.persistence import MapPersistence
from mapperd.pipeline.pose_lookup import ODOMETRY_FOLLOWS
from mapperd.pipeline.step import PingResult, Stages, process_ping, skip_ping
from mapperd.session_log import STUCK, Remarks, Request, Reset

if TYPE_CHECKING:
    from mapperd.geometry.frames import Pose

__all__ = ["PingExecutor"]

LOCALIZATION_OFF = Reject("localization_off", "localization.mode is off")

TOO_SLOW = Reject("too_slow", "pings came faster than they could be mapped")

NOT_SAVED = Reject(STUCK, "the map could not be saved, and took no more pings")


def stop_mapping(posed: PosedPing, reject: Reject) -> None:
    """Stop at a ping that the map cannot take; a later run maps it.

    Raises:
        StoreError: always.
    """
    raise StoreError(f"ping {posed.number} cannot be mapped: {reject.detail}", "io_error")


class PingExecutor:
    """Maps pings and counts them; used by one thread.

    Args:
        stages: of the step.
        persistence: of the map.
        counters: to continue; new ones by default.
        remarks: of the session that is mapped again.
        clock: seconds, to time the steps.

    Raises:
        ConfigError: an enabled filter cannot run.

    Attributes:
        stages, counters: as given.
        sightings: robots that were seen lately.
        on_ping: called with each result; it neither waits nor raises.
        on_mapped: called with the time and the pose of each mapped ping, likewise.
        on_stuck: called with each ping that the map does not take because it cannot be saved. The
            default ends the run; a live session records the ping as dropped.
    """

    FOLLOWS = (
        "filtering",
        "mounting.orientation",
        "octree",
        "mapping",
        "arc",
        "processing",
        "crosstalk",
        "terrain_detection",
        "robot_detection",
        "amcl",
        "localization",
        "water",
        *ODOMETRY_FOLLOWS,
    )
    """Settings that the pipeline follows while it runs."""

    def __init__(
        self,
        stages: Stages,
        persistence: MapPersistence,
        counters: PipelineCounters | None = None,
        remarks: Remarks | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        check_filters(stages.map.config)
        self.stages = stages
        self.counters = counters or PipelineCounters()
        self.sightings = Sightings()
        self.on_ping: Callable[[PingResult], None] = lambda _: None
        self.on_mapped: Callable[[int | None, Pose], None] = lambda *_: None
        self.on_stuck: Callable[[PosedPing, Reject], None] = stop_mapping
        self._persistence = persistence
        self._remarks = remarks or Remarks()
        self._clock = clock
        self._config = stages.map.config

    def do(self, work: Work) -> None:
        """Do one piece of work.

        Raises:
            StoreError: the map cannot be emptied, or cannot be saved and takes no more pings.
            CheckpointError: the known map of a recorded request does not exist any more.
        """
        match work:
            case PosedPing():
                self.map_ping(work)
            case NewSettings():
                self.change_settings(work)
            case Reset():
                self.reset(work)
            case _:
                self.request(work)

    def skip(self, work: Work) -> None:
        """Skip work that is in the map already; estimators of the pings' images repeat it."""
        match work:
            case PosedPing(number=number):
                self.counters.pings_total -= 1  # the previous run counted it
                if number not in self._remarks.drops:
                    skip_ping(work, self.stages, self._config)
            case NewSettings(config):
                self.reconfigure(config)
            case Reset():
                pass
            case _ if self.stages.localization is not None:
                self.stages.localization.request(work)

    def map_ping(self, posed: PosedPing) -> PingResult | None:
        """Put a ping through the step; None if it was dropped according to the recording.

        Raises:
            StoreError: as of `do`, unless `on_stuck` continues.
        """
        result = None
        if posed.number in self._remarks.drops:
            self.counters.drop(TOO_SLOW)
        elif posed.number in self._remarks.stuck:
            skip_ping(posed, self.stages, self._config)
            self.counters.drop(NOT_SAVED)
            self._persistence.lose_ping(NOT_SAVED.detail)
        else:
            result = self._step(posed)
            if result.reject is not None and result.reject.reason == STUCK:
                self.on_stuck(posed, result.reject)
                self._persistence.lose_ping(result.reject.detail)
            self.on_ping(result)
        self._persistence.done(posed)
        return result

    def drop(self, posed: PosedPing) -> None:
        """Count a ping that waited too long."""
        self.counters.drop(TOO_SLOW)
        mapping = self._config.localization.mapping
        by_odometry = self.stages.localization is None or mapping == "odometry"
        # Elsewhere only localization, which has not seen this ping, knows the pose in the map.
        self.on_ping(PingResult(posed, posed.pose if by_odometry else TOO_SLOW, TOO_SLOW))
        self._persistence.done(posed)

    def change_settings(self, work: NewSettings) -> None:
        """Map the following pings with other settings."""
        self.reconfigure(work.config)
        self._persistence.done(work)

    def reconfigure(self, config: Config) -> None:
        """Use other settings from the next ping on.

        Args:
            config: differs from the present one in settings of `FOLLOWS` only, and has passed
                `check_filters`.
        """
        self._config = config
        if self.stages.localization is not None:
            self.stages.localization.reconfigure(config)

    def reset(self, work: Reset) -> None:
        """Empty the map, unless that failed when the session was recorded.

        Raises:
            StoreError: the map cannot be emptied.
        """
        try:
            if work.number not in self._remarks.failed:
                self._persistence.reset()
        finally:
            self._persistence.done(work)  # a failed reset is not repeated either

    def request(self, request: Request) -> Reject | None:
        """Pass a request to localization; return why it was refused.

        Raises:
            CheckpointError: the known map of a recorded request does not exist any more.
        """
        localization = self.stages.localization
        refused = LOCALIZATION_OFF if localization is None else localization.request(request)
        self._persistence.done(request)
        return refused

    def _step(self, posed: PosedPing) -> PingResult:
        """Run the step; count and time it."""
        if self.stages.map.config is not self._config:
            self.stages.map.reconfigure(self._config)
        began_s = self._clock()
        result = process_ping(posed, self.stages)
        if not isinstance(result.pose, Reject):
            self.counters.add_time(self._clock() - began_s)
        if result.reject is not None:
            self.counters.drop(result.reject)
        elif not isinstance(result.pose, Reject):
            self.counters.pings_mapped += 1
            self.on_mapped(posed.t_ns, result.pose.pose)
        self._remember_robots(result)
        return result

    def _remember_robots(self, result: PingResult) -> None:
        arrival_ns = result.posed.ping.arrival_ns
        if arrival_ns is not None:
            self.sightings.add(Sighting(arrival_ns, at_m, robot) for robot, at_m in result.robots)
