"""Bubbles: plumes and wakes that hide what is behind and shine themselves."""

from dataclasses import replace

from sonar_sim.effects.clouds import clouds_of
from sonar_sim.effects.effect import Cost, Effect, Parameter, Verdict
from sonar_sim.effects.preview import View
from sonar_sim.effects.verdicts import by_level
from sonar_sim.propagation.physics import Physics
from sonar_sim.scene.scene import Bubbles
from sonar_sim.tolerance import Tolerance


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On if a declared cloud of bubbles is in sight and shows."""
    clouds = view.clouds_of(Bubbles)
    if not clouds:
        return Verdict(on=False, reason="the scene declares no bubbles", predicted_db=0.0)
    deepest_db = float(view.two_way_cloud_db(clouds, view.echoes).max(initial=0.0))
    reason = f"clouds take up to {deepest_db:.1f} dB of what is behind"
    # A plume fills few pixels and is faint, but it is what one looks for.
    anywhere = replace(tolerance, share=0.0)
    picture = view.heard_without(Bubbles) + view.noise_power
    return by_level(view.change_db(picture, anywhere), tolerance, reason)


def configure(physics: Physics, view: View) -> None:
    """Add the clouds."""
    physics.clouds = (*physics.clouds, *clouds_of(view, Bubbles))


EFFECT = Effect(
    name="bubbles",
    does="draws plumes, and dims what lies behind them",
    needs="declared clouds",
    formula="4.34 n 2 pi a² dB/m; back scattering n a² / 4",
    source="geometric optics above the resonance 3.26 / a Hz (Minnaert)",
    rule="any pixel without the clouds differs by more than the tolerance",
    cost=Cost.RAY,
    parameters=(
        Parameter("cloud.low_m", "m", "corner of the box, and high_m the other"),
        Parameter("bubbles.radius_m", "m", "of each"),
        Parameter("bubbles.per_m3", "1/m³", "number"),
    ),
    decide=decide,
    configure=configure,
    anywhere=True,
)
