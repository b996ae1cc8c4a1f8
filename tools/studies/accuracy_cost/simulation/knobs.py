"""What is turned in the simulator, and how far."""

from collections.abc import Sequence

from sonar_sim.effects.effect import Effect
from sonar_sim.effects.registry import EFFECTS
from sonar_sim.engine import NODES_PER_BEAM
from sonar_sim.fan import ELEVATIONS
from sonar_sim.tolerance import Tolerance

from studies.accuracy_cost.study import Knob, Setting

MARGIN = 0.25
"""Share of the error by which a default may lie behind the front. Errors of levels are those of
expected pictures and hold no chance but that of the scenes: with other five, a lag differs by about
0.1 (its standard error over ours: `auto` errs twice as much as everything in the harbour, and as
much in the others). These are two of them, and a bit."""
GRAIN_MARGIN = 0.0
"""None for the grain: its chance is measured in each run, and a lag is what goes beyond it."""
GRAIN, ROWS = "grain_spread_db", "grain_correlation"
"""Columns of the error of what does not change levels."""
QUICK = ("elevations",)
"""Knobs that every test run turns: what pays off on any scene."""
ERROR_OF = {"speckle": GRAIN, "range_spread": ROWS}
HINTS = {
    "refraction": " Where it is called for, it is the first to turn off: bent paths cost some four "
    "times a whole ping of straight ones.",
    "speckle": " It saves time: pictures without it are taken at a finer walk over each patch.",
    "bearing_table": " It saves time: beams at equal angles follow no column of rays.",
    "multipath": " Each mirror is one more cast, and where there are mirrors its want shows.",
}
"""What to do about effects whose cost shows."""


def _swept(
    knob: tuple[str, str], dotted: str, values: Sequence[float], default: float, advice: str
) -> Knob:
    """A knob of numbers.

    Args:
        knob: name and title.
        dotted: the override.
        values: to which it is turned, the default among them.
        default: measured without an override.
        advice: what turning it buys and costs.
    """
    settings = tuple(
        Setting(f"{value:g}", {} if value == default else {dotted: value}) for value in values
    )
    error = GRAIN if dotted == "sim.nodes_per_beam" else None
    return Knob(*knob, settings, None, _margin(error), advice, error, quick=knob[0] in QUICK)


def _margin(error: str | None) -> float:
    return GRAIN_MARGIN if error else MARGIN


def _switched(effect: Effect) -> Knob:
    """An effect as its rule has it, always on, and always off."""
    name = f"sim.effect.{effect.name}"
    settings = (
        Setting("auto", {}),
        Setting("on", {name: True}),
        Setting("off", {name: False}),
    )
    error = ERROR_OF.get(effect.name)
    spoken = effect.name.replace("_", " ")
    advice = f"{spoken.capitalize()} {effect.does}; its work grows with {_work(effect)}."
    advice += HINTS.get(effect.name, "")
    title = f"effect: {spoken}"
    return Knob(
        f"effect-{effect.name.replace('_', '-')}",
        title,
        settings,
        None,
        _margin(error),
        advice,
        error,
    )


def _work(effect: Effect) -> str:
    return "nothing" if effect.cost.value == "free" else effect.cost.value


SAMPLING = (
    _swept(
        ("elevations", "rays of a beam's column"),
        "sim.elevations",
        (8, 16, 32, 48, 64, 96, 128, 256),
        ELEVATIONS,
        "The knob to turn first: half the rays take a quarter less time, and levels hardly "
        "change; where mirrors make the picture, as in a tank, half of them miss much.",
    ),
    _swept(
        ("scatterers", "scatterers in a row of a beam's width"),
        "sim.nodes_per_beam",
        (1, 2, 4, 8, 16, 32),
        NODES_PER_BEAM,
        "Fewer scatterers change the grain alone, never the level; half of them save a tenth.",
    ),
    _swept(
        ("beams", "beams of the picture"),
        "sim.beams",
        (128, 256, 512, 1024),
        512,
        "Half the beams take a quarter less time, and blur steep edges at the sides of the fan.",
    ),
)
TOLERANCES = (
    _swept(
        ("tolerance-level", "tolerance of auto: level, dB"),
        "sim.tolerance.level_db",
        (0.1, 0.25, 0.5, 1.0, 2.0, 3.0, 6.0),
        Tolerance().level_db,
        "No knob for speed: what a larger tolerance leaves out beyond the usual costs next to "
        "nothing, and its want shows.",
    ),
    _swept(
        ("tolerance-cells", "tolerance of auto: displacement, cells"),
        "sim.tolerance.cells",
        (0.1, 0.25, 0.5, 1.0, 2.0),
        Tolerance().cells,
        "Decides on motion, Doppler, refraction and the speed of sound.",
    ),
    _swept(
        ("tolerance-share", "tolerance of auto: share of the pixels"),
        "sim.tolerance.share",
        (0.0, 0.001, 0.01, 0.1),
        Tolerance().share,
        "Pixels that may differ by more than the tolerated level.",
    ),
)
EFFECT_KNOBS = tuple(_switched(effect) for effect in EFFECTS.values())

KNOBS = (*SAMPLING, *TOLERANCES, *EFFECT_KNOBS)

WHOLES = (
    Setting("everything", {"sim.effects": "all"}),
    Setting("published, 760 x 169", {"sim.camera": "760x169"}),
    Setting("published, 768 x 492", {"sim.camera": "768x492"}),
)
