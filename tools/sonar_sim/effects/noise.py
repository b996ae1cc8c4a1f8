"""Noise: the water's thermal motion and the receiver's own."""

import math

import numpy as np

from sonar_sim.effects.effect import Cost, Effect, Parameter, Verdict
from sonar_sim.effects.preview import View
from sonar_sim.effects.verdicts import by_level
from sonar_sim.propagation.physics import Physics
from sonar_sim.receiver.gain import noise_level_db
from sonar_sim.tolerance import Tolerance


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On if the noise, after the gains, shows anywhere."""
    silence = np.maximum(view.picture - view.noise_power, 0.0)
    floor = view.gains.amplitude(np.full_like(view.picture, view.noise_power)).max()
    reason = f"after gains the noise reaches {20.0 * math.log10(floor):.0f} dB of full scale"
    return by_level(view.change_db(silence, tolerance), tolerance, reason)


def configure(physics: Physics, view: View) -> None:
    """Give the level in a cell."""
    physics.noise_level_db = noise_level_db(view.sonar, view.scene.water)


EFFECT = Effect(
    name="noise",
    does="fills what is silent, the more so the farther out; new in every ping",
    needs="bandwidth, array gain, the receiver's own noise",
    formula="-15 + 20 log f_kHz dB re 1 µPa²/Hz in band, less array gain, plus self noise",
    source="Mellen 1952",
    rule="the picture without noise differs by more than the tolerance",
    cost=Cost.CELL,
    parameters=(
        Parameter("sonar.array_gain_db", "dB", "against ambient noise"),
        Parameter("sonar.noise_excess_db", "dB", "of the receiver's own noise over ambient noise"),
    ),
    decide=decide,
    configure=configure,
)
