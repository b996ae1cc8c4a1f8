"""The scenes that settings are measured in, and the moments of their paths that are pinged."""

import functools
from collections.abc import Mapping
from dataclasses import dataclass, fields

from sonar_sim import load_scenario
from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.effects.plan import EffectSelection
from sonar_sim.geometry.pose import FramePose, SonarMotion
from sonar_sim.scene.scenario import Scenario, sonar_motion, sonar_pose

from studies.accuracy_cost.study import StudyDive, Value

EFFECT, TOLERANCE = "sim.effect.", "sim.tolerance."


ELEVATIONS = 128
NODES_PER_BEAM = 8.0
"""Rays of a column and scatterers in a row of a beam with which the figures are recorded."""


@dataclass(frozen=True, slots=True)
class Making:
    """How pings are made.

    Attributes:
        effects: which.
        tolerance: by which rules decide.
        elevations: rays of a column.
        nodes_per_beam: scatterers in a row of a beam's width.
        beams: of the picture; None: the scene's own.
        camera: width and height of the published pipeline's depth image; None is our own engine.
    """

    effects: EffectSelection
    tolerance: Tolerance
    elevations: int
    nodes_per_beam: float
    beams: int | None
    camera: tuple[int, int] | None


def making_of(overrides: Mapping[str, Value]) -> Making:
    """Read a setting's overrides.

    Raises:
        ValueError: an unknown name.
        EffectError: an effect is not known.
    """
    plain = {n: v for n, v in overrides.items() if not n.startswith((EFFECT, TOLERANCE))}
    ground = str(plain.pop("sim.effects", "auto"))
    switched = [
        f"{'+' if on else '-'}{name.removeprefix(EFFECT)}"
        for name, on in sorted(overrides.items())
        if name.startswith(EFFECT)
    ]
    elevations = int(plain.pop("sim.elevations", ELEVATIONS))
    nodes_per_beam = float(plain.pop("sim.nodes_per_beam", NODES_PER_BEAM))
    beams, camera = plain.pop("sim.beams", None), plain.pop("sim.camera", None)
    if plain:
        raise ValueError(f"the simulator's study knows no {', '.join(sorted(plain))}")
    return Making(
        EffectSelection.read(",".join([ground, *switched])),
        _tolerance(overrides),
        elevations,
        nodes_per_beam,
        None if beams is None else int(beams),
        None if camera is None else _size(str(camera)),
    )


def _tolerance(overrides: Mapping[str, Value]) -> Tolerance:
    given = {
        name.removeprefix(TOLERANCE): float(value)
        for name, value in overrides.items()
        if name.startswith(TOLERANCE)
    }
    unknown = given.keys() - {field.name for field in fields(Tolerance)}
    if unknown:
        raise ValueError(f"a tolerance has no {', '.join(sorted(unknown))}")
    return Tolerance(**given)


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    return int(width), int(height)


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
class PingInstant:
    """One ping's circumstances."""

    number: int
    time_s: float
    map_T_sonar: FramePose  # noqa: N815 frames of a transform
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

DIVES = tuple(StudyDive(name, seed=1, quick=name == "flat_floor") for name in STRETCHES)


def grain_seeds(dive: StudyDive) -> range:
    """Of a setting's surfaces; those after them are the reference's."""
    return range(dive.seed, dive.seed + STRETCHES[dive.name].grains)


@functools.lru_cache(maxsize=2)
def scenario_of(dive: StudyDive) -> Scenario:
    """The scene, once a process: reading it takes longer than a ping."""
    return load_scenario(dive.name)


def moments_of(dive: StudyDive) -> list[list[PingInstant]]:
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


def _moment(scenario: Scenario, number: int, time_s: float) -> PingInstant:
    return PingInstant(number, time_s, sonar_pose(scenario, time_s), sonar_motion(scenario, time_s))
