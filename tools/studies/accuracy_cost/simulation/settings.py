"""What the study's dotted names mean to the simulator.

sim.effects             auto, all or none: the ground on which effects are switched
sim.effect.NAME         an effect on or off, whatever its rule says
sim.tolerance.FIELD     of `sonar_sim.tolerance.Tolerance`
sim.elevations          rays of a column
sim.nodes_per_beam      scatterers in a row of a beam's width
sim.beams               of the picture
sim.camera              WIDTHxHEIGHT: the published pipeline with a camera of that size
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields

from sonar_sim.effects.plan import Wish
from sonar_sim.engine import NODES_PER_BEAM
from sonar_sim.fan import ELEVATIONS
from sonar_sim.tolerance import Tolerance

from studies.accuracy_cost.study import Value

EFFECT, TOLERANCE = "sim.effect.", "sim.tolerance."


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

    effects: Wish
    tolerance: Tolerance
    elevations: int
    nodes_per_beam: float
    beams: int | None
    camera: tuple[int, int] | None


def making_of(overrides: Mapping[str, Value]) -> Making:
    """Read a setting's overrides.

    Raises:
        ValueError: a name is none of the above.
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
        Wish.read(",".join([ground, *switched])),
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
