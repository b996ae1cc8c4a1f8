"""The published image-sonar plugin's pipeline on the same pings, read as kindly as can be.

Its picture is a plan view of 17 m whose levels are stretched to each frame. So each of our cells
takes the value that its plan view has there, cells outside of its camera's fan are not held against
it, and its values become levels by the straight line that fits the reference best.
"""

import functools
import time
import tracemalloc
from collections.abc import Iterable

import cv2
import numpy as np
from sonar_sim.classic import ClassicImages, classic_camera, classic_images
from sonar_sim.classic import scan as plan_view
from sonar_sim.classic.pipeline import places
from sonar_sim.pinhole import Onlooker, View
from sonar_sim.sonar import SonarSettings

from studies.accuracy_cost.simulation.error import Picture, step
from studies.accuracy_cost.simulation.grain import Grain, grain_of
from studies.accuracy_cost.simulation.scenes import Moment, moments_of, scenario_of
from studies.accuracy_cost.study import Dive


class Published:
    """The published pipeline with a camera of one size, on one dive."""

    def __init__(self, size: tuple[int, int], dive: Dive) -> None:
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

    def _level_db(self, moment: Moment, seed: int) -> Picture:
        """Level of a frame's speckle, NaN where nothing is drawn."""
        smooth, speckled = self._plan_views(moment, np.random.default_rng(seed))
        level_db = np.full(smooth.shape, np.nan)
        drawn = (smooth > 0.0) & (speckled > 0.0)
        level_db[drawn] = 20.0 * np.log10(speckled[drawn] / smooth[drawn])
        return level_db

    def _in_cells(self, moment: Moment) -> Picture:
        smooth, _ = self._plan_views(moment)
        return in_cells(smooth, self._camera.horizontal_rad, self.sonar)

    def _plan_views(
        self, moment: Moment, generator: np.random.Generator | None = None
    ) -> tuple[Picture, Picture]:
        """Before and after speckle, (400, columns)."""
        view, images = self._frame(moment, generator)
        x, y = places(view.depth_m.shape, self._camera.focal_px)
        pie = plan_view.pie(self._camera.horizontal_rad)
        smooth = plan_view.broadened(plan_view.strewn(view.depth_m, images.snr, x, y, pie))
        return smooth.astype(np.float64), images.raw_scan.astype(np.float64)

    def _timed_ms(self, moment: Moment) -> float:
        start_s = time.process_time()
        self._frame(moment)
        return 1e3 * (time.process_time() - start_s)

    def _frame(
        self, moment: Moment, generator: np.random.Generator | None = None
    ) -> tuple[View, ClassicImages]:
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
def _onlooker(dive: Dive) -> Onlooker:
    return Onlooker(scenario_of(dive).scene)
