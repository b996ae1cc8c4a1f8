"""A dive's capture goes into a map, the way that it goes in the daemon, with each ping timed."""

import time
from dataclasses import dataclass, replace
from pathlib import Path

from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.decoder import PosedPing, SessionDecoder
from mapperd.pipeline.executor import PingExecutor
from mapperd.pipeline.persistence import MemoryPersistence
from mapperd.pipeline.pose_lookup import OdometryPoses
from mapperd.pipeline.step import StepRunner
from oculus_driver.recording import open_recording
from studies.accuracy_cost.mapping.dives import Made
from studies.accuracy_cost.mapping.settings import config_for
from studies.accuracy_cost.study import Setting

__all__ = ["Driven", "drive"]


@dataclass(frozen=True, slots=True, eq=False)
class Driven:
    """A map and what it took.

    Attributes:
        map: the result.
        mapped_ms: CPU time of each ping that was mapped.
        pings: that came.
    """

    map: SonarMap
    mapped_ms: list[float]
    pings: int

    @property
    def ms_per_ping(self) -> float:
        """CPU time over all pings that came, skipped ones too."""
        return sum(self.mapped_ms) / max(self.pings, 1)


def drive(setting: Setting, made: Made, capture: Path) -> Driven:
    """Map a capture with a setting; what is timed is a ping's filters and its integration."""
    config, thinning = config_for(setting, made)
    sonar_map = SonarMap(config)
    counters = PipelineCounters()
    integration = PingExecutor(
        StepRunner(sonar_map, time.thread_time), MemoryPersistence(sonar_map)
    )
    engine = SessionDecoder(config, OdometryPoses(config), counters, confirm=False, obey=False)
    mapped_ms: list[float] = []

    def do(work: object) -> None:
        if not isinstance(work, PosedPing):
            raise TypeError(f"a capture of the simulator asks for {work}")
        settled = replace(work, ping=thinning.of(work.ping))
        before = integration.stepping.counters.pings_mapped
        began_s = time.thread_time()
        integration.do(settled)
        took_ms = 1e3 * (time.thread_time() - began_s)
        if integration.stepping.counters.pings_mapped > before:
            mapped_ms.append(took_ms)

    with open_recording(capture) as recording:
        for chunk in recording:
            for work in engine.feed(chunk):
                do(work)
        for work in engine.end():
            do(work)
    return Driven(sonar_map, mapped_ms, engine.pings)
