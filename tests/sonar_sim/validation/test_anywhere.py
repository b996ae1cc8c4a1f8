"""The validation cases hold wherever the sonar and the targets are, for both counts of beams.

Each seed draws a sonar, its setting, its pose in the map, and what it looks at.
"""

import dataclasses
import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from sonar_sim.engine import PingEngine
from sonar_sim.geometry.pose import FramePose, SonarMotion
from sonar_sim.propagation.beam_pattern import azimuth_amplitude, vertical_two_way_power
from sonar_sim.propagation.physics import Mirror, Physics
from sonar_sim.raycast.fan import ALL_ELEVATIONS_RAD
from sonar_sim.receiver.beamformer import beam_sines
from sonar_sim.scene.scene import PointTarget, Scene, Surface
from sonar_sim.scene.sonar import SonarSettings, sonar_preset
from sonar_sim.validation.setups import (
    CHALK,
    DULL,
    MEAN,
    Homogeneous,
    cell_power,
    floor,
    rectangle,
    sphere,
)
from sonar_sim.validation.statistics import correlation, speckle
from sonar_sim.validation.tank import (
    PLATE_M,
    ROD_LENGTH_M,
    ROD_RADIUS_M,
    TANK_DEPTH_M,
    TANK_RADIUS_M,
    TARGET_X_M,
    tank_scene,
)

MODELS = (
    ("M370s", 1),
    ("M750d", 1),
    ("M750d", 2),
    ("M1200d", 1),
    ("M1200d", 2),
    ("M3000d", 1),
    ("M3000d", 2),
)
ALL_AROUND = dataclasses.replace(MEAN, elevations_rad=ALL_ELEVATIONS_RAD)


def sonar_of(rng: np.random.Generator, range_m: float, rows: int) -> SonarSettings:
    """Any sonar that hears so far, with either count of beams."""
    whole = [sonar_preset(model, mode) for model, mode in MODELS]
    far = [sonar for sonar in whole if sonar.max_range_m >= range_m]
    return dataclasses.replace(
        far[rng.integers(len(far))],
        beams=int(rng.choice([256, 512])),
        demanded_range_m=range_m,
        forced_rows=rows,
    )


def pose_of(rng: np.random.Generator) -> FramePose:
    """Anywhere, turned by anything."""
    return FramePose(rng.uniform(-50.0, 50.0, 3), Rotation.random(random_state=rng).as_matrix())


def at(pose: FramePose, bearing: float, elevation: float, range_m: float) -> NDArray[np.float64]:
    """A point in the map; the bearing is positive to starboard."""
    flat = math.cos(elevation)
    away = (flat * math.cos(bearing), -flat * math.sin(bearing), math.sin(elevation))
    place: NDArray[np.float64] = pose.position_m + pose.rotation @ (range_m * np.array(away))
    return place


def placed(surface: Surface, pose: FramePose) -> Surface:
    """A surface of the sonar's frame in the map."""
    return dataclasses.replace(
        surface, vertices_m=surface.vertices_m @ pose.rotation.T + pose.position_m
    )


def point_picture(
    point_m: NDArray[np.float64], pose: FramePose, sonar: SonarSettings, physics: Physics
) -> NDArray[np.float32]:
    scene = Scene(targets=(PointTarget("point", tuple(point_m.tolist()), 0.0),))
    return PingEngine(scene, sonar, elevations=1).ping(pose, physics).amplitude


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("patterned", [False, True])
def test_a_floor_has_its_level_in_every_cell(seed: int, *, patterned: bool) -> None:
    """V2, V3: against a sum over a million directions, however the sonar lies over the floor."""
    rng = np.random.default_rng(seed)
    sonar = sonar_of(rng, rng.uniform(3.0, 20.0), 160)
    height_m = rng.uniform(0.1, 0.9) * sonar.range_m
    turned = Rotation.from_euler("ZYX", rng.uniform([-180, 0, -180], [180, 90, 180]), degrees=True)
    pose = FramePose(np.array([*rng.uniform(-9.0, 9.0, 2), height_m]), turned.as_matrix())
    width_rad = sonar.vertical_width_rad if patterned else None
    physics = dataclasses.replace(ALL_AROUND, vertical_width_rad=width_rad)
    got = cell_power(PingEngine(Scene((floor(),)), sonar), pose, physics)
    edge = (sonar.beams / 2.0) * sonar.sine_pitch
    s, w = np.meshgrid(np.linspace(-edge, edge, 1025)[:-1] + edge / 1024, np.linspace(-1, 1, 4001))
    inside = 1.0 - s**2 - w**2 > 0.0
    s, w = s[inside], w[inside]
    ahead = np.sqrt(1.0 - s**2 - w**2)
    falling = -(np.stack([ahead, -s, w], axis=1) @ pose.rotation[2])
    range_m = height_m / np.maximum(falling, 1e-9)
    power = DULL.mu * np.maximum(falling, 0.0) / range_m**2 / ahead * (2 * edge / 1024) * (2 / 4000)
    if patterned:
        power *= vertical_two_way_power(w, sonar.vertical_width_rad)
    # Blocks of 8 rows and an eighth of the fan.
    row = np.minimum(range_m / sonar.range_resolution_m, 1e6).astype(np.int64) // 8
    sector = np.clip(((s + edge) / (2 * edge) * 8).astype(np.int64), 0, 7)
    seen = row < 20
    expected = np.bincount(row[seen] * 8 + sector[seen], power[seen], 160).reshape(20, 8)
    blocks = got.reshape(20, 8, 8, -1).sum(axis=(1, 3))
    loud = expected > 1e-3 * expected.max()
    off_db = 10.0 * np.log10(blocks[loud] / expected[loud])
    assert np.abs(off_db).max() < 0.8
    assert abs(10.0 * math.log10(blocks.sum() / expected.sum())) < 0.1


@pytest.mark.parametrize("seed", range(10))
def test_a_dull_plate_has_its_cross_section_wherever_it_stands(seed: int) -> None:
    """V5: the sum of mu cos² i dA / R⁴ over the plate."""
    rng = np.random.default_rng(100 + seed)
    sonar = sonar_of(rng, 8.0, 400)
    pose = pose_of(rng)
    bearing = rng.uniform(-0.55, 0.55) * sonar.half_aperture_rad
    middle = at(pose, bearing, rng.uniform(-0.35, 0.35), rng.uniform(2.0, 6.0))
    to_sonar = (pose.position_m - middle) / np.linalg.norm(pose.position_m - middle)
    lean = Rotation.from_rotvec(rng.uniform(-0.6, 0.6, 3)).apply(to_sonar)
    u = np.cross(lean, [0.36, 0.48, 0.8])
    u *= 0.5 / np.linalg.norm(u)
    v = np.cross(lean, u)
    plate = rectangle(tuple(middle), tuple(u), tuple(v), DULL, cuts=int(rng.integers(1, 5)))
    power = cell_power(PingEngine(Scene((plate,)), sonar), pose, MEAN)
    a, b = ((np.arange(200) + 0.5) / 200.0 - 0.5 for _ in range(2))
    points = middle + a[:, None, None] * u + b[None, :, None] * v - pose.position_m
    range_m = np.linalg.norm(points, axis=2)
    cosine = np.abs(points @ lean) / range_m
    expected = float(np.sum(DULL.mu * cosine**2 / range_m**4)) * 0.25 / 200.0**2
    assert 10.0 * math.log10(power.sum() / expected) == pytest.approx(0.0, abs=0.3)


@pytest.mark.parametrize("seed", range(6))
def test_a_dull_ball_has_its_strength_wherever_it_hangs(seed: int) -> None:
    """V4: 10 log(2 pi mu a² / 3), of balls that many rays meet."""
    rng = np.random.default_rng(200 + seed)
    sonar = sonar_of(rng, 8.0, 400)
    pose, radius_m, range_m = pose_of(rng), rng.uniform(0.15, 0.3), rng.uniform(3.0, 5.0)
    bearing = rng.uniform(-0.85, 0.85) * sonar.half_aperture_rad
    middle = at(pose, bearing, rng.uniform(-0.25, 0.25), range_m)
    engine = PingEngine(Scene((sphere(tuple(middle), radius_m, CHALK),)), sonar)
    power = cell_power(engine, pose, MEAN)
    strength = float((power.sum(axis=1) * sonar.row_centres_m**4).sum())
    # Not from afar: the visible cap is smaller by (1 - a / R)² (1 + a / (2 R)), to first order.
    points = Rotation.random(40000, random_state=rng).apply([1.0, 0.0, 0.0])
    way = middle + radius_m * points - pose.position_m
    away_m = np.linalg.norm(way, axis=1)
    cosine = np.maximum(-np.einsum("ij,ij->i", way, points) / away_m, 0.0)
    expected = CHALK.mu * np.mean(cosine**2) * 4.0 * math.pi * radius_m**2
    assert 10.0 * math.log10(strength / expected) == pytest.approx(0.0, abs=0.4)


@pytest.mark.parametrize("seed", range(12))
def test_a_target_reproduces_the_pattern_wherever_it_lies_between_beams(seed: int) -> None:
    """V6, V12: main and side lobes about the bearing of its cone."""
    rng = np.random.default_rng(300 + seed)
    sonar = sonar_of(rng, 6.0, 300)
    pose, range_m = pose_of(rng), rng.uniform(1.0, 5.5)
    bearing = rng.uniform(-0.9, 0.9) * sonar.half_aperture_rad
    elevation = rng.uniform(-0.3, 0.3)
    physics = dataclasses.replace(
        MEAN, speckle=True, beam_width_rad=sonar.beam_width_rad, side_lobe_db=sonar.side_lobe_db
    )
    heard = point_picture(at(pose, bearing, elevation, range_m), pose, sonar, physics)
    row = int(range_m / sonar.range_resolution_m)
    assert heard.argmax() // sonar.beams == row
    cone = math.sin(bearing) * math.cos(elevation)
    beams = np.linspace(-1.0, 1.0, sonar.beams) * math.sin(sonar.half_aperture_rad)
    designed = np.abs(azimuth_amplitude(sonar.beam_width_rad, sonar.side_lobe_db)(beams - cone))
    scale = 10.0 ** ((sonar.source_level_db - 210.0) / 20.0) / range_m**2
    loud = designed > 10.0 ** (-30.0 / 20.0)
    off_db = np.abs(20.0 * np.log10(heard[row][loud] / (scale * designed[loud])))
    # Columns as far apart as beams hold a narrow beam less well between two of them.
    sampled = math.sin(sonar.beam_width_rad / 2.0) / sonar.sine_pitch
    assert off_db.max() < (0.35 if sampled > 1.0 else 1.5)
    assert off_db[designed[loud] > 0.3].max() < (0.1 if sampled > 1.0 else 0.75)


@pytest.mark.parametrize("seed", range(8))
def test_ghosts_of_any_mirror_lie_where_its_image_does(seed: int) -> None:
    """V10: levels and ranges behind a plane that leans in any direction."""
    rng = np.random.default_rng(400 + seed)
    sonar = dataclasses.replace(sonar_of(rng, 30.0, 3000), half_aperture_rad=math.radians(65.0))
    pose = pose_of(rng)
    point = at(pose, rng.uniform(-0.3, 0.3), rng.uniform(-0.3, 0.3), rng.uniform(4.0, 10.0))
    up = np.array([rng.uniform(-0.1, 0.1), rng.uniform(-0.02, 0.02), -1.0])
    normal = pose.rotation @ (up / np.linalg.norm(up))
    plane_m = pose.position_m - rng.uniform(1.0, 4.0) * normal
    height = (point - plane_m) @ normal
    if height < 0.3:
        point = point + (0.5 - height) * normal
    mirror = Mirror(plane_m, normal, -0.8)
    physics = dataclasses.replace(MEAN, speckle=True, mirrors=(mirror,))
    heard = point_picture(point, pose, sonar, physics)
    direct_m = float(np.linalg.norm(point - pose.position_m))
    image_m = point - 2.0 * ((point - plane_m) @ normal) * normal
    bounced_m = float(np.linalg.norm(image_m - pose.position_m))
    by_row = np.sqrt(np.square(heard).sum(axis=1))
    level = {}
    for name, range_m in (("d", direct_m), ("a", (direct_m + bounced_m) / 2.0), ("b", bounced_m)):
        row = int(range_m / sonar.range_resolution_m)
        level[name] = by_row[row - 1 : row + 2].max()
        assert level[name] > 0.0
    twice_db = 20.0 * math.log10(0.64 * direct_m**2 / bounced_m**2)
    assert 20.0 * math.log10(level["b"] / level["d"]) == pytest.approx(twice_db, abs=0.6)


@pytest.mark.parametrize("seed", range(6))
def test_shadows_end_where_similar_triangles_say(seed: int) -> None:
    """V11: from the wall's foot to x hs / (hs - H)."""
    rng = np.random.default_rng(500 + seed)
    sonar_m, wall_m, away_m = rng.uniform(2.0, 4.0), rng.uniform(0.3, 0.9), rng.uniform(5.0, 10.0)
    end_m = away_m * sonar_m / (sonar_m - wall_m)
    sonar = dataclasses.replace(sonar_of(rng, 20.0, 1000), half_aperture_rad=math.radians(10.0))
    wall = rectangle((away_m, 0.0, wall_m / 2.0), (0.0, 60.0, 0.0), (0.0, 0.0, wall_m))
    place = FramePose(np.array([0.0, rng.uniform(-9.0, 9.0), sonar_m]), np.eye(3))
    power = cell_power(PingEngine(Scene((floor(), wall)), sonar), place, MEAN)
    middle = power[:, sonar.beams // 2 - 1 : sonar.beams // 2 + 1].mean(axis=1)
    foot, last = math.hypot(away_m, sonar_m), math.hypot(end_m, sonar_m)
    dark = (sonar.row_centres_m > foot + 0.05) & (sonar.row_centres_m < last - 0.1)
    lit = (sonar.row_centres_m > last + 0.1) & (sonar.row_centres_m < last + 0.5)
    assert middle[dark].max(initial=0.0) == 0.0
    assert middle[lit].min() > 0.0


@pytest.mark.parametrize("seed", range(8))
def test_nothing_beyond_the_range_is_heard(seed: int) -> None:
    """V17."""
    rng = np.random.default_rng(600 + seed)
    sonar, pose = sonar_of(rng, rng.uniform(1.0, 9.0), 120), pose_of(rng)
    far = at(
        pose, rng.uniform(-1.0, 1.0), rng.uniform(-0.5, 0.5), sonar.range_m * rng.uniform(1, 9)
    )
    physics = dataclasses.replace(MEAN, speckle=True, beam_width_rad=sonar.beam_width_rad)
    assert not point_picture(far, pose, sonar, physics).any()


@pytest.mark.parametrize("seed", range(8))
def test_closing_targets_are_early_by_their_way(seed: int) -> None:
    """V16: what the sonar travels until the echo is back shortens the range by v R / c."""
    rng = np.random.default_rng(700 + seed)
    sonar = dataclasses.replace(sonar_of(rng, 40.0, 8000), vertical_width_rad=math.radians(20.0))
    pose, range_m, speed = pose_of(rng), rng.uniform(10.0, 39.0), rng.uniform(-2.0, 2.0)
    point = at(pose, 0.0, 0.0, range_m)
    motion = SonarMotion(speed * pose.rotation[:, 0], np.zeros(3))
    physics = dataclasses.replace(MEAN, speckle=True, pose_blocks=16)
    scene = Scene(targets=(PointTarget("point", tuple(point.tolist()), 0.0),))
    ping = PingEngine(scene, sonar, elevations=1).ping(pose, physics, motion=motion)
    row = int(ping.amplitude.max(axis=1).argmax())
    early_m = speed * range_m / scene.water.speed_of_sound_mps
    seen_m = (row + 0.5) * sonar.range_resolution_m
    assert seen_m == pytest.approx(range_m - early_m, abs=0.75 * sonar.range_resolution_m)


def surfaces_alone(sonar: SonarSettings, **changes: object) -> Physics:
    """Speckle of surfaces as the beams hear it, without noise or gain."""
    physics = dataclasses.replace(
        MEAN,
        specular=False,
        speckle=True,
        vertical_width_rad=sonar.vertical_width_rad,
        beam_width_rad=sonar.beam_width_rad,
        side_lobe_db=sonar.side_lobe_db,
        range_spread=True,
    )
    return dataclasses.replace(physics, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", range(6))
def test_a_floor_s_speckle_is_rayleigh_s_and_rows_share_theirs_as_recorded(seed: int) -> None:
    """V7, V9: seen by any sonar, from any height and heading."""
    rng = np.random.default_rng(800 + seed)
    sonar = sonar_of(rng, rng.uniform(4.0, 5.0), 400)
    engine = PingEngine(Scene((floor(),)), sonar, seed=seed)
    height_m, heading = rng.uniform(0.1, 0.2) * sonar.range_m, rng.uniform(-180.0, 180.0)
    turn = Rotation.from_euler("ZY", [heading, rng.uniform(0.0, 10.0)], degrees=True).as_matrix()
    places = rng.uniform(-90.0, 90.0, (4, 2))
    poses = [FramePose(np.array([*place, height_m]), turn) for place in places]
    power = engine.ping(poses[0], surfaces_alone(sonar, speckle=False)).amplitude
    edge, near = sonar.beams // 8, int(0.6 * 400)
    pings = [engine.ping(pose, surfaces_alone(sonar)).amplitude for pose in poses]
    heard = np.stack(pings)[:, near:, edge:-edge] / power[near:, edge:-edge].astype(np.float64)
    # Cells that share next to no speckle.
    apart = math.ceil(2.2 * sonar.beam_width_rad / sonar.sine_pitch)
    found = speckle(heard[:, ::3, ::apart])
    cells = heard[:, ::3, ::apart].size
    assert found.cv == pytest.approx(0.5227, abs=0.005 + 1.5 / math.sqrt(cells))
    assert found.rayleigh_distance < 0.01 + 0.8 / math.sqrt(cells)
    assert np.mean(np.square(heard)) == pytest.approx(1.0, abs=0.02 + 3.0 / math.sqrt(cells))
    lags = [correlation(heard[:, lag:], heard[:, :-lag]) for lag in (1, 2)]
    assert lags[0] == pytest.approx(0.19, abs=0.02 + 2.0 / math.sqrt(cells))
    assert abs(lags[1]) < 0.05 + 2.0 / math.sqrt(cells)


@pytest.mark.parametrize("seed", range(8))
def test_pings_from_one_place_are_alike_by_the_noise_between_them(seed: int) -> None:
    """V8: (S / (S + N))², for any sonar and any ratio of signal to noise."""
    rng = np.random.default_rng(900 + seed)
    sonar = sonar_of(rng, 4.0, 400)
    ratio_db = rng.uniform(-8.0, 18.0)
    sheet = Homogeneous(sonar, 102400 // sonar.beams, seed=seed)
    one, other = (np.square(np.abs(sheet.beams(ping, 0.0, -ratio_db))) for ping in (1, 2))
    ratio = 10.0 ** (ratio_db / 10.0)
    assert correlation(one, other) == pytest.approx((ratio / (1.0 + ratio)) ** 2, abs=0.04)


@pytest.mark.parametrize("beams", [256, 512])
@pytest.mark.parametrize("model", MODELS, ids=lambda model: f"{model[0]}-{model[1]}")
def test_a_target_on_a_beam_s_bearing_is_heard_by_that_beam(
    model: tuple[str, int], beams: int
) -> None:
    """V13: beam b lies at asin(sin(half aperture) (2 b / (N - 1) - 1)), on every model."""
    sonar = dataclasses.replace(
        sonar_preset(*model), beams=beams, demanded_range_m=4.0, forced_rows=100
    )
    sines = beam_sines(sonar, Physics(sine_bearings=True))
    half_deg = math.degrees(sonar.half_aperture_rad)
    steps = np.linspace(-1.0, 1.0, beams) * math.sin(sonar.half_aperture_rad)
    tabled_deg = np.degrees(np.arcsin(sines))
    assert tabled_deg == pytest.approx(np.degrees(np.arcsin(steps)), abs=0.01)
    assert tabled_deg[[0, -1]] == pytest.approx([-half_deg, half_deg], abs=0.01)
    rng = np.random.default_rng(beams)
    pose = pose_of(rng)
    for beam in (0, beams - 1, *rng.integers(1, beams - 1, 4)):
        point = at(pose, float(np.arcsin(steps[beam])), 0.0, 3.0)
        heard = point_picture(point, pose, sonar, surfaces_alone(sonar))
        assert heard.max(axis=0).argmax() == beam


@pytest.mark.parametrize("seed", range(8))
def test_the_tank_s_wall_and_targets_lie_and_end_where_they_do(seed: int) -> None:
    """V20: from places in the tank's other half, with the target in the fan."""
    rng = np.random.default_rng(1000 + seed)
    bands = [("M750d", 2), ("M1200d", 1), ("M1200d", 2)]
    model = bands[rng.integers(len(bands))]
    sonar = sonar_preset(*model, demanded_range_m=4.4, beams=int(rng.choice([256, 512])))
    target = np.array([TARGET_X_M, 0.0])
    place = np.array([rng.uniform(-1.4, -0.6), rng.uniform(-0.5, 0.5)])
    away_m, toward = float(np.linalg.norm(target - place)), math.atan2(*(target - place)[::-1])
    heading = toward + rng.uniform(-0.3, 0.3) * sonar.half_aperture_rad
    turn = Rotation.from_euler("Z", heading).as_matrix()
    pose = FramePose(np.array([*place, -TANK_DEPTH_M / 2.0]), turn)
    physics = surfaces_alone(sonar, speckle=False, range_spread=False, side_lobe_db=None)
    quiet = PingEngine(tank_scene("background"), sonar).ping(pose, physics).amplitude
    row_m, rows_m = sonar.range_resolution_m, sonar.row_centres_m
    bearings = np.arcsin(beam_sines(sonar, physics))
    beside = np.flatnonzero(np.abs(bearings - (heading - toward)) > 4.0 * sonar.beam_width_rad)
    for beam in rng.choice(beside, 3):
        ray = np.array([math.cos(heading - bearings[beam]), math.sin(heading - bearings[beam])])
        along = float(place @ ray)
        wall_m = -along + math.sqrt(along**2 + TANK_RADIUS_M**2 - float(place @ place))
        near = np.abs(rows_m - wall_m) < 0.15
        loudest_m = rows_m[near][quiet[near, beam].argmax()]
        # Across a beam's width the wall comes nearer.
        assert loudest_m == pytest.approx(wall_m, abs=2.0 * row_m + 0.04)
    across = np.array([[-1.0, 1.0], [1.0, -1.0]]) * ((target - place) / away_m)[::-1]
    corners = {
        "vertical rod": target + ROD_RADIUS_M * across,
        "horizontal rod": target + 0.5 * ROD_LENGTH_M * np.array([[0.0, 1.0], [0.0, -1.0]]),
        "plate": target + 0.5 * PLATE_M[1] * np.array([[0.0, 1.0], [0.0, -1.0]]),
    }
    for name, ends in corners.items():
        heard = PingEngine(tank_scene(name), sonar).ping(pose, physics).amplitude
        echo = np.sqrt(np.maximum(np.square(heard) - np.square(quiet), 0.0))
        level = echo[np.abs(rows_m - away_m) < 0.45].max(axis=0)
        loud = bearings[level > 10.0 ** (-10.0 / 20.0) * level.max()]
        seen = heading - np.arctan2(*(ends - place)[:, ::-1].T)
        within = 1.5 * sonar.beam_width_rad / math.cos(float(np.abs(seen).max()))
        assert loud.min() == pytest.approx(seen.min(), abs=within), name
        assert loud.max() == pytest.approx(seen.max(), abs=within), name
        if name == "vertical rod":
            first_m = rows_m[echo[:, int(level.argmax())].argmax()]
            assert first_m == pytest.approx(away_m - ROD_RADIUS_M, abs=2.0 * row_m)
