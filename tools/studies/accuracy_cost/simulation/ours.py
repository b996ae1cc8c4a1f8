"""Pings of our own engine: timed as a user has them, and their expected pictures and grain."""

import functools
import hashlib
import pickle
import time
import tracemalloc
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from sonar_sim.effects.image_difference import expected_clipped, gamma_of
from sonar_sim.effects.planner import Planner
from sonar_sim.effects.previewer import Previewer
from sonar_sim.engine import EnginePing, PingEngine
from sonar_sim.propagation.physics import Physics
from sonar_sim.scene.sonar import SonarSettings

from studies.accuracy_cost.simulation.error import Grain, grain_of
from studies.accuracy_cost.simulation.scenes import Making, PingInstant, moments_of, scenario_of
from studies.accuracy_cost.study import StudyDive

Picture = NDArray[np.float64]

MIN_AMPLITUDE = 1e-9
"""Of the expected amplitude: a cell of nothing has no level."""


@dataclass(frozen=True, slots=True, eq=False)
class OwnPicture:
    """One ping's picture.

    Attributes:
        expected: amplitude of full scale, speckle averaged, as one reads it from pixels who knows
            the sonar's gamma, (rows, beams).
        rounded: whether the sonar's pixels are integers.
    """

    expected: Picture
    rounded: bool


class Ours:
    """Our simulator in one setting, on one dive."""

    def __init__(self, making: Making, dive: StudyDive) -> None:
        sonar = scenario_of(dive).sonar
        self.sonar = sonar if making.beams is None else replace(sonar, beams=making.beams)
        self._dive, self._making = dive, making
        self._engine = _engine(dive, self.sonar, making.elevations, making.nodes_per_beam)
        self._look = Previewer(scenario_of(dive).scene, self.sonar, self._engine.meshes)

    def cpu_ms(self) -> list[float]:
        """CPU time of each ping, deciding included, as they follow one another."""
        moments = [moment for stretch in moments_of(self._dive) for moment in stretch]
        self._ping(self._planner(), moments[0])  # tables of the beam former are made once
        planner = self._planner()
        return [self._timed_ms(planner, moment) for moment in moments]

    def memory_mb(self) -> float:
        """Most that arrays hold while a ping is decided on and made, the scene not counted."""
        moment = moments_of(self._dive)[0][0]
        tracemalloc.start()
        try:
            before, _ = tracemalloc.get_traced_memory()
            self._ping(self._planner(), moment)
            _, most = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        return (most - before) / 1e6

    def pictures(self) -> list[OwnPicture]:
        """Of the first ping of each stretch."""
        planner = self._planner()
        return [self._seen(planner, stretch[0]) for stretch in moments_of(self._dive)]

    def grain(self, seeds: Iterable[int]) -> Grain:
        """Of the first ping's echoes over their expected level, with surfaces of random seeds."""
        moment = moments_of(self._dive)[0][0]
        physics = self._surfaces_alone(moment)
        smooth = self._made(moment, replace(physics, speckle=False)).amplitude
        shows = smooth > 1.0 / (2**self.sonar.bits - 1)
        return grain_of([self._level_db(physics, seed, smooth, shows) for seed in seeds])

    def grain_key(self) -> str:
        """Equal where settings make the same grain."""
        making = self._making
        sampling = (making.elevations, making.nodes_per_beam, making.beams)
        physics = self._surfaces_alone(moments_of(self._dive)[0][0])
        return hashlib.sha256(pickle.dumps((physics, sampling))).hexdigest()[:16]

    def _surfaces_alone(self, moment: PingInstant) -> Physics:
        """Without what is not speckle of surfaces: noise, the water's own echoes, other sonars."""
        physics = self._physics(self._planner(), moment)
        return replace(physics, noise_level_db=None, volume_strength_db=None, arrivals=())

    def _level_db(
        self, physics: Physics, seed: int, smooth: NDArray[np.float32], shows: NDArray[np.bool_]
    ) -> Picture:
        """A ping's level over the expected one, NaN where nothing shows."""
        engine = self._engine.reseeded(seed)
        grained = _ping(engine, moments_of(self._dive)[0][0], physics).amplitude
        level_db = np.full(smooth.shape, np.nan)
        relative = grained[shows].astype(np.float64) / smooth[shows]
        level_db[shows] = 20.0 * np.log10(np.maximum(relative, MIN_AMPLITUDE))
        return level_db

    def _planner(self) -> Planner:
        return Planner(self._look, self._making.effects, self._making.tolerance)

    def _timed_ms(self, planner: Planner, moment: PingInstant) -> float:
        start_s = time.process_time()
        self._ping(planner, moment)
        return 1e3 * (time.process_time() - start_s)

    def _ping(self, planner: Planner, moment: PingInstant) -> None:
        self._made(moment, self._physics(planner, moment))

    def _physics(self, planner: Planner, moment: PingInstant) -> Physics:
        planned = planner.at(moment.map_T_sonar, moment.number, moment.time_s, moment.motion)
        return planned.physics

    def _seen(self, planner: Planner, moment: PingInstant) -> OwnPicture:
        physics = self._physics(planner, moment)
        picture = expected(self._engine, self.sonar, moment, physics)
        beams = scenario_of(self._dive).sonar.beams
        return OwnPicture(widened(picture, beams), physics.quantised)

    def _made(self, moment: PingInstant, physics: Physics) -> EnginePing:
        return _ping(self._engine, moment, physics)


def expected(
    engine: PingEngine, sonar: SonarSettings, moment: PingInstant, physics: Physics
) -> Picture:
    """Amplitude of full scale with speckle averaged, before pixels are rounded, (rows, beams)."""
    even = replace(physics, quantised=False, speckle=False, saturation=False)
    amplitude = _ping(engine, moment, even).image.astype(np.float64) ** (1.0 / gamma_of(sonar))
    return (expected_clipped(amplitude) if physics.saturation else amplitude).astype(np.float64)


def _ping(engine: PingEngine, moment: PingInstant, physics: Physics) -> EnginePing:
    return engine.ping(moment.map_T_sonar, physics, moment.number, moment.time_s, moment.motion)


def widened(picture: Picture, beams: int) -> Picture:
    """A picture of fewer beams over the same fan, with the power in between, (rows, beams)."""
    if picture.shape[1] == beams:
        return picture
    place = np.linspace(0.0, picture.shape[1] - 1.0, beams)
    left = np.minimum(place.astype(np.int64), picture.shape[1] - 2)
    part, power = place - left, np.square(picture)
    return np.asarray(np.sqrt((1.0 - part) * power[:, left] + part * power[:, left + 1]))


@functools.lru_cache(maxsize=2)
def _engine(
    dive: StudyDive, sonar: SonarSettings, elevations: int, nodes_per_beam: float
) -> PingEngine:
    """Once for all settings of a process that need the same: a big scene takes a second."""
    return PingEngine(
        scenario_of(dive).scene,
        sonar,
        dive.seed,
        threads=1,
        elevations=elevations,
        nodes_per_beam=nodes_per_beam,
    )
