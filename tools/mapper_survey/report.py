"""The report of a survey: coverage, overlap and disagreement, as numbers and pictures."""

import itertools
import json
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path

import msgspec
import numpy as np

from mapper_survey.coverage import BANDS, Coverage, Pictures, cover
from mapper_survey.difference import Comparison, Way, cubes_of, differences
from mapper_survey.errors import SurveyError
from mapper_survey.export import Progress, place_of
from mapper_survey.raster import Raster
from mapper_survey.report_pictures import draw_pictures
from mapper_survey.report_record import Report, report_of
from mapper_survey.tally import Tally
from mapper_survey.windows import WINDOW_BRICKS, StoredMap, Tiling, tiling_of
from mapperd.config.tree import Config
from mapperd.export.geotiff import write_tiles
from mapperd.geometry.geodesy import Origin
from mapperd.io import atomic_file, make_folder

__all__ = ["DIFFERENCE", "REPORT", "report_survey"]

REPORT, DIFFERENCE = "report.json", "difference.tif"


def report_survey(
    stores_by_dive: Mapping[str, Path],
    merged: Path,
    out_dir: Path,
    tolerance_m: float,
    progress: Progress = lambda _done, _all: None,
    *,
    origin: Origin | None = None,
    config: Config | None = None,
) -> Report:
    """Compare the dives of a survey, every two both ways, and write what is found.

    Memory holds one window of one map at a time, and pictures of at most 1200 pixels a side.

    Args:
        stores_by_dive: a map's file for each dive, all in one frame and of one resolution.
        merged: the map's file of all of them.
        out_dir: is made when it is not there; gets `report.json`, `difference.tif` and pictures.
        tolerance_m: within which voxels of two dives are the same.
        progress: is told how many parts are done, of how many.
        origin: of the GeoTIFF; None where nobody knows.
        config: its thresholds count; None takes the defaults.

    Raises:
        SurveyError: maps that cannot be compared, no surface at all, or a bad tolerance.
        StoreError: a map cannot be read, or bricks of it are damaged.
        ExportError: a file cannot be written, or a library is not there.
    """
    with ExitStack() as opening:
        whole = opening.enter_context(StoredMap(merged, config))
        stores = {
            name: opening.enter_context(StoredMap(path, config))
            for name, path in stores_by_dive.items()
        }
        _check(stores, whole)
        make_folder(out_dir)
        return _Comparing(stores, whole, tolerance_m, progress).write(out_dir, origin)


class _Comparing:
    """All dives of a survey, open."""

    def __init__(
        self,
        stores: Mapping[str, StoredMap],
        merged: StoredMap,
        tolerance_m: float,
        progress: Progress,
    ) -> None:
        self._stores, self._merged, self._progress = stores, merged, progress
        self._tolerance_m = tolerance_m
        self._comparison = Comparison(merged.resolution_m, tolerance_m)
        every = [stored.keys for stored in (*stores.values(), merged)]
        self._tiling: Tiling = tiling_of(np.concatenate(every), WINDOW_BRICKS)
        self._raster = Raster(self._tiling, merged.resolution_m)
        self._pictures = Pictures.empty(self._raster)
        self._coverage = Coverage(
            dict.fromkeys(stores, 0), dict.fromkeys(stores, 0), dict.fromkeys(stores, 0)
        )
        self._coverage.dz = {pair: Tally() for pair in itertools.combinations(stores, 2)}
        self._ways = {pair: Way() for pair in itertools.permutations(stores, 2)}

    def write(self, out_dir: Path, origin: Origin | None) -> Report:
        """Count everything, then write it."""
        tell = self._teller()
        place = place_of(self._tiling, self._comparison.resolution_m, 1)
        with atomic_file(out_dir / DIFFERENCE) as file:
            tiles = cover(
                self._stores,
                self._merged,
                self._tiling,
                self._coverage,
                self._pictures,
                raster=self._raster,
                tell=tell,
            )
            write_tiles(file, tiles, place, BANDS, origin, edge=self._tiling.edge)
            if not len(self._coverage.by_dives):
                raise SurveyError("no dive has an occupied voxel: there is nothing to report")
        self._compare(tell)
        mapping = self._merged.config.mapping
        report = report_of(
            self._comparison,
            self._coverage,
            self._ways,
            tolerance_m=self._tolerance_m,
            thresholds=(mapping.occupied_threshold, mapping.free_threshold),
        )
        with atomic_file(out_dir / REPORT) as file:
            plain = msgspec.to_builtins(report)
            file.write(json.dumps(plain, indent=2, allow_nan=False).encode() + b"\n")
        draw_pictures(out_dir, report, self._pictures, self._raster, self._ways)
        return report

    def _compare(self, tell: Callable[[], None]) -> None:
        raster, pictures = self._raster, self._pictures
        for found in differences(self._stores, self._ways, self._comparison, tell):
            x, y = found.index.T
            raster.put(pictures.compared, np.add.at, x, y, 1.0)
            raster.put(pictures.missing, np.add.at, x, y, found.missing)

    def _teller(self) -> Callable[[], None]:
        total = self._tiling.columns * self._tiling.rows + len(cubes_of(self._stores))
        done = itertools.count(1)
        return lambda: self._progress(next(done), total)


def _check(stores: Mapping[str, StoredMap], merged: StoredMap) -> None:
    if not stores:
        raise SurveyError("no dives: there is nothing to report")
    for name, stored in stores.items():
        if stored.resolution_m != merged.resolution_m:
            raise SurveyError(
                f"{name}: its voxels are {stored.resolution_m:g} m, those of the merged map "
                f"{merged.resolution_m:g} m: plan and run the survey again"
            )
    if not sum(len(stored.keys) for stored in stores.values()):
        raise SurveyError("the maps of all dives are empty: there is nothing to report")
