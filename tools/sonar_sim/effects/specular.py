"""Specular lobe: smooth surfaces that face the sonar flash."""

from dataclasses import replace

from sonar_sim.effects.effect import Cost, Effect, Parameter, Verdict
from sonar_sim.effects.preview import View
from sonar_sim.effects.verdicts import by_level
from sonar_sim.propagation.physics import Physics
from sonar_sim.tolerance import Tolerance


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On if the lobe of a smooth surface reaches back to the sonar."""
    echoes = view.echoes
    # A ball's flash or a distant plate's fills few pixels, but those are what one looks for.
    anywhere = replace(tolerance, share=0.0)
    predicted_db = view.change_of_echoes_db(echoes.lambert_m2 * view.unscattered, anywhere)
    flashing = {
        view.scene.surfaces[i].name
        for i in set(echoes.surface[echoes.lobe_m2 > echoes.lambert_m2].tolist())
        if i >= 0
    }
    named = ", ".join(sorted(flashing)[:3]) if flashing else "no smooth surface"
    return by_level(predicted_db, tolerance, f"{named} mirrors more than it scatters")


def configure(physics: Physics, view: View) -> None:
    """Add the lobe."""
    del view
    physics.specular = True


EFFECT = Effect(
    name="specular",
    does="lets smooth surfaces flash where they face the sonar",
    needs="reflection, roughness, slopes of materials; normals",
    formula="|G|² exp(-4 k² h² cos² i) sec⁴ i / (8 pi s²) exp(-tan² i / (2 s²)) a unit area",
    source="geometric optics of a rough surface (Kirchhoff); Rayleigh's roughness",
    rule="any pixel without the lobe differs by more than the tolerance",
    cost=Cost.SCATTERER,
    parameters=(
        Parameter("material.reflection", "1", "of pressure, signed"),
        Parameter("material.roughness_m", "m", "standard deviation of the height"),
        Parameter("material.slope_rad", "rad", "standard deviation of the slope"),
    ),
    decide=decide,
    configure=configure,
    anywhere=True,
)
