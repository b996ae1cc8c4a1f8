"""Pings by several processes: the same ones, in the same order, whatever their number."""

import multiprocessing
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

from sonar_sim.poses import Pose
from sonar_sim.scene import Scene
from sonar_sim.simulator import SimulatedPing, Simulator
from sonar_sim.sonar import SonarSettings
from sonar_sim.water import Water

PINGS_A_TASK = 4


@dataclass(frozen=True, slots=True, eq=False)
class SimulatorRecipe:
    """What a process needs to make its own simulator; Embree scenes cannot be sent."""

    scene: Scene
    sonar: SonarSettings
    water: Water
    seed: int

    def build(self) -> Simulator:
        """Make the simulator."""
        return Simulator(self.scene, self.sonar, self.water, self.seed)


_worker: list[Simulator] = []
"""The process's own simulator, built once when the process starts."""


def simulate_pings(
    recipe: SimulatorRecipe, poses: Iterable[Pose], processes: int
) -> Iterator[SimulatedPing]:
    """Simulate one ping a pose, numbered from 0.

    A ping depends on seed, pose and number alone, so the number of processes changes nothing.

    Args:
        recipe: how to make the simulator.
        poses: of the sonar in the map.
        processes: 1 works in this process.
    """
    if processes == 1:
        simulator = recipe.build()
        for ping_id, pose in enumerate(poses):
            yield simulator.ping(pose, ping_id)
        return
    # Forking would copy the threads' locks of whatever runs here; spawning does not.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, context, _start, (recipe,)) as pool:
        yield from pool.map(_work, enumerate(poses), chunksize=PINGS_A_TASK)


def _start(recipe: SimulatorRecipe) -> None:
    _worker.append(recipe.build())


def _work(job: tuple[int, Pose]) -> SimulatedPing:
    ping_id, pose = job
    return _worker[0].ping(pose, ping_id)
