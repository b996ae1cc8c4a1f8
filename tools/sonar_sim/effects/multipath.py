"""Multipath: a calm surface or a smooth wall throws echoes on, and ghosts appear behind."""

from weakref import WeakKeyDictionary

import numpy as np

from sonar_sim.effects.echoes import Echoes
from sonar_sim.effects.effect import Cost, Effect, Parameter, Verdict
from sonar_sim.effects.ghosts import Ghosts, ghosts_of
from sonar_sim.effects.preview import View
from sonar_sim.effects.verdicts import by_level
from sonar_sim.propagation.physics import Physics
from sonar_sim.tolerance import Tolerance

_KNOWN: WeakKeyDictionary[Echoes, list[Ghosts]] = WeakKeyDictionary()


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On if the ghosts in all planes together show."""
    if not view.planes:
        return Verdict(on=False, reason="no plane is smooth enough to mirror", predicted_db=0.0)
    found = _ghosts(view)
    picture = view.picture + sum((g.picture for g in found), np.zeros_like(view.picture))
    strongest = max((abs(g.mirror.reflection) for g in found), default=0.0)
    reason = f"{len(found)} of {len(view.planes)} planes mirror, reflecting up to {strongest:.2g}"
    return by_level(view.change_db(picture, tolerance), tolerance, reason)


def _ghosts(view: View) -> list[Ghosts]:
    known = _KNOWN.get(view.echoes)
    if known is None:
        found = (ghosts_of(view, plane) for plane in view.planes)
        known = _KNOWN[view.echoes] = [ghosts for ghosts in found if ghosts is not None]
    return known


def configure(physics: Physics, view: View) -> None:
    """List the planes that have ghosts in range."""
    physics.mirrors = tuple(ghosts.mirror for ghosts in _ghosts(view))


EFFECT = Effect(
    name="multipath",
    does="repeats echoes behind themselves, by way of the surface or a wall",
    needs="planes smooth against the wavelength",
    formula="images at (d + b) / 2, coherent, and b; G exp(-2 k² h² cos² i) a bounce",
    source="Eckart 1953; Lloyd's mirror",
    rule="the ghosts of a coarse picture change it by more than the tolerance",
    cost=Cost.CAST,
    parameters=(
        Parameter("sea.rms_height_m", "m", "standard deviation of the surface's height"),
        Parameter("material.reflection", "1", "of pressure, signed"),
        Parameter("material.roughness_m", "m", "standard deviation of a wall's height"),
    ),
    decide=decide,
    configure=configure,
)
