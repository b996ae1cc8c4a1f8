"""Pings by several processes: the same ones, in the same order, whatever their number."""

import multiprocessing
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

from sonar_sim.geometry.pose import Pose, SonarMotion
from sonar_sim.scene.scene import Scene
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.simulator import Ping, Simulator

PINGS_A_TASK = 4


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """When and from where a ping is sent.

    Attributes:
        map_T_sonar: pose of the sonar at the transmission.
        time_s: of the transmission.
        motion: of the sonar while it listens; None stands still.
    """

    map_T_sonar: Pose  # noqa: N815 frames are named
    time_s: float = 0.0
    motion: SonarMotion | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SimulatorRecipe:
    """What a process needs to make its own simulator; Embree scenes cannot be sent."""

    scene: Scene
    sonar: SonarSettings
    seed: int

    def build(self, threads: int) -> Simulator:
        """Make the simulator."""
        return Simulator(self.scene, self.sonar, self.seed, threads=threads)


_worker: list[Simulator] = []
"""The process's own simulator, built once when the process starts."""


def simulate_pings(
    recipe: SimulatorRecipe, shots: Iterable[Shot], processes: int
) -> Iterator[Ping]:
    """Simulate one ping a shot, numbered from 0.

    A ping depends on seed, shot and number alone, so the number of processes changes nothing.

    Args:
        recipe: how to make the simulator.
        shots: when and from where.
        processes: 1 works in this process, with two threads; of more each has one thread.
    """
    if processes == 1:
        simulator = recipe.build(threads=2)
        for ping_id, shot in enumerate(shots):
            yield simulator.ping(shot.map_T_sonar, ping_id, shot.time_s, shot.motion)
        return
    # Forking would copy the threads' locks of whatever runs here; spawning does not.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, context, _start, (recipe,)) as pool:
        yield from pool.map(_work, enumerate(shots), chunksize=PINGS_A_TASK)


def _start(recipe: SimulatorRecipe) -> None:
    _worker.append(recipe.build(threads=1))


def _work(job: tuple[int, Shot]) -> Ping:
    ping_id, shot = job
    return _worker[0].ping(shot.map_T_sonar, ping_id, shot.time_s, shot.motion)
