"""The scenes that settings are measured in, and the moments of their paths that are pinged."""

import functools
from dataclasses import dataclass

from sonar_sim import load_scenario
from sonar_sim.engine import SonarMotion
from sonar_sim.poses import Pose
from sonar_sim.scenario import Scenario
from sonar_sim.sonar_motion import sonar_motion, sonar_pose

from studies.accuracy_cost.study import Dive


@dataclass(frozen=True, slots=True)
class Stretches:
    """Parts of a scene's path that are pinged at the sonar's own rate.

    Attributes:
        parts: of the path's time, where each stretch begins.
        pings: of each; the first one's picture is compared, all are timed.
        grains: random seeds of the surfaces, over which the grain is taken.
        elevations: rays of a column of the reference.
    """

    parts: tuple[float, ...]
    pings: int = 3
    grains: int = 8
    elevations: int = 512


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """One ping's circumstances."""

    number: int
    time_s: float
    map_T_sonar: Pose  # noqa: N815 frames of a transform
    motion: SonarMotion


STRETCHES = {
    # Looks alike all along, and is the one that must be quick.
    "flat_floor": Stretches((0.5,), pings=4, grains=4, elevations=128),
    "harbour": Stretches((0.05, 0.5), pings=4),
    "tank": Stretches((0.5,)),
    "wreck": Stretches((0.5,)),
    # Bent paths cost ten times as much as straight ones.
    "open_water": Stretches((0.95,), pings=2),
}

DIVES = tuple(Dive(name, seed=1, quick=name == "flat_floor") for name in STRETCHES)


def grain_seeds(dive: Dive) -> range:
    """Of a setting's surfaces; those after them are the reference's."""
    return range(dive.seed, dive.seed + STRETCHES[dive.name].grains)


@functools.lru_cache(maxsize=2)
def scenario_of(dive: Dive) -> Scenario:
    """The scene, once a process: reading it takes longer than a ping."""
    return load_scenario(dive.name)


def moments_of(dive: Dive) -> list[list[Moment]]:
    """The pings of each stretch."""
    scenario, stretches = scenario_of(dive), STRETCHES[dive.name]
    return [
        [
            _moment(
                scenario,
                number,
                part * scenario.trajectory.duration_s + number / scenario.true_ping_rate_hz,
            )
            for number in range(stretches.pings)
        ]
        for part in stretches.parts
    ]


def _moment(scenario: Scenario, number: int, time_s: float) -> Moment:
    return Moment(number, time_s, sonar_pose(scenario, time_s), sonar_motion(scenario, time_s))
