"""Simulate pings of a scene, computing only the effects that each ping needs."""

import multiprocessing
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.effects.plan import AUTO, Choice, EffectSelection
from sonar_sim.effects.planner import PlannedPing, Planner
from sonar_sim.effects.previewer import Previewer
from sonar_sim.engine import NODES_PER_BEAM, Image, PingEngine
from sonar_sim.geometry.pose import FramePose, SonarMotion, require_finite
from sonar_sim.propagation.ground_truth import Truth
from sonar_sim.raycast.fan import ELEVATIONS
from sonar_sim.scene.scene import Scene
from sonar_sim.scene.sonar import SonarSettings

SPARSE_NODES_PER_BEAM, SPARSE_TEXTURE = 5.0, 0.01
"""So few scatterers keep the coefficient of variation within 0.004 of Rayleigh's: `auto` takes them
if the tolerance of texture is at least this."""


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedPing:
    """What one ping gives.

    Attributes:
        image: (rows, beams), row 0 nearest, column 0 the most negative bearing; unsigned integers
            of the sonar's width, or float32 parts of full scale without quantisation.
        amplitude: float32 parts of full scale after the gains, before clipping, gamma and
            rounding, (rows, beams).
        seen_m: points of the surfaces in the sonar's sight, map frame, (N, 3).
        effects: names of what was computed.
        truth: what rays and pixels show, if it was asked for.
    """

    image: Image
    amplitude: NDArray[np.float32]
    seen_m: NDArray[np.float64]
    effects: tuple[str, ...]
    truth: Truth | None


class Simulator:
    """A sonar in a scene. Equal seed, pose, number and time give equal bytes.

    `auto` and `all` differ in their scatterers, so their speckle has different grains.

    Args:
        scene: the scene.
        sonar: its settings.
        seed: of speckle and noise.
        effects: "auto" lets each ping's own rules decide; see `EffectSelection.read`.
        tolerance: by which they decide.
        threads: at most; the bytes do not depend on it.
        elevations: rays of a beam's column: fewer are faster and miss more.
        nodes_per_beam: scatterers in a row of a beam's -3 dB width, about: fewer are faster and
            make the speckle coarser than Rayleigh's. Ghosts have 0.6 times as many. None: 8, or
            what the tolerance of texture allows if the effects are `auto`.

    Raises:
        EffectError: `effects` names one that does not exist.
    """

    def __init__(
        self,
        scene: Scene,
        sonar: SonarSettings,
        seed: int = 0,
        *,
        effects: Choice = AUTO,
        tolerance: Tolerance | None = None,
        threads: int = 2,
        elevations: int = ELEVATIONS,
        nodes_per_beam: float | None = None,
    ) -> None:
        self.scene = scene
        self.sonar = sonar
        self.tolerance = tolerance or Tolerance()
        selection = EffectSelection.read(effects)
        if nodes_per_beam is None:
            sparse = selection.ground == AUTO and self.tolerance.texture >= SPARSE_TEXTURE
            nodes_per_beam = SPARSE_NODES_PER_BEAM if sparse else NODES_PER_BEAM
        self.nodes_per_beam = nodes_per_beam
        self._engine = PingEngine(
            scene, sonar, seed, threads, elevations=elevations, nodes_per_beam=nodes_per_beam
        )
        previewer = Previewer(scene, sonar, self._engine.meshes)
        self._planner = Planner(previewer, selection, self.tolerance)
        self._warned: set[str] = set()

    def plan(
        self,
        map_T_sonar: FramePose,  # noqa: N803
        ping_id: int = 0,
        time_s: float = 0.0,
        motion: SonarMotion | None = None,
    ) -> PlannedPing:
        """Decide for one ping; pings nearly alike in pose and time are decided as one."""
        return self._planner.at(map_T_sonar, ping_id, time_s, motion)

    def ping(
        self,
        map_T_sonar: FramePose,  # noqa: N803
        ping_id: int = 0,
        time_s: float = 0.0,
        motion: SonarMotion | None = None,
        *,
        truth: bool = False,
    ) -> SimulatedPing:
        """Simulate one ping.

        Args:
            map_T_sonar: the sonar's pose at the transmission.
            ping_id: names the noise.
            time_s: of the transmission; moving objects and other sonars go by it.
            motion: of the sonar while it listens; None stands still.
            truth: whether to work out what rays and pixels show.

        Warns:
            EffectWarning: the ping calls for an effect that is switched off; once an effect.

        Raises:
            SonarSimError: the pose, the motion or the time is not finite.
        """
        require_finite(map_T_sonar, time_s)
        planned = self.plan(map_T_sonar, ping_id, time_s, motion)
        planned.plan.warn(self._warned)
        made = self._engine.ping(map_T_sonar, planned.physics, ping_id, time_s, motion, truth=truth)
        return SimulatedPing(
            made.image, made.amplitude, made.seen_m, planned.plan.names, made.truth
        )


def simulate(
    scene: Scene,
    pose: FramePose,
    sonar: SonarSettings | None = None,
    effects: Choice = AUTO,
    seed: int = 0,
    *,
    motion: SonarMotion | None = None,
    time_s: float = 0.0,
    tolerance: Tolerance | None = None,
    truth: bool = False,
) -> SimulatedPing:
    """Simulate a single ping; a `Simulator` makes many of one scene faster.

    Args:
        scene: what is there.
        pose: of the sonar in the map, x along its centre beam, y to port, z up.
        sonar: settings; None is an M750d in its low band at 10 m.
        effects: as for `Simulator`.
        seed: of speckle and noise.
        motion: of the sonar while it listens.
        time_s: of the transmission.
        tolerance: by which the rules decide.
        truth: whether to work out what rays and pixels show.
    """
    simulator = Simulator(
        scene, sonar or SonarSettings(), seed, effects=effects, tolerance=tolerance
    )
    return simulator.ping(pose, 0, time_s, motion, truth=truth)


PINGS_PER_TASK = 16
"""Successive pings that one process makes: they share what is decided about effects."""


@dataclass(frozen=True, slots=True, eq=False)
class PingRequest:
    """When and from where a ping is sent.

    Attributes:
        map_T_sonar: pose of the sonar at the transmission.
        time_s: of the transmission.
        motion: of the sonar while it listens; None stands still.
    """

    map_T_sonar: FramePose  # noqa: N815 frames are named
    time_s: float = 0.0
    motion: SonarMotion | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SimulatorSpec:
    """What a process needs to make its own simulator; Embree scenes cannot be sent."""

    scene: Scene
    sonar: SonarSettings
    seed: int
    effects: Choice = AUTO

    def build(self, threads: int) -> Simulator:
        """Make the simulator."""
        return Simulator(self.scene, self.sonar, self.seed, effects=self.effects, threads=threads)


_worker: list[Simulator] = []
"""The process's own simulator, built once when the process starts."""


def simulate_pings(
    recipe: SimulatorSpec, shots: Iterable[PingRequest], processes: int
) -> Iterator[SimulatedPing]:
    """Simulate one ping per request; ping numbers start at 0.

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
        yield from pool.map(_work, enumerate(shots), chunksize=PINGS_PER_TASK)


def _start(recipe: SimulatorSpec) -> None:
    _worker.append(recipe.build(threads=1))


def _work(job: tuple[int, PingRequest]) -> SimulatedPing:
    ping_id, shot = job
    return _worker[0].ping(shot.map_T_sonar, ping_id, shot.time_s, shot.motion)
