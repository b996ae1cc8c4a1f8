"""Ghosts of finite mirrors: there is one where the bounce's point lies on the mirror, else none."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from sonar_sim.effects.planes import mirror_planes
from sonar_sim.engine import PingEngine
from sonar_sim.propagation.physics import Mirror, SoundSpeedProfile
from sonar_sim.raycast.meshes import SEA, Hits, Meshes
from sonar_sim.scene.material import MATERIALS, Material
from sonar_sim.scene.scene import Scene, Sea, Surface
from sonar_sim.simulator import SPARSE_NODES_PER_BEAM
from sonar_sim.validation.setups import (
    CHALK,
    MEAN,
    Vector,
    narrow_sonar,
    pose_at,
    rectangle,
    target,
)

HERE = pose_at((0.0, 0.0, 0.0))
BELOW_M = 1.0
"""The mirror's plane lies so far below the sonar and the target."""
AWAY_M = 6.0
BOUNCED_M = math.hypot(AWAY_M, 2.0 * BELOW_M)
ROW_M = 0.01
SILENT = Material("silent", -200.0, 0.9, 0.0, 0.01)
ONCE_ROW, TWICE_ROW = (int(m / ROW_M) for m in ((AWAY_M + BOUNCED_M) / 2.0, BOUNCED_M))


def plate(from_m: float, to_m: float) -> Surface:
    """Level, between two distances ahead."""
    centre: Vector = ((from_m + to_m) / 2.0, 0.0, -BELOW_M)
    return rectangle(centre, (to_m - from_m, 0.0, 0.0), (0.0, 4.0, 0.0), SILENT)


MIRROR = Mirror(np.array([0.0, 0.0, -BELOW_M]), np.array([0.0, 0.0, 1.0]), 0.9, 0)


def rows(
    scene: Scene, *mirrors: Mirror, speckle: bool = False, range_m: float = 7.0
) -> NDArray[np.float32]:
    """Loudest amplitude of each row."""
    physics = dataclasses.replace(MEAN, specular=False, mirrors=mirrors, speckle=speckle)
    engine = PingEngine(scene, narrow_sonar(range_m, ROW_M), elevations=448)
    loudest: NDArray[np.float32] = engine.ping(HERE, physics).amplitude.max(axis=1)
    return loudest


def ghosts(level: NDArray[np.float32], reach: int = 2) -> tuple[bool, bool]:
    """Whether there is an echo half by the mirror, and one wholly by it."""
    least = 1e-3 * level.max()
    once, twice = (level[r - reach : r + reach + 1].max() > least for r in (ONCE_ROW, TWICE_ROW))
    return bool(once), bool(twice)


def small() -> Surface:
    return rectangle((AWAY_M, 0.0, 0.0), (0.0, 0.2, 0.0), (0.0, 0.0, 0.05), CHALK)


@pytest.mark.parametrize("speckle", [False, True])
@pytest.mark.parametrize(
    ("from_m", "to_m", "there"),
    [(2.8, 3.2, True), (2.6, 2.9, False), (3.1, 3.5, False), (-50.0, 50.0, True)],
)
def test_a_plate_mirrors_where_it_is(
    *, from_m: float, to_m: float, there: bool, speckle: bool
) -> None:
    """The bounce's point is half-way, 3 m ahead."""
    for scene in (
        Scene((plate(from_m, to_m), small())),
        Scene((plate(from_m, to_m),), targets=(target((AWAY_M, 0.0, 0.0)),)),
    ):
        level = rows(scene, MIRROR, speckle=speckle)
        assert ghosts(level) == (there, there)


@pytest.mark.parametrize("speckle", [False, True])
def test_a_ghost_shows_though_its_mirrored_way_is_longer_than_the_range(*, speckle: bool) -> None:
    range_m = AWAY_M + 0.6 * (BOUNCED_M - AWAY_M)
    level = rows(Scene((plate(2.8, 3.2), small())), MIRROR, speckle=speckle, range_m=range_m)
    assert len(level) < TWICE_ROW
    assert level[ONCE_ROW - 2 : ONCE_ROW + 3].max() > 1e-3 * level.max()


@pytest.mark.parametrize("shadows", [True, False])
def test_rays_that_were_cast_are_not_cast_again_to_mirrors(
    monkeypatch: pytest.MonkeyPatch, *, shadows: bool
) -> None:
    scene = Scene((plate(2.0, 4.0), small()))
    physics = dataclasses.replace(MEAN, specular=False, mirrors=(MIRROR,), shadows=shadows)
    # The same fan, but not the sonar's own.
    again = dataclasses.replace(physics, mirrored_elevations_rad=(-0.5, 0.5))
    engine = PingEngine(scene, narrow_sonar(7.0, ROW_M))
    casts: list[int] = []
    cast = Meshes.cast

    def counted(meshes: Meshes, *args: Any, **kwargs: Any) -> Hits:
        casts.append(len(args[1]))
        return cast(meshes, *args, **kwargs)

    monkeypatch.setattr(Meshes, "cast", counted)
    for at in (HERE, pose_at((0.3, 0.2, 0.1))):
        made = []
        for one in (physics, again):
            casts.clear()
            made.append((engine.ping(at, one).amplitude, len(casts)))
        (known, few), (new, more) = made
        np.testing.assert_allclose(known, new, rtol=1e-4, atol=1e-6 * known.max())
        assert few == more - 1


def test_mirrors_work_beside_refracted_paths() -> None:
    scene = Scene((plate(2.8, 3.2), small()))
    level = SoundSpeedProfile(np.array([0.0, 50.0]), np.array([1500.0, 1500.0]))
    physics = dataclasses.replace(MEAN, specular=False, mirrors=(MIRROR,), layers=level)
    below = pose_at((0.0, 0.0, 0.0))
    bent = PingEngine(scene, narrow_sonar(7.0, ROW_M), elevations=448).ping(below, physics)
    assert ghosts(bent.amplitude.max(axis=1)) == (True, True)


def test_a_screen_before_or_after_the_bounce_hides_the_ghost() -> None:
    for x in (1.5, 4.5):
        screen = rectangle((x, 0.0, -0.5), (0.0, 4.0, 0.0), (0.0, 0.0, 0.3), SILENT)
        surfaces = (plate(2.5, 3.5), screen)
        point = target((AWAY_M, 0.0, 0.0))
        for scene in (Scene((*surfaces, small())), Scene(surfaces, targets=(point,))):
            assert ghosts(rows(scene, MIRROR)) == (False, False)


def test_what_lies_close_before_a_mirror_is_no_part_of_it() -> None:
    """Not a box's far side either: its near side is met first."""
    near = dataclasses.replace(plate(2.8, 3.2), name="cover")
    lifted = dataclasses.replace(near, vertices_m=near.vertices_m + np.array([0.0, 0.0, 0.01]))
    scene = Scene((plate(2.8, 3.2), lifted, small()))
    assert ghosts(rows(scene, MIRROR)) == (False, False)
    one = dataclasses.replace(
        near,
        vertices_m=np.concatenate([near.vertices_m, lifted.vertices_m]),
        faces=np.concatenate([near.faces, lifted.faces + len(near.vertices_m)]),
    )
    scene = Scene((one, small()))
    assert ghosts(rows(scene, MIRROR)) == (False, False)


def test_sonar_and_mirror_must_see_the_same_side() -> None:
    """A mirror on the floor shows a level sheet's underside; the sonar hears its upper side."""
    sheet = rectangle((4.04, 0.0, -0.5), (0.08, 0.0, 0.0), (0.0, 0.4, 0.0), CHALK)
    scene = Scene((plate(1.0, 6.0), sheet))
    seen = np.flatnonzero(rows(scene, MIRROR) > 1e-9) * ROW_M
    direct_m, bounced_m = (np.hypot([4.0, 4.08], height_m) for height_m in (0.5, 1.5))
    assert np.any(np.abs(seen - direct_m.mean()) < 0.1)
    assert np.any(np.abs(seen - bounced_m.mean()) < 0.1)
    # A whole ray's cell belongs to the sheet or not: so high up in the fan that is 3 cm.
    ways_m = [(seen > m[0] - 0.03) & (seen < m[1] + 0.03) for m in (direct_m, bounced_m)]
    assert np.all(ways_m[0] | ways_m[1])


def test_the_sea_mirrors_all_over() -> None:
    calm = Sea(rms_height_m=0.0)
    deep = dataclasses.replace(small(), vertices_m=small().vertices_m - [0.0, 0.0, 2.0])
    mirror = Mirror(np.zeros(3), np.array([0.0, 0.0, -1.0]), -1.0, SEA)
    scene = Scene((deep,), sea=calm)
    physics = dataclasses.replace(MEAN, mirrors=(mirror,))
    engine = PingEngine(scene, narrow_sonar(8.0, ROW_M), elevations=448)
    level = engine.ping(pose_at((0.0, 0.0, -2.0)), physics).amplitude.max(axis=1)
    bounced_m = math.hypot(AWAY_M, 4.0)
    assert level[int(bounced_m / ROW_M) - 2 : int(bounced_m / ROW_M) + 3].max() > 0.0


def test_a_face_belongs_to_one_mirror_only() -> None:
    """Whichever way its triangles turn, and wherever its offset is rounded."""
    sheet = rectangle((2.005, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, 2.0), MATERIALS["glass"], 4)
    turned = sheet.faces.copy()
    turned[::3] = turned[::3, ::-1]
    wobbly = sheet.vertices_m + [1e-5, 0.0, 0.0] * (np.arange(len(sheet.vertices_m)) % 2)[:, None]
    scene = Scene((dataclasses.replace(sheet, vertices_m=wobbly, faces=turned),))
    assert len(mirror_planes(scene, narrow_sonar(7.0))) == 1


@pytest.mark.parametrize("speckle", [False, True])
def test_rays_that_pass_by_a_mirror_add_nothing(*, speckle: bool) -> None:
    """The mirror's box spares the rays beside it, and those alone."""
    scene = Scene((plate(2.8, 3.6), small()))
    boxed = dataclasses.replace(
        MIRROR, low_m=np.array([2.8, -2.0, -BELOW_M]), high_m=np.array([3.6, 2.0, -BELOW_M])
    )
    physics = dataclasses.replace(MEAN, specular=False, mirrors=(MIRROR,), speckle=speckle)
    engine = PingEngine(scene, narrow_sonar(7.0, ROW_M), elevations=448)
    for at in (HERE, pose_at((1.0, 0.3, 0.2)), pose_at((-1.0, 0.0, 0.5))):
        every, fewer = (
            engine.ping(at, dataclasses.replace(physics, mirrors=(mirror,))).amplitude
            for mirror in (MIRROR, boxed)
        )
        np.testing.assert_array_equal(every, fewer)
    elsewhere = dataclasses.replace(boxed, low_m=boxed.low_m + 2.0, high_m=boxed.high_m + 2.0)
    assert ghosts(rows(scene, boxed)) == (True, True)
    assert ghosts(rows(scene, elsewhere)) == (False, False)


@pytest.mark.parametrize("subdivisions", [3, 6])
def test_ghosts_of_small_faces_have_the_expected_level(subdivisions: int) -> None:
    """A face's plane is followed over its cell, however small the face is."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.25)
    points = np.array([4.0, 0.0, -0.4]) + np.asarray(ball.vertices)
    round_one = Surface("ball", points, np.asarray(ball.faces), CHALK, smooth=True)
    scene = Scene((plate(-50.0, 50.0), round_one))
    engine = PingEngine(scene, narrow_sonar(6.0, ROW_M), elevations=448)

    def ghosts_power(seed: int, *, speckle: bool) -> float:
        physics = dataclasses.replace(MEAN, specular=False, speckle=speckle)
        pings = [
            engine.reseeded(seed).ping(HERE, dataclasses.replace(physics, mirrors=mirrors))
            for mirrors in ((MIRROR,), ())
        ]
        whole, direct = (float(np.square(ping.amplitude).sum()) for ping in pings)
        return whole - direct

    expected = ghosts_power(0, speckle=False)
    speckled = np.mean([ghosts_power(seed, speckle=True) for seed in range(30)])
    assert 10.0 * np.log10(speckled / expected) == pytest.approx(0.0, abs=0.6)


@pytest.mark.parametrize("roll_deg", [0.0, 1.0, 2.0, 4.0, 9.0])
def test_ways_there_and_back_add_up_where_one_beam_hears_both(roll_deg: float) -> None:
    """Both are equally long. A sonar that leans hears them in two bearings."""
    width_rad = math.radians(1.0)
    scene = Scene((plate(-50.0, 50.0),), targets=(target((AWAY_M, 0.0, 0.0)),))
    turn = Rotation.from_euler("x", roll_deg, degrees=True).as_matrix()
    sonar = narrow_sonar(7.0, ROW_M, 65)
    engine = PingEngine(scene, sonar)
    physics = dataclasses.replace(MEAN, specular=False, mirrors=(MIRROR,), beam_width_rad=width_rad)
    power = np.square(engine.ping(dataclasses.replace(HERE, rotation=turn), physics).amplitude)
    heard = power[ONCE_ROW - 2 : ONCE_ROW + 3].sum() / power[TWICE_ROW - 2 : TWICE_ROW + 3].sum()
    sines = np.linspace(-0.5, 0.5, 4001)
    away = np.array([[AWAY_M, 0.0, 0.0], [AWAY_M, 0.0, -2.0 * BELOW_M]])
    bearings = -(away @ turn[:, 1]) / np.linalg.norm(away, axis=1)
    beams = [np.exp(-2.0 * math.log(2.0) * np.square((sines - s) / width_rad)) for s in bearings]
    once = np.square(beams[0] + beams[1]).sum() / np.square(beams[0]).sum()
    expected = once * (BOUNCED_M / AWAY_M) ** 2 / MIRROR.reflection**2
    assert 10.0 * np.log10(heard / expected) == pytest.approx(0.0, abs=0.1)


FACING = rectangle((2.0, 0.0, 0.0), (0.0, 4.0, 0.0), (0.0, 0.0, 4.0), CHALK)
"""Seen straight, and in mirrors below, above and beside it."""
AROUND = tuple(
    Mirror(np.array(point), np.array(normal), 0.9)
    for point, normal in (
        ((0.0, 0.0, -1.0), (0.0, 0.0, 1.0)),
        ((0.0, 0.0, 1.5), (0.0, 0.0, -1.0)),
        ((0.0, 1.0, 0.0), (0.0, -1.0, 0.0)),
    )
)


@pytest.mark.parametrize("speckle", [False, True])
def test_bytes_do_not_depend_on_the_threads_that_share_mirrors(*, speckle: bool) -> None:
    physics = dataclasses.replace(MEAN, mirrors=AROUND, speckle=speckle)
    engines = [PingEngine(Scene((FACING,)), narrow_sonar(4.0), 1, n) for n in (0, 1, 2, 3, 8)]
    assert len({engine.ping(HERE, physics).amplitude.tobytes() for engine in engines}) == 1


def test_speckle_of_ghosts_alone_is_rayleighs() -> None:
    """A plate behind the sonar, whose front a mirror before the sonar shows it."""
    mirror = Mirror(np.array([1.0, 0.0, 0.0]), np.array([-1.0, 0.0, 0.0]), 0.9)
    behind = rectangle((-2.0, 0.0, 0.0), (0.0, 40.0, 0.0), (0.0, 0.0, 40.0), CHALK)
    sonar = narrow_sonar(9.0, 0.01, beams=256)
    mean = dataclasses.replace(
        MEAN,
        mirrors=(mirror,),
        lambert=False,
        beam_width_rad=sonar.beam_width_rad,
        side_lobe_db=sonar.side_lobe_db,
        range_spread=True,
    )
    speckled, heard = dataclasses.replace(mean, speckle=True), []
    for seed in range(4):
        engine = PingEngine(Scene((behind,)), sonar, seed, nodes_per_beam=SPARSE_NODES_PER_BEAM)
        level, shown = (
            engine.ping(HERE, physics).amplitude[310:515, 40:-40].astype(np.float64)
            for physics in (mean, speckled)
        )
        heard.append(shown / level)
    found = np.stack(heard)
    assert np.mean(np.square(found)) == pytest.approx(1.0, abs=0.03)
    assert found.std() / found.mean() == pytest.approx(0.5227, abs=0.01)
