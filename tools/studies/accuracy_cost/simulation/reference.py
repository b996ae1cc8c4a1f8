"""The truth: the same pings with every effect on, and sampled until the picture stays.

Four columns of rays to a beam instead of one, 512 rays to a column instead of 128 (over the flat
floor 128 are enough), and 32 poses a ping that moves. Twice the rays in a column change it by less
than 0.005 dB RMS over the floor, in the harbour and in open water, and by 0.14 dB in the tank,
whose picture is made of mirrors.
"""

import functools
import math
import os
import time
import tracemalloc
from collections.abc import Iterable
from dataclasses import astuple, dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from sonar_sim.classic import ClassicImages, classic_camera, classic_images
from sonar_sim.classic import scan as plan_view
from sonar_sim.classic.pipeline import places
from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.effects.plan import EffectSelection
from sonar_sim.effects.planner import Planner
from sonar_sim.effects.previewer import Previewer
from sonar_sim.engine import PingEngine
from sonar_sim.raycast.depth_camera import DepthCamera, DepthImage
from sonar_sim.raycast.fan import MARGIN_BEAMS
from sonar_sim.scene.sonar import SonarSettings

from studies.accuracy_cost.simulation.error import Grain, Picture, grain_of, step
from studies.accuracy_cost.simulation.ours import Ours, expected
from studies.accuracy_cost.simulation.scenes import (
    STRETCHES,
    PingInstant,
    grain_seeds,
    making_of,
    moments_of,
    scenario_of,
)
from studies.accuracy_cost.study import StudyDive, Value

FINER = 4
"""Columns to a beam."""
POSES = 32
"""A ping, where motion within it counts."""
SCATTERERS = 64
"""In a row of a beam's width, of the reference's grain."""
GRAINS = 3
"""Times as many random seeds as a setting has: the truth's chance is in all their errors."""
MAX_SINE = 0.99


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """The truth of a dive.

    Attributes:
        pictures: expected amplitudes of the first ping of each stretch, (rows, beams) each.
        grain: of the first pings.
    """

    pictures: list[Picture]
    grain: Grain


def prepare_reference(dive: StudyDive, folder: Path) -> None:
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


def load_reference(dive: StudyDive, folder: Path) -> Reference:
    """What `prepare_reference` wrote."""
    with np.load(_path(dive, folder)) as file:
        return Reference(list(file["pictures"].astype(np.float64)), Grain(*file["grain"].tolist()))


def reference_pictures(dive: StudyDive) -> list[Picture]:
    """Make them."""
    scenario = scenario_of(dive)
    sonar, fine = scenario.sonar, finer(scenario.sonar)
    elevations = STRETCHES[dive.name].elevations
    engine = PingEngine(scenario.scene, fine, dive.seed, threads=1, elevations=elevations)
    # What is decided is decided for the sonar itself: mirrors and poses are those of its picture.
    look = Previewer(scenario.scene, sonar, engine.meshes)
    planner = Planner(look, EffectSelection.read("all"), Tolerance())
    margin = margin_beams(sonar)
    beams = slice(margin * FINER, (margin + sonar.beams - 1) * FINER + 1, FINER)
    return [
        _picture(engine, fine, planner, stretch[0])[:, beams].copy() for stretch in moments_of(dive)
    ]


def reference_grain(dive: StudyDive) -> Grain:
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
    room = (MAX_SINE - math.sin(sonar.half_aperture_rad)) / sonar.sine_pitch
    return min(MARGIN_BEAMS, int(room))


def _picture(
    engine: PingEngine, sonar: SonarSettings, planner: Planner, moment: PingInstant
) -> Picture:
    planned = planner.at(moment.map_T_sonar, moment.number, moment.time_s, moment.motion)
    physics = planned.physics
    if physics.pose_blocks > 1:
        physics = replace(physics, pose_blocks=POSES)
    return expected(engine, sonar, moment, physics)


def _path(dive: StudyDive, folder: Path) -> Path:
    return folder / f"simulation-{dive.name}.npz"


class Published:
    """The published pipeline with a camera of one size, on one dive."""

    def __init__(self, size: tuple[int, int], dive: StudyDive) -> None:
        self._camera, self._dive = classic_camera(*size), dive
        self._onlooker = _onlooker(dive)
        self.sonar = scenario_of(dive).sonar

    def cpu_ms(self) -> list[float]:
        """CPU time of each frame, the depth image included: here it is cast by Embree."""
        moments = [moment for stretch in moments_of(self._dive) for moment in stretch]
        threads = cv2.getNumThreads()
        cv2.setNumThreads(1)  # as ours: several would wait for each other at our expense
        try:
            self._frame(moments[0])
            return [self._timed_ms(moment) for moment in moments]
        finally:
            cv2.setNumThreads(threads)

    def memory_mb(self) -> float:
        """Most that arrays hold while a frame is made."""
        moment = moments_of(self._dive)[0][0]
        tracemalloc.start()
        try:
            before, _ = tracemalloc.get_traced_memory()
            self._frame(moment)
            _, most = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        return (most - before) / 1e6

    def pictures(self, truths: list[Picture]) -> list[Picture]:
        """In our cells, NaN where it does not look; without speckle, as ours are compared."""
        firsts = (stretch[0] for stretch in moments_of(self._dive))
        return [
            levelled(self._in_cells(moment), truth, self.sonar)
            for moment, truth in zip(firsts, truths, strict=True)
        ]

    def grain(self, seeds: Iterable[int]) -> Grain:
        """Of a frame's speckle over what it is drawn on, in the plan view."""
        moment = moments_of(self._dive)[0][0]
        return grain_of([self._level_db(moment, seed) for seed in seeds])

    def _level_db(self, moment: PingInstant, seed: int) -> Picture:
        """Level of a frame's speckle, NaN where nothing is drawn."""
        smooth, speckled = self._plan_views(moment, np.random.default_rng(seed))
        level_db = np.full(smooth.shape, np.nan)
        drawn = (smooth > 0.0) & (speckled > 0.0)
        level_db[drawn] = 20.0 * np.log10(speckled[drawn] / smooth[drawn])
        return level_db

    def _in_cells(self, moment: PingInstant) -> Picture:
        smooth, _ = self._plan_views(moment)
        return in_cells(smooth, self._camera.horizontal_rad, self.sonar)

    def _plan_views(
        self, moment: PingInstant, generator: np.random.Generator | None = None
    ) -> tuple[Picture, Picture]:
        """Before and after speckle, (400, columns)."""
        view, images = self._frame(moment, generator)
        x, y = places(view.depth_m.shape, self._camera.focal_px)
        pie = plan_view.sector_mask(self._camera.horizontal_rad)
        smooth = plan_view.blurred(plan_view.projected(view.depth_m, images.snr, x, y, pie))
        return smooth.astype(np.float64), images.raw_scan.astype(np.float64)

    def _timed_ms(self, moment: PingInstant) -> float:
        start_s = time.process_time()
        self._frame(moment)
        return 1e3 * (time.process_time() - start_s)

    def _frame(
        self, moment: PingInstant, generator: np.random.Generator | None = None
    ) -> tuple[DepthImage, ClassicImages]:
        view = self._onlooker.look(self._camera, moment.map_T_sonar)
        return view, classic_images(view.depth_m, self._camera.horizontal_rad, generator)


def in_cells(plan: Picture, horizontal_rad: float, sonar: SonarSettings) -> Picture:
    """Value of a plan view (400, columns) in each of the sonar's cells, (rows, beams)."""
    sine = (np.arange(sonar.beams) - (sonar.beams - 1) / 2.0) * sonar.sine_pitch
    range_m = sonar.row_centres_m[:, None]
    per_m = plan_view.ROWS / plan_view.RANGE_M
    ahead_m, aside_m = range_m * np.sqrt(1.0 - sine**2), range_m * sine
    row = plan_view.ROWS - 1 - np.trunc(ahead_m * per_m).astype(np.int64)
    column = plan.shape[1] // 2 + np.trunc(aside_m * per_m).astype(np.int64)
    looked_at = (np.abs(sine) < np.sin(horizontal_rad / 2.0)) & (row >= 0)
    inside = looked_at & (column >= 0) & (column < plan.shape[1])
    found = plan[np.where(inside, row, 0), np.where(inside, column, 0)]
    return np.where(inside, found, np.nan).astype(np.float64)


def levelled(values: Picture, truth: Picture, sonar: SonarSettings) -> Picture:
    """Values 0 to 1 of a frame as amplitudes, by the straight line of levels that fits best."""
    used = np.isfinite(values) & (truth >= step(sonar))
    level_db = 20.0 * np.log10(truth[used])
    slope, offset = 0.0, float(level_db.mean()) if used.any() else 0.0
    if used.any() and np.ptp(values[used]) > 0.0:
        slope, offset = np.polyfit(values[used], level_db, 1)
    return np.asarray(10.0 ** ((offset + slope * values) / 20.0), dtype=np.float64)


@functools.lru_cache(maxsize=1)
def _onlooker(dive: StudyDive) -> DepthCamera:
    return DepthCamera(scenario_of(dive).scene)
