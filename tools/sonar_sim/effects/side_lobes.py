"""Side lobes: a bright echo sounds faintly in all beams of its row, an arc."""

from dataclasses import replace

from sonar_sim.effects.effect import Cost, Effect, Parameter, Verdict
from sonar_sim.effects.preview import View
from sonar_sim.effects.verdicts import by_level
from sonar_sim.propagation.physics import Physics
from sonar_sim.tolerance import Tolerance


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On if arcs rise out of what is in their rows anyway.

    An arc is as thin as its echo is short, and thinner ones are brighter: rows are those of the
    sonar.
    """
    fine = view.fine
    main = fine.grid.main_lobes(fine.echoes, fine.echo_power)
    # A single arc is an artefact to be seen, however few its pixels.
    anywhere = replace(tolerance, share=0.0)
    predicted_db = fine.change_db(fine.picture - fine.echo_picture + main, anywhere)
    reason = f"lobes {view.sonar.side_lobe_db:.0f} dB down of each row's echoes over its background"
    return by_level(predicted_db, tolerance, reason)


def configure(physics: Physics, view: View) -> None:
    """Give the lobes their level."""
    physics.side_lobe_db = view.sonar.side_lobe_db


EFFECT = Effect(
    name="side_lobes",
    does="draws arcs through bright echoes",
    needs="side lobe level, contrast within rows",
    formula="the azimuth pattern beyond its main lobe: a sinc of the side lobes' level",
    source="line array shaded by a Gaussian on a pedestal",
    rule="the arcs change any pixel by more than the tolerance",
    cost=Cost.CELL,
    parameters=(Parameter("sonar.side_lobe_db", "dB", "under the main lobe, positive"),),
    decide=decide,
    configure=configure,
    anywhere=True,
)
