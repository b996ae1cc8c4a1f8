"""The study: what is measured of a setting on a scene."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from sonar_sim.effects.effect import Effect
from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.effects.plan import EffectWarning
from sonar_sim.effects.registry import EFFECTS

from studies.accuracy_cost.simulation.error import grain_errors, kept_grain, picture_errors, rounded
from studies.accuracy_cost.simulation.ours import Ours
from studies.accuracy_cost.simulation.reference import (
    Published,
    Reference,
    load_reference,
    prepare_reference,
)
from studies.accuracy_cost.simulation.scenes import (
    DIVES,
    ELEVATIONS,
    NODES_PER_BEAM,
    Making,
    grain_seeds,
    making_of,
    scenario_of,
)
from studies.accuracy_cost.study import Column, Knob, Setting, StudyDive

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
    "refraction": "The first to turn off: no other effect costs as much as refracted paths.",
    "speckle": "Saves time: without it each patch is sampled more finely.",
    "bearing_table": "Saves time: beams at equal angles follow no column of rays.",
    "multipath": "Each mirror is one more cast.",
}
"""What to do about effects whose cost shows; docs/reference/simulator-effects.md has them all."""


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
    title = f"effect: {spoken}"
    return Knob(
        f"effect-{effect.name.replace('_', '-')}",
        title,
        settings,
        None,
        _margin(error),
        HINTS.get(effect.name, ""),
        error,
    )


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
NOT_RECORDED = frozenset({"all_elevations", "near_field", "reverberation", "ring_down"})
"""Effects that the recorded results do not hold."""
EFFECT_KNOBS = tuple(
    _switched(effect) for name, effect in EFFECTS.items() if name not in NOT_RECORDED
)

KNOBS = (*SAMPLING, *TOLERANCES, *EFFECT_KNOBS)

WHOLES = (
    Setting("everything", {"sim.effects": "all"}),
    Setting("published, 760 x 169", {"sim.camera": "760x169"}),
    Setting("published, 768 x 492", {"sim.camera": "768x492"}),
)


COLUMNS = (
    Column("image_rms_db", "error of the picture's levels, RMS, dB"),
    Column("image_p95_db", "error of the picture's levels, 95th percentile, dB"),
    Column("beyond_tolerance", "share of the visible pixels off by more than 0.5 dB"),
    Column("return_median_m", "error of a beam's first return, median, m"),
    Column("return_p95_m", "error of a beam's first return, 95th percentile, m"),
    Column("return_missed", "share of the beams with a first return too many or too few"),
    Column(
        "grain_spread_db",
        "error of the speckle's spread of levels, dB",
        chance="grain_spread_chance_db",
    ),
    Column("grain_spread_chance_db", "its standard error over random seeds, dB"),
    Column(
        "grain_correlation",
        "error of the speckle's correlation from row to row",
        chance="grain_correlation_chance",
    ),
    Column("grain_correlation_chance", "its standard error over random seeds"),
    Column("ping_cpu_ms", "CPU time of a ping, median, ms", repeatable=False),
    Column("ping_cpu_p95_ms", "CPU time of a ping, 95th percentile, ms", repeatable=False),
    Column("ping_memory_mb", "arrays of a ping, MB", repeatable=False),
)


@dataclass(frozen=True, slots=True)
class SimulationStudy:
    """The simulator's study; see `studies.accuracy_cost.study.Study`."""

    name: str = "simulation"
    knobs: Sequence[Knob] = KNOBS
    dives: Sequence[StudyDive] = DIVES
    wholes: Sequence[Setting] = WHOLES
    columns: Sequence[Column] = COLUMNS
    error: str = "image_rms_db"
    cost: str = "ping_cpu_ms"

    def prepare(self, dive: StudyDive, folder: Path) -> None:
        """Make the dive's reference pictures."""
        prepare_reference(dive, folder)

    def measure(self, setting: Setting, dive: StudyDive, folder: Path) -> dict[str, float]:
        """Errors and costs of a setting on a dive."""
        making, truth = making_of(setting.overrides), load_reference(dive, folder)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", EffectWarning)
            if making.camera is None:
                return _ours(making, dive, truth, folder)
            return _published(making.camera, dive, truth)


def _ours(making: Making, dive: StudyDive, truth: Reference, folder: Path) -> dict[str, float]:
    ours, sonar = Ours(making, dive), scenario_of(dive).sonar
    pairs = [
        # Where both are integers the rounding itself is not compared: a hair would be a step.
        (seen.expected, true if seen.rounded else rounded(true, sonar))
        for seen, true in zip(ours.pictures(), truth.pictures, strict=True)
    ]
    kept = folder / f"grain-{dive.name}-{ours.grain_key()}.npy"
    grain = kept_grain(kept, lambda: ours.grain(grain_seeds(dive)))
    errors = {**picture_errors(pairs, sonar), **grain_errors(grain, truth.grain)}
    return {**errors, **_costs(ours.cpu_ms(), ours.memory_mb())}


def _published(camera: tuple[int, int], dive: StudyDive, truth: Reference) -> dict[str, float]:
    theirs = Published(camera, dive)
    pairs = list(zip(theirs.pictures(truth.pictures), truth.pictures, strict=True))
    errors = {
        **picture_errors(pairs, theirs.sonar),
        **grain_errors(theirs.grain(grain_seeds(dive)), truth.grain),
    }
    return {**errors, **_costs(theirs.cpu_ms(), theirs.memory_mb())}


def _costs(cpu_ms: list[float], memory_mb: float) -> dict[str, float]:
    return {
        "ping_cpu_ms": float(np.median(cpu_ms)),
        "ping_cpu_p95_ms": float(np.quantile(cpu_ms, 0.95)),
        "ping_memory_mb": memory_mb,
    }


STUDY = SimulationStudy()
