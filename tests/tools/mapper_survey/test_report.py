"""Coverage, overlap and disagreement of dives; distances are judged by SciPy's trees."""

import itertools
import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import rasterio
from mapper_survey.errors import SurveyError
from mapper_survey.report import Report, report_survey
from mapper_survey.windows import WindowedMap
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import cKDTree

from mapperd.config.tree import Config, MappingConfig, OctreeConfig
from mapperd.errors import StoreError
from mapperd.mapping.sonar_map import SonarMap
from tests.tools.mapper_survey.maps import RESOLUTION_M, centres, map_of, store_of

pytestmark = pytest.mark.slow

TOLERANCE_M = 0.2
PICTURES = ("coverage.png", "overlap.png", "disagreement.png", "distances.png")
AREA_M2 = RESOLUTION_M**2

Ints = NDArray[np.int64]
Maps = dict[str, SonarMap]


def dive(seed: int, west: int, east: int, risen: int) -> SonarMap:
    """A rough floor between two edges, with clear water above it."""
    random = np.random.default_rng(seed)
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(west, east, 3), np.arange(-20, 60, 4)))
    z = -60 + risen * (x > 0) + np.rint(random.normal(0, 0.8, len(x))).astype(np.int64)
    z += 13 * (random.random(len(x)) < 0.02)  # fish
    floor = np.stack([x, y, z], axis=1)
    water = np.concatenate([floor + np.array([0, 0, above]) for above in range(1, 16)])
    seen = random.random(len(floor)) < 0.9
    unsure = random.random(len(water)) < 0.2
    sonar_map = map_of(water[unsure], 0.3, water[~unsure])
    sonar_map.core.set_log_odds(centres(floor[seen]), random.uniform(1.0, 5.0, seen.sum()))
    return sonar_map


@pytest.fixture(scope="module")
def maps() -> Maps:
    """Two that lie over each other, of which one ends four voxels higher, and one far off."""
    return {"a": dive(1, -279, 120, 0), "b": dive(2, -90, 290, 4), "c": dive(3, 399, 450, 0)}


@pytest.fixture(scope="module")
def files(maps: Maps, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("dives")
    merged = SonarMap(maps["a"].config)
    merged.core.merge(*(one.core for one in maps.values()))
    every = maps | {"merged": merged}
    return {name: store_of(folder / f"{name}.db", one) for name, one in every.items()}


def reported(files: dict[str, Path], out: Path, **how: Any) -> Report:
    dives = {name: path for name, path in files.items() if name != "merged"}
    return report_survey(dives, files["merged"], out, how.pop("tolerance_m", TOLERANCE_M), **how)


@pytest.fixture(scope="module")
def made(files: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> tuple[Report, Path]:
    out = tmp_path_factory.mktemp("report")
    return reported(files, out), out


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Pictures take most of the time, and are looked at once."""
    monkeypatch.setattr("mapper_survey.report.draw_pictures", lambda *_: None)
    return monkeypatch


def indices(sonar_map: SonarMap, kind: Any) -> Ints:
    centres_m = sonar_map.voxels(kind).centres_m
    return np.asarray(np.rint(centres_m / RESOLUTION_M - 0.5).astype(np.int64))


def known(sonar_map: SonarMap) -> set[tuple[int, ...]]:
    centres_m, _, _ = sonar_map.core.voxels()
    return set(map(tuple, np.rint(centres_m / RESOLUTION_M - 0.5).astype(int).tolist()))


def tops(sonar_map: SonarMap) -> dict[tuple[int, int], int]:
    found: dict[tuple[int, int], int] = {}
    for x, y, z in indices(sonar_map, "occupied").tolist():
        found[x, y] = max(z, found.get((x, y), z))
    return found


@pytest.mark.slow
def test_distances_are_those_of_a_tree(made: tuple[Report, Path], maps: Maps) -> None:
    ways = {}
    for pair in made[0].pairs:
        ways[pair.a, pair.b], ways[pair.b, pair.a] = pair.a_to_b, pair.b_to_a
    assert ways.keys() == set(itertools.permutations(maps, 2))
    for (a, b), way in ways.items():
        from_a, to_b = indices(maps[a], "occupied"), indices(maps[b], "occupied")
        metres, _ = cKDTree(to_b).query(from_a)
        metres = metres * RESOLUTION_M
        near = metres <= TOLERANCE_M + 1e-9
        of_b, free_of_b = known(maps[b]), set(map(tuple, indices(maps[b], "free").tolist()))
        compared = near | np.array([tuple(one) in of_b for one in from_a.tolist()])
        free = np.array([tuple(one) in free_of_b for one in from_a.tolist()])
        assert (way.voxels, way.common) == (len(from_a), near.sum())
        assert (way.only, way.missing) == ((~near).sum(), (compared & ~near).sum())
        assert (way.compared, way.called_free) == (compared.sum(), free.sum())
        assert way.conflicts == (free & ~near).sum()
        assert way.farther == (metres[compared] > 1.0 + 1e-9).sum()
        if not compared.any():
            assert (way.median_m, way.p95_m, way.missing_share) == (None, None, None)
            continue
        assert way.missing_share == pytest.approx((compared & ~near).sum() / compared.sum())
        for share, reported in ((0.5, way.median_m), (0.95, way.p95_m)):
            expected = np.quantile(metres[compared], share, method="inverted_cdf")
            assert reported == pytest.approx(expected if expected <= 1.0 else None)
    assert ways["a", "b"].conflicts != ways["b", "a"].conflicts
    assert min(ways["a", "b"].conflicts, ways["b", "a"].missing, ways["a", "b"].common) > 20
    assert ways["a", "b"].farther > 0


def test_ground_is_counted_by_dives(made: tuple[Report, Path], maps: Maps) -> None:
    report, _ = made
    surfaces = {name: tops(one) for name, one in maps.items()}
    often = [list(surface) for surface in surfaces.values()]
    places, dives = np.unique(np.concatenate(often), axis=0, return_counts=True)
    coverage = report.coverage
    assert coverage.mapped_m2 == pytest.approx(len(places) * AREA_M2)
    assert coverage.merged_m2 == pytest.approx(len(places) * AREA_M2, rel=0.05)
    assert coverage.overlap_m2 == pytest.approx((dives > 1).sum() * AREA_M2)
    assert coverage.by_dives_m2 == {
        str(n): pytest.approx((dives == n).sum() * AREA_M2) for n in (1, 2)
    }
    single = {tuple(place) for place in places[dives == 1].tolist()}
    for record in report.dives:
        columns = {one[:2] for one in known(maps[record.name])}
        assert record.observed_m2 == pytest.approx(len(columns) * AREA_M2)
        assert record.mapped_m2 == pytest.approx(len(surfaces[record.name]) * AREA_M2)
        alone = surfaces[record.name].keys() & single
        assert record.alone_m2 == pytest.approx(len(alone) * AREA_M2)


def test_heights_differ_as_the_surfaces_do(made: tuple[Report, Path], maps: Maps) -> None:
    report, out = made
    a, b = tops(maps["a"]), tops(maps["b"])
    dz = {place: a[place] - b[place] for place in a.keys() & b.keys()}
    values = np.array(list(dz.values())) * RESOLUTION_M
    of_pair = report.pairs[0].dz
    expected = np.quantile(values, 0.5, method="inverted_cdf")
    assert of_pair.cells == len(dz)
    assert of_pair.median_m == pytest.approx(expected)
    assert expected < 0
    far = pytest.approx(np.quantile(abs(values), 0.95, method="inverted_cdf"))
    assert of_pair.p95_m == report.spread.p95_m == far
    with rasterio.open(out / "difference.tif") as grid:
        dives, spread = grid.read()
        assert (dives == 2).sum() == (spread != -9999).sum() == len(dz)
        rows, columns = np.nonzero(dives == 2)
        places = np.floor(np.array(grid.xy(rows, columns)).T / RESOLUTION_M).astype(int)
    reported = dict(zip(map(tuple, places.tolist()), spread[rows, columns].tolist(), strict=True))
    assert reported == {place: pytest.approx(abs(z) * RESOLUTION_M) for place, z in dz.items()}


def test_file_reports_the_same_and_pictures_are_there(made: tuple[Report, Path]) -> None:
    report, out = made
    data = (out / "report.json").read_bytes()
    assert msgspec.json.decode(data, type=Report) == report
    assert json.loads(data)["version"] == 1
    for name in PICTURES:
        with Image.open(out / name) as image:
            assert image.width > 500
            colours = image.convert("RGB").getcolors(1 << 24)
            assert colours is not None
            assert len(colours) > 20


@pytest.mark.usefixtures("undrawn")
def test_grades_are_those_of_the_published_analyser(
    made: tuple[Report, Path], files: dict[str, Path], tmp_path: Path
) -> None:
    near, far, _ = made[0].pairs
    shares = [way.only / way.voxels for way in (near.a_to_b, near.b_to_a)]
    assert near.mean_only_share == pytest.approx(sum(shares) / 2)
    assert near.published_grade == "poor"
    assert (far.mean_missing_share, far.grade, far.published_grade) == (None, None, "poor")
    same = report_survey(
        {"a": files["a"], "again": files["a"]}, files["a"], tmp_path, TOLERANCE_M
    ).pairs[0]
    assert (same.mean_only_share, same.published_grade, same.grade) == (0, "excellent", "excellent")
    assert same.a_to_b.p95_m == 0


@pytest.mark.usefixtures("undrawn")
def test_little_overlap_has_no_grade(tmp_path: Path) -> None:
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(50), np.arange(20)))
    floor = np.stack([x, y, np.full(len(x), -30)], axis=1)
    grades = []
    for step in (49, 45):  # 2 % and 10 % overlap
        moved = {"a": 0, "b": step}
        files = {
            name: store_of(tmp_path / f"{name}{step}.db", map_of(floor + np.array((by, 0, 0))))
            for name, by in moved.items()
        }
        (pair,) = report_survey(files, files["a"], tmp_path / "out", 0.05).pairs
        assert (pair.a_to_b.compared > 0, pair.mean_missing_share) == (True, 0)
        grades.append(pair.grade)
    assert grades == [None, "excellent"]


def test_pieces_of_any_size_give_the_same(
    files: dict[str, Path], made: tuple[Report, Path], tmp_path: Path, undrawn: pytest.MonkeyPatch
) -> None:
    undrawn.setattr("mapper_survey.difference.CUBE_BRICKS", 1)
    undrawn.setattr("mapper_survey.report.WINDOW_BRICKS", 1)
    sizes, part = [], WindowedMap.part

    def watched(self: WindowedMap, *box: Any) -> SonarMap:
        found = part(self, *box)
        sizes.append(found.core.block_count)
        return found

    undrawn.setattr(WindowedMap, "part", watched)
    progress: list[tuple[int, int]] = []
    assert reported(files, tmp_path, progress=lambda *at: progress.append(at)) == made[0]
    with WindowedMap(files["merged"]) as merged:
        assert max(sizes) < part(merged, (-9,) * 3, (9,) * 3).core.block_count / 2
    assert progress == [(number, len(progress)) for number in range(1, len(progress) + 1)]


def test_maps_that_cannot_be_compared_are_named(files: dict[str, Path], tmp_path: Path) -> None:
    coarse = SonarMap(Config(octree=OctreeConfig(voxel_resolution=0.2)))
    other = store_of(tmp_path / "coarse.db", coarse)
    for dives, tolerance_m, stated in (
        ({"x": other}, 0.2, r"x: its voxels are 0\.2 m, those of the merged map 0\.1 m"),
        ({}, 0.2, "no dives"),
        ({"a": files["a"]}, 0.0, "tolerance: 0 m"),
        ({"a": files["a"]}, 7.0, r"allowed: up to 6 m"),
    ):
        with pytest.raises(SurveyError, match=stated):
            report_survey(dives, files["merged"], tmp_path / "out", tolerance_m)
    with pytest.raises(StoreError, match=r"gone\.db"):
        report_survey({"x": tmp_path / "gone.db"}, files["merged"], tmp_path / "out", 0.2)


@pytest.mark.usefixtures("undrawn")
def test_thresholds_are_those_of_the_settings(files: dict[str, Path], tmp_path: Path) -> None:
    strict = Config(mapping=MappingConfig(occupied_threshold=0.97))
    report = reported(files, tmp_path, config=strict)
    assert report.occupied_threshold == 0.97
    with WindowedMap(files["a"], strict) as stored:
        expected = len(stored.part((-9,) * 3, (9,) * 3).voxels("occupied"))
    assert report.pairs[0].a_to_b.voxels == expected


@pytest.mark.usefixtures("undrawn")
def test_dive_that_has_no_surface_in_a_cell_does_not_spread_it(tmp_path: Path) -> None:
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(8), np.arange(8)))
    floor = np.stack([x, y, np.full(64, -30)], axis=1)
    moved = {"a": (0, 0, 0), "b": (0, 0, 2), "c": (20, 0, 0)}
    files = {
        name: store_of(tmp_path / f"{name}.db", map_of(floor + np.array(by)))
        for name, by in moved.items()
    }
    report = report_survey(files, files["a"], tmp_path / "out", TOLERANCE_M)
    assert report.spread.cells == 64
    assert report.spread.median_m == report.spread.p95_m == pytest.approx(0.2)
