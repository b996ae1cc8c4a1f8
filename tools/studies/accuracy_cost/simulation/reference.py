"""The truth: the same pings with every effect on, and sampled until the picture stays.

Four columns of rays to a beam instead of one, 512 rays to a column instead of 128 (over the flat
floor 128 are enough), and 32 poses a ping that moves. Twice the rays in a column change it by less
than 0.005 dB RMS over the floor, in the harbour and in open water, and by 0.14 dB in the tank,
whose picture is made of mirrors.
"""

import math
import os
from dataclasses import astuple, dataclass, replace
from pathlib import Path

import numpy as np
from sonar_sim.effects.look import Look
from sonar_sim.effects.plan import Wish
from sonar_sim.effects.planner import Planner
from sonar_sim.engine import Engine
from sonar_sim.fan import MARGIN_BEAMS
from sonar_sim.sonar import SonarSettings
from sonar_sim.tolerance import Tolerance

from studies.accuracy_cost.simulation.grain import Grain
from studies.accuracy_cost.simulation.ours import Ours, Picture, expected
from studies.accuracy_cost.simulation.scenes import (
    STRETCHES,
    Moment,
    grain_seeds,
    moments_of,
    scenario_of,
)
from studies.accuracy_cost.simulation.settings import making_of
from studies.accuracy_cost.study import Dive, Value

FINER = 4
"""Columns to a beam."""
POSES = 32
"""A ping, where motion within it counts."""
SCATTERERS = 64
"""In a row of a beam's width, of the reference's grain."""
GRAINS = 3
"""Times as many random seeds as a setting has: the truth's chance is in all their errors."""
MOST_SINE = 0.99


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """The truth of a dive.

    Attributes:
        pictures: expected amplitudes of the first ping of each stretch, (rows, beams) each.
        grain: of the first pings.
    """

    pictures: list[Picture]
    grain: Grain


def prepare_reference(dive: Dive, folder: Path) -> None:
    """Write a dive's reference pictures, unless they are there."""
    path = _path(dive, folder)
    if path.exists():
        return
    pictures, grain = reference_pictures(dive), reference_grain(dive)
    folder.mkdir(parents=True, exist_ok=True)
    beside = path.with_suffix(f".{os.getpid()}.tmp")
    with beside.open("wb") as file:
        np.savez_compressed(
            file, pictures=np.stack(pictures).astype(np.float32), grain=np.array(astuple(grain))
        )
    beside.replace(path)


def load_reference(dive: Dive, folder: Path) -> Reference:
    """What `prepare_reference` wrote."""
    with np.load(_path(dive, folder)) as file:
        return Reference(list(file["pictures"].astype(np.float64)), Grain(*file["grain"].tolist()))


def reference_pictures(dive: Dive) -> list[Picture]:
    """Make them."""
    scenario = scenario_of(dive)
    sonar, fine = scenario.sonar, finer(scenario.sonar)
    elevations = STRETCHES[dive.name].elevations
    engine = Engine(scenario.scene, fine, dive.seed, threads=1, elevations=elevations)
    # What is decided is decided for the sonar itself: mirrors and poses are those of its picture.
    look = Look(scenario.scene, sonar, engine.meshes)
    planner = Planner(look, Wish.read("all"), Tolerance())
    margin = margin_beams(sonar)
    beams = slice(margin * FINER, (margin + sonar.beams - 1) * FINER + 1, FINER)
    return [
        _picture(engine, fine, planner, stretch[0])[:, beams].copy() for stretch in moments_of(dive)
    ]


def reference_grain(dive: Dive) -> Grain:
    """Of as many scatterers as leave no grain of their own, and surfaces of other random seeds."""
    everything: dict[str, Value] = {"sim.effects": "all", "sim.nodes_per_beam": SCATTERERS}
    of_settings = grain_seeds(dive)
    seeds = range(of_settings.stop, of_settings.stop + GRAINS * len(of_settings))
    return Ours(making_of(everything), dive).grain(seeds)


def finer(sonar: SonarSettings) -> SonarSettings:
    """The sonar with `FINER` times the beams, and a margin: the outermost ones hear beyond."""
    beams = FINER * (sonar.beams - 1 + 2 * margin_beams(sonar)) + 1
    half_sine = 0.5 * (beams - 1) * sonar.sine_pitch / FINER
    return replace(sonar, beams=beams, half_aperture_rad=math.asin(half_sine))


def margin_beams(sonar: SonarSettings) -> int:
    """Beams on each side of the sonar's own: as many as the engine hears, and 90° has room for."""
    room = (MOST_SINE - math.sin(sonar.half_aperture_rad)) / sonar.sine_pitch
    return min(MARGIN_BEAMS, int(room))


def _picture(engine: Engine, sonar: SonarSettings, planner: Planner, moment: Moment) -> Picture:
    planned = planner.at(moment.map_T_sonar, moment.number, moment.time_s, moment.motion)
    physics = planned.physics
    if physics.pose_blocks > 1:
        physics = replace(physics, pose_blocks=POSES)
    return expected(engine, sonar, moment, physics)


def _path(dive: Dive, folder: Path) -> Path:
    return folder / f"simulation-{dive.name}.npz"
