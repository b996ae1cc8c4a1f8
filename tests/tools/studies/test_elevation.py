"""The study of elevation: its truth beside closed forms, its figures beside brute force."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from sonar_sim import MATERIALS, FramePose, Scene, Surface
from sonar_sim.scene.scene import Sea
from studies.accuracy_cost.mapping.metrics import Floor, Pile, Solid, SolidBox, Solids, surfaces
from studies.elevation import dives as dives_module
from studies.elevation import measures
from studies.elevation.dives import DIVES, Change, Dive, DiveData, SeenPoints, load, simulate
from studies.elevation.measures import (
    CURVE_LOG_ODDS,
    SWEPT,
    ChangeWatch,
    TrueGrid,
    log_loss,
    surface_points,
    sweep,
    true_grid,
    truth_of,
)
from studies.elevation.report import MAIN, Rows, calibrated, curve_from, interval, verdicts
from studies.elevation.run import Task, contender_config, map_dive, noisy_poses, run_task

from mapperd.config.tree import Config
from mapperd.errors import ConfigError
from mapperd.imaging.ping_image import PingImage
from mapperd.mapping.arc import SurfaceLevel
from mapperd.mapping.sonar_map import SonarMap

EDGE_M = 0.1
BOX = SolidBox((0.93, 0.02, -1.63), (0.52, 0.44, 0.86))
PILE = Pile((0.61, -0.57, -1.2), 0.17, 2.0)
FLOOR = Floor(2.03, swell_m=0.02, half_m=1.6)
LOW, HIGH = (-1.2, -1.2, -2.5), (1.4, 1.2, 0.4)


def triangles(*solids: Solid) -> np.ndarray:
    return np.concatenate([vertices[faces] for vertices, faces in (s.mesh() for s in solids)])


def grid_of(*solids: Solid) -> TrueGrid:
    dry_m = np.array([[-1.6, -1.6], [1.6, 1.6]])
    wet_m = np.array([[-0.9, 0.0, -1.0]])
    return true_grid(triangles(*solids), EDGE_M, np.array([LOW, HIGH]), dry_m, wet_m)


def centres(grid: TrueGrid) -> np.ndarray:
    index = np.stack(np.meshgrid(*map(np.arange, grid.solid.shape), indexing="ij"), axis=-1)
    return np.asarray((index.reshape(-1, 3) + grid.low + 0.5) * EDGE_M)


def test_samples_leave_no_gap_on_any_triangle() -> None:
    corners = np.array(
        [
            [[0, 0, 0], [1, 0, 0], [0.2, 0.7, 0]],
            [[0, 0, 1], [0, 0, 3], [0.01, 0, 2]],  # a sliver
            [[2, 2, 2], [2.01, 2, 2], [2, 2.01, 2]],  # smaller than a step
        ]
    )
    points = np.concatenate(list(surface_points(corners, 0.05)))
    rng = np.random.default_rng(1)
    weights = rng.dirichlet((1.0, 1.0, 1.0), 400)
    for corner in corners:
        on_it = weights @ corner
        gap = np.linalg.norm(on_it[:, None] - points, axis=2).min(axis=1)
        assert gap.max() <= 0.05
    flat = points[np.abs(points[:, 2]) < 1e-9]
    assert (flat[:, 1] >= -1e-12).all()  # none beside its triangle
    assert (flat @ [0.7, 0.8, 0.0] <= 0.7 + 1e-9).all()


def test_the_grid_is_as_the_closed_forms() -> None:
    grid, world = grid_of(FLOOR, BOX, PILE), Solids((FLOOR, BOX, PILE))
    at_m = centres(grid)
    distance_m = np.abs(world.distance_m(at_m))
    for solid in (FLOOR, BOX, PILE):  # a surface inside another solid is still one
        np.minimum(distance_m, np.abs(solid.distance_m(at_m)), out=distance_m)
    clear = (distance_m > 0.05) & (distance_m < 0.5)
    assert grid.distance_m(at_m)[clear] == pytest.approx(distance_m[clear], abs=6e-3)
    assert (grid.distance_m(at_m)[distance_m > 0.51] == 0.5).all()
    wall = grid_of(SolidBox((1.0, 0.0, -1.0), (0.4, 2.0, 1.0)))
    assert wall.distance_m(np.array([[0.55, 0.05, -1.05], [0.45, 0.05, -1.05]])) == pytest.approx(
        [0.25, 0.35], abs=1e-3
    )
    assert (grid.touched(at_m, EDGE_M) != world.touched(at_m, EDGE_M)).mean() < 2e-3


def test_the_inside_of_bodies_and_the_ground_are_solid() -> None:
    grid = grid_of(FLOOR, SolidBox((0.0, 0.5, -1.0), (0.9, 0.9, 0.9)))
    inside, under, water, beside = grid.touched(
        np.array([[0.0, 0.5, -1.0], [0.0, 0.0, -2.4], [0.0, -0.5, -1.0], [0.0, 0.0, 0.3]]), EDGE_M
    )
    assert (inside, under, water, beside) == (True, True, False, False)


def test_a_voxel_outside_of_the_grid_is_an_error() -> None:
    with pytest.raises(ValueError, match="outside"):
        grid_of(FLOOR).distance_m(np.array([[9.0, 0.0, 0.0]]))


def test_the_sweep_is_as_each_threshold_alone() -> None:
    rng = np.random.default_rng(3)
    grid = grid_of(FLOOR, BOX)
    at_m = centres(grid)
    chosen = at_m[grid.distance_m(at_m) < 0.4]
    chosen = chosen[rng.random(len(chosen)) < 0.3]
    log_odds = np.round(rng.normal(0.0, 3.0, len(chosen)), 3) + 0.0117
    seen_m = np.concatenate(list(surface_points(triangles(FLOOR, BOX), 0.1)))
    seen_m = seen_m[((seen_m > LOW) & (seen_m < np.array(HIGH))).all(axis=1)]
    found = sweep(grid, seen_m, chosen, log_odds)
    for k in (40, 120, 200):
        alone = surfaces(grid, seen_m, chosen[log_odds > SWEPT[k]], EDGE_M)
        assert (found.f_one[k], found.f_two[k]) == pytest.approx((alone.f_one, alone.f_two))
        assert found.false_share[k] == pytest.approx(alone.false_share)


def test_log_loss_by_hand() -> None:
    log_odds = np.log([0.8 / 0.2, 0.3 / 0.7])
    expected = -(math.log(0.8) + math.log(0.7)) / 2
    assert log_loss(log_odds, np.array([True, False])) == pytest.approx(expected)


def test_an_interval_by_hand() -> None:
    assert interval(np.array([1.0, 2.0, 3.0])) == pytest.approx(4.3027 / math.sqrt(3), abs=1e-4)
    assert math.isnan(interval(np.array([1.0])))


def test_noisy_poses_stay_rigid() -> None:
    poses = np.tile(np.eye(4), (2000, 1, 1))
    noisy = noisy_poses(poses, 1, 0.05, 0.5)
    rotations = noisy[:, :3, :3]
    assert np.allclose(rotations @ rotations.transpose(0, 2, 1), np.eye(3), atol=1e-12)
    turn_deg = np.degrees(rotations[:, 1, 0])
    assert noisy[:, :3, 3].std(axis=0) == pytest.approx([0.05] * 3, rel=0.1)
    assert turn_deg.std() == pytest.approx(0.5, rel=0.1)
    assert (noisy == noisy_poses(poses, 1, 0.05, 0.5)).all()
    assert (noisy != noisy_poses(poses, 2, 0.05, 0.5)).any()


def test_seen_points_are_kept_once_with_their_first_ping() -> None:
    seen = SeenPoints()
    seen.add(0, np.array([[0.001, 0.0, 0.0], [0.002, 0.0, 0.0]]))
    seen.add(4, np.array([[0.003, 0.0, 0.0], [0.1, 0.0, 0.0]]))
    assert seen.pings.tolist() == [0, 4]
    assert seen.points_m[:, 0].tolist() == [0.001, 0.1]


def scene_of(*solids: Solid, sea: Sea | None = None) -> Callable[[], Scene]:
    parts = [
        Surface(f"{i}", *solid.mesh(), MATERIALS["overgrown_concrete"])
        for i, solid in enumerate(solids)
    ]
    return lambda: Scene(tuple(parts), sea=sea)


def look_ahead(count: int) -> Callable[[np.random.Generator], list[FramePose]]:
    return lambda _: [FramePose(np.array([-0.5, 0.0, -1.5]), np.eye(3))] * count


SMALL = Dive("small", "small", scene_of(FLOOR, BOX), look_ahead(4), 2.0, 50.0)
CHANGING = replace(
    SMALL, name="changes", change=Change(1, BOX, PILE, scene_of(FLOOR, PILE, sea=Sea()))
)


@pytest.fixture(autouse=True)
def _small_truth(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measures, "MARGIN_M", 1.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the truth of the dives is kept."""
    return tmp_path_factory.mktemp("elevation")


def still(dive: Dive, monkeypatch: pytest.MonkeyPatch) -> Dive:
    """A dive whose path no seed moves."""
    monkeypatch.setattr(dives_module, "JITTER_M", 0.0)
    monkeypatch.setattr(dives_module, "JITTER_DEG", 0.0)
    return dive


def facing(solid: Solid) -> np.ndarray:
    """Points on the solid above the floor, of the side that the sonar faces."""
    points = np.concatenate(list(surface_points(triangles(solid), 0.02)))
    in_front = points[:, 0] < points[:, 0].min() + 0.1
    return np.asarray(points[in_front & (np.abs(points[:, 2] + 1.5) < 0.2)])


def data_of(dive: Dive, parts: list[tuple[int, np.ndarray]]) -> DiveData:
    poses = dive.poses(0)
    image = np.zeros((len(poses), 100, 64), dtype=np.uint8)
    image[:, 70:74] = 120
    return DiveData(
        image,
        np.radians(np.linspace(-65.0, 65.0, 64)),
        0.02,
        poses,
        np.concatenate([points for _, points in parts]),
        np.concatenate([np.full(len(points), k, dtype=np.uint16) for k, points in parts]),
        50.0,
        255,
    )


def test_the_truth_of_a_dive_is_kept_and_its_air_is_no_water(folder: Path) -> None:
    truth = truth_of(CHANGING, EDGE_M, folder)
    before = truth_of(CHANGING, EDGE_M, folder, changed=False)
    assert truth.solid.shape == before.solid.shape
    box, pile, air = np.array([[0.93, 0.02, -1.63], [0.61, -0.57, -1.2], [0.0, 0.0, 0.15]])
    assert truth.touched(np.stack([box, pile, air]), EDGE_M).tolist() == [False, True, True]
    assert before.touched(np.stack([box, pile, air]), EDGE_M).tolist() == [True, False, False]
    again = truth_of(CHANGING, EDGE_M, folder)
    assert (again.solid == truth.solid).all()
    assert (again.distance == truth.distance).all()


def test_what_changes_is_counted_in_pings_that_see_it(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dive = still(CHANGING, monkeypatch)
    monkeypatch.setattr(measures, "FREED_PINGS", 1)
    data = data_of(dive, [(0, facing(BOX)), (1, facing(PILE))])
    data.map_T_sonar[1, :3, :3] = np.diag([-1.0, -1.0, 1.0])  # one ping looks away
    watch = ChangeWatch(dive, data, EDGE_M, folder)
    assert len(watch.staying_m) == len(facing(PILE))
    at_m = centres(truth := truth_of(dive, EDGE_M, folder))
    freed = at_m[truth_of(dive, EDGE_M, folder, changed=False).solid.ravel() & ~truth.solid.ravel()]
    pile = at_m[truth.solid.ravel() & (np.abs(PILE.distance_m(at_m)) < 0.1)]
    for ping, occupied in enumerate((freed, freed, freed[::2], pile)):
        fake = SimpleNamespace(occupied=lambda o=occupied: SimpleNamespace(centres_m=o))
        watch(ping, cast("SonarMap", fake))
    found = watch.figures()
    assert (found["gone_pings"], found["gone_share"], found["removed_before"]) == (2.0, 0.0, 1.0)
    assert (found["shown_pings"], found["shown_share"]) == (2.0, 1.0)


def test_settings_go_by_dotted_names() -> None:
    config = contender_config({"mapping.occupied_threshold": 0.8}, 0.05)
    assert isinstance(config, Config)
    assert (config.mapping.occupied_threshold, config.octree.voxel_resolution) == (0.8, 0.05)
    with pytest.raises(ConfigError):
        contender_config({"mapping.no_such_setting": 1}, 0.05)


def floor_image(level: float, noise: float = 1.0) -> PingImage:
    """A surface of one level at 3 m in all beams, 0.2 m deep, over noise."""
    intensity = np.full((250, 64), noise, dtype=np.float32)
    intensity[150:160] = level
    return PingImage(intensity, np.arcsin(np.linspace(-0.5, 0.5, 64)), 0.02)


def test_the_level_of_surfaces_is_that_of_first_returns() -> None:
    surface = SurfaceLevel(0.1)
    default, noise = surface.level, np.ones(250, dtype=np.float32)
    surface.add(floor_image(4.0), noise)
    assert surface.level == default  # nothing stands out of the noise
    for level in (20.0, 20.0, 250.0, 250.0):
        surface.add(floor_image(level), noise)
    assert surface.level == pytest.approx(1.3 * 20.0)
    for _ in range(12):
        surface.add(floor_image(40.0), noise)
    assert surface.level == pytest.approx(1.3 * 40.0)


def test_the_arc_rule_finds_a_wall_by_its_level_and_by_its_looks() -> None:
    arc_map = SonarMap(contender_config({"mapping.rule": "arc", "arc.level": 40.0}, 0.1))
    for pitch in np.radians((-10.0, 0.0, 10.0)):
        pose = np.eye(4)
        pose[:3, :3] = [
            [np.cos(pitch), 0, np.sin(pitch)],
            [0, 1, 0],
            [-np.sin(pitch), 0, np.cos(pitch)],
        ]
        # A small thing on the horizon, 10 degrees off the axis: 0.66 of its level is left.
        arc_map.integrate(floor_image(40.0 if pitch == 0 else 26.0), pose)
    log_odds, _ = arc_map.core.query(
        np.array([[3.05, 0.0, 0.05], [2.95, 0.0, 0.75], [1.5, 0.0, 0.05]])
    )
    assert log_odds[0] > log_odds[1] + 0.3 > log_odds[2] + 1.0
    assert len(arc_map.occupied().centres_m) > 10


def save(data: DiveData, path: Path) -> None:
    names = ("images", "bearings_rad", "range_resolution_m", "map_T_sonar", "seen_m", "seen_ping")
    values = {name: getattr(data, name) for name in (*names, "gain_percent", "gamma_byte")}
    np.savez(path, **values)


def test_rows_are_measured_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(DIVES, "small", still(SMALL, monkeypatch))
    save(data_of(SMALL, [(0, facing(BOX))]), tmp_path / "small-1.npz")
    task = Task("small", 1, {"other": {"iwlo.L_occ": 1.0}}, EDGE_M, noise=False, folder=tmp_path)
    assert run_task(task) == ["iwlo", "other"]
    assert run_task(task) == []
    changed = replace(task, contenders={"other": {"iwlo.L_occ": 1.5}})
    assert run_task(changed) == ["other"]
    refined = replace(task, contenders={"arc": {"mapping.rule": "arc"}})
    assert run_task(refined) == ["arc"]
    refined = replace(task, contenders={"arc": {"mapping.rule": "arc", "refine": True}})
    assert run_task(refined) == ["arc"]
    mapped = map_dive(load(SMALL, 1, tmp_path), contender_config({}, EDGE_M))
    assert len(mapped.cpu_ms) == 4
    assert len(mapped.map.occupied().centres_m)


def row(contender: str, dive: str, seed: int, **figures: Any) -> dict[str, Any]:
    given = {"f_one": 0.4, "f_two": 0.6, "false_share": 0.3, "roc_area": 0.9, "log_loss": 0.6}
    given |= {"calibration_worst": 0.3, "cpu_ms": 10.0}
    given |= {"log_loss_calibrated": 0.2, "calibrated_worst": 0.02} | figures
    return {
        "contender": contender,
        "dive": dive,
        "seed": seed,
        "edge_m": MAIN[0],
        "poses": MAIN[1],
    } | given


def test_verdicts_by_hand() -> None:
    rows = [row("iwlo", dive, seed) for dive in ("harbour", "roll") for seed in (1, 2)]
    good = {"f_one": 0.56, "false_share": 0.1, "log_loss": 0.2, "calibration_worst": 0.05}
    good |= {"log_loss_calibrated": 0.4, "calibrated_worst": 0.01}
    rows += [row("arc", "roll", seed, **good) for seed in (1, 2)]
    rows += [row("arc", "harbour", 1, f_two=0.57, log_loss=0.2)]
    found = {verdict.line: verdict for verdict in verdicts(Rows(rows, MAIN), "arc")}
    kept = {line: verdict.kept for line, verdict in found.items()}
    assert kept == {
        "F1 over all dives at the defaults ≥ 1.2 times": True,
        "F1 on varied dives ≥ 1.3 times": True,
        "share over 0.25 m on varied dives ≤ 0.5 times": True,
        "log-loss on every dive ≤ 0.5 times": True,
        "ms a ping on every dive ≤ 3 times": True,
        "log-loss, calibrated on every dive ≤ 0.5 times": False,
        "worst bin ≤ 0.1 on 80% of the dives": False,
        "worst bin, calibrated ≤ 0.1 on 80% of the dives": True,
        "F1 lost on any dive ≤ 0.02": True,
        "F2 lost on any dive ≤ 0.02": False,
        "ROC lost on any dive ≤ 0.02": True,
        "removed object gone within 15 pings": None,
        "new one shown within 15 pings": None,
    }
    assert found["F1 over all dives at the defaults ≥ 1.2 times"].found == "1.20"
    assert found["F2 lost on any dive ≤ 0.02"].found == "+0.030 (harbour)"


def with_curve(contender: str, dive: str, bins: dict[float, tuple[int, int]]) -> dict[str, Any]:
    """A row whose map has so many voxels, and solid ones, at these log-odds."""
    voxels, solids = np.zeros((2, len(CURVE_LOG_ODDS) - 1), dtype=int)
    for log_odds, numbers in bins.items():
        at = int(np.searchsorted(CURVE_LOG_ODDS, log_odds)) - 1
        voxels[at], solids[at] = numbers
    lists = {"curve_voxels": voxels.tolist(), "curve_solid": solids.tolist()}
    return row(contender, dive, 1, **lists)


def test_probabilities_are_calibrated_by_the_other_dives() -> None:
    rows = [
        with_curve("arc", "harbour", {-2.1: (1000, 100), 0.1: (1000, 300)}),
        with_curve("arc", "roll", {-2.1: (500, 200), 0.1: (500, 400)}),
        with_curve("iwlo", "harbour", {0.1: (1000, 900)}),
    ]
    harbour, roll, iwlo = calibrated(rows)
    p, q = 0.4, 0.8  # of roll
    loss = -(100 * math.log(p) + 900 * math.log(1 - p) + 300 * math.log(q) + 700 * math.log(1 - q))
    assert harbour["log_loss_calibrated"] == pytest.approx(loss / 2000, rel=1e-3)
    assert harbour["calibrated_worst"] == pytest.approx(0.5, abs=1e-3)
    assert roll["calibrated_worst"] == pytest.approx(0.5, abs=1e-3)
    assert iwlo["log_loss_calibrated"] is None
    curve = curve_from(rows[:2])  # either dive weighs the same
    assert curve is not None
    shares = 1 / (1 + np.exp(-curve.log_odds_of(np.array([-9.0, -2.1, 0.1, 9.0]))))
    assert shares == pytest.approx(
        [0.25, 0.25, 0.55, 0.55], abs=1e-3
    )  # either dive weighs the same


@pytest.mark.slow
def test_a_dive_is_simulated_once_and_its_seed_counts(tmp_path: Path) -> None:
    for seed in (1, 2):
        simulate(SMALL, seed, tmp_path)
    one, two = load(SMALL, 1, tmp_path), load(SMALL, 2, tmp_path)
    assert one.images.shape[::2] == (4, 512)
    assert (one.images != two.images).any()
    assert (one.map_T_sonar != two.map_T_sonar).any()
    off_m = np.abs(Solids((FLOOR, BOX)).distance_m(one.seen_m))
    assert off_m.max() < 0.01
    at = (tmp_path / "small-1.npz").stat().st_mtime_ns
    simulate(SMALL, 1, tmp_path)
    assert (tmp_path / "small-1.npz").stat().st_mtime_ns == at
