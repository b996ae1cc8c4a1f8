"""Range spread: an echo sounds in the neighbouring rows too."""

from sonar_sim.effects.effect import Cost, Effect, Parameter, Verdict
from sonar_sim.effects.preview import View
from sonar_sim.effects.verdicts import LEVEL_SPREAD_DB, ROW_CORRELATION
from sonar_sim.propagation.physics import Physics
from sonar_sim.tolerance import Tolerance


def decide(view: View, tolerance: Tolerance) -> Verdict:
    """On if the resolution of the pulse is not much finer than a row."""
    bandwidth_hz = view.sonar.bandwidth_hz(view.speed_mps)
    resolution_rows = view.speed_mps / (2.0 * bandwidth_hz) / view.sonar.range_resolution_m
    on = resolution_rows >= 0.5 and tolerance.texture < ROW_CORRELATION  # noqa: PLR2004 half a row
    reason = f"the pulse resolves {resolution_rows:.1f} rows; rows correlate {ROW_CORRELATION}"
    leak_db = LEVEL_SPREAD_DB * (2.0 * ROW_CORRELATION) ** 0.5
    return Verdict(on, reason, leak_db)


def configure(physics: Physics, view: View) -> None:
    """Let neighbouring rows overlap."""
    del view
    physics.range_spread = True


EFFECT = Effect(
    name="range_spread",
    does="makes the speckle of neighbouring rows alike (correlation 0.19)",
    needs="bandwidth",
    formula="matched filter of width c / (2 B); a field leaks 0.24 into each neighbour",
    source="public Oculus recording: correlation of neighbouring rows 0.19",
    rule="c / (2 B) of at least half a row, and a tolerance of texture below the correlation",
    cost=Cost.CELL,
    parameters=(Parameter("sonar.base_row_m", "m", "finest row, which the bandwidth resolves"),),
    decide=decide,
    configure=configure,
)
