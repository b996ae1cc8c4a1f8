"""The study: what is measured of a setting on a scene."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from sonar_sim.effects.plan import EffectWarning

from studies.accuracy_cost.simulation.error import picture_errors, rounded
from studies.accuracy_cost.simulation.grain import grain_errors, kept_grain
from studies.accuracy_cost.simulation.knobs import KNOBS, WHOLES
from studies.accuracy_cost.simulation.ours import Ours
from studies.accuracy_cost.simulation.published import Published
from studies.accuracy_cost.simulation.reference import Reference, load_reference, prepare_reference
from studies.accuracy_cost.simulation.scenes import DIVES, grain_seeds, scenario_of
from studies.accuracy_cost.simulation.settings import Making, making_of
from studies.accuracy_cost.study import Column, Dive, Knob, Setting

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
    dives: Sequence[Dive] = DIVES
    wholes: Sequence[Setting] = WHOLES
    columns: Sequence[Column] = COLUMNS
    error: str = "image_rms_db"
    cost: str = "ping_cpu_ms"

    def prepare(self, dive: Dive, folder: Path) -> None:
        """Make the dive's reference pictures."""
        prepare_reference(dive, folder)

    def measure(self, setting: Setting, dive: Dive, folder: Path) -> dict[str, float]:
        """Errors and costs of a setting on a dive."""
        making, truth = making_of(setting.overrides), load_reference(dive, folder)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", EffectWarning)
            if making.camera is None:
                return _ours(making, dive, truth, folder)
            return _published(making.camera, dive, truth)


def _ours(making: Making, dive: Dive, truth: Reference, folder: Path) -> dict[str, float]:
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


def _published(camera: tuple[int, int], dive: Dive, truth: Reference) -> dict[str, float]:
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
