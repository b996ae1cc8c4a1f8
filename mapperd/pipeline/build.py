"""Builds the pipeline; the only place that assembles its parts.

The live daemon, a replay, a recovery, a replay into a store and the dives of a survey all use it.
Two modules build only the decoder. The calibration maps nothing. The recovery does so before it
maps, to check a checkpoint or to make that of a recording's start.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

from mapperd.localization.stage import LocalizationStage
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.decoder import SessionDecoder
from mapperd.pipeline.executor import PingExecutor
from mapperd.pipeline.persistence import MapPersistence, MemoryPersistence
from mapperd.pipeline.pose_lookup import FixedPose, OdometryPoses
from mapperd.pipeline.step import Stages
from mapperd.session_log import Remarks

__all__ = ["Pipeline", "build_pipeline"]


@dataclass(frozen=True, slots=True)
class Pipeline:
    """The pipeline of one session, from bytes to the map.

    Attributes:
        poses: where the pings get their poses from.
        decoder: turns recorded or received chunks into work.
        executor: does the work.
    """

    poses: FixedPose | OdometryPoses
    decoder: SessionDecoder
    executor: PingExecutor

    @property
    def counters(self) -> PipelineCounters:
        """Counts of all input."""
        return self.executor.counters


def build_pipeline(
    sonar_map: SonarMap,
    poses: FixedPose | OdometryPoses,
    *,
    localization: LocalizationStage | None = None,
    persistence: MapPersistence | None = None,
    remarks: Remarks | None,
    confirm: bool = False,
    within: Callable[[int | None], bool] | None = None,
    counters: PipelineCounters | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> Pipeline:
    """Build the pipeline for one session.

    Args:
        sonar_map: the map; its settings hold at the beginning.
        poses: fixed, or from odometry; fresh.
        localization: corrects the poses; None where it is off.
        persistence: of the map; None keeps it in memory.
        remarks: of the recorded session, whose recorded decisions are then repeated; no remarks
            for a live session; None ignores recorded decisions.
        confirm: hold each ping back until the next bytes confirm it: for recordings that do not
            mark missing bytes.
        within: whether to map a ping that arrived at a time, nanoseconds; None maps all.
        counters: to continue; new ones by default.
        clock: seconds, to time the steps.

    Raises:
        ConfigError: an enabled filter cannot run.
    """
    sonar_map.start_session()
    counters = counters or PipelineCounters()
    repeat = remarks is not None
    decoder = SessionDecoder(
        sonar_map.config, poses, counters, confirm=confirm, obey=repeat, within=within
    )
    if persistence is None:
        persistence = MemoryPersistence(sonar_map)
    stages = Stages(sonar_map, localization)
    executor = PingExecutor(stages, persistence, counters, remarks, clock)
    return Pipeline(poses, decoder, executor)
