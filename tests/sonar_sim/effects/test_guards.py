"""What keeps the rules' numbers finite and of the right sign, at the ends of what is given."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import numpy as np
import pytest
from sonar_sim.effects.coarse_picture import CoarseGrid, Gains
from sonar_sim.effects.interference import arrivals
from sonar_sim.effects.travel_time import configure_motion
from sonar_sim.propagation.physics import Mirror, Physics
from sonar_sim.propagation.propagation_path import mirrored
from sonar_sim.scene.scene import Emitter, Scene
from sonar_sim.scene.suspended_matter import sediment_strength

from tests.sonar_sim.effects.previews import SONAR, floor, motion, pose, view_of, wall

if TYPE_CHECKING:
    from sonar_sim.effects.echoes import Echoes


def test_grains_send_back_no_more_than_their_size_and_none_of_them_nothing() -> None:
    def a_grain(radius_m: float) -> float:
        per_m3 = 1.0 / 2600.0 / (4.0 / 3.0 * np.pi * radius_m**3)
        return sediment_strength(750e3, 1.0, radius_m, 1500.0) / (per_m3 * radius_m**2)

    assert a_grain(1e-2) == pytest.approx(0.25, rel=0.05)
    assert a_grain(2e-5) / a_grain(1e-5) == pytest.approx(16.0)
    assert sediment_strength(750e3, 0.0, 1e-4, 1500.0) == 0.0
    assert sediment_strength(750e3, -1.0, 1e-4, 1500.0) == 0.0


def test_gains_of_any_range_leave_numbers() -> None:
    gains = Gains(np.array([0.0, 40.0, 1e5]), 10.0, 200.0)
    assert np.isfinite(gains.amplitude(np.ones((3, 2)))).all()


@pytest.mark.parametrize("part", [0.05, 0.25, 0.5, 0.75, 0.95])
def test_an_echo_lies_in_the_coarse_row_of_its_range(part: float) -> None:
    grid = CoarseGrid(SONAR)
    one = SimpleNamespace(
        extent_m=np.zeros(1), range_m=np.array([(7 + part) * grid.row_m]), column=np.array([3])
    )
    picture = grid.main_lobes(cast("Echoes", one), np.ones(1))
    assert np.argwhere(picture > 0).tolist() == [[7, 3]]


SOURCE_DB = 190.0


def levels_db(place_m: tuple[float, float, float], offset_s: float = 0.0) -> list[float]:
    other = Emitter("other", place_m, 750e3, 100e3, SOURCE_DB, 0.01, 1e-3, offset_s)
    return [a.level_db for a in arrivals(view_of(scene=Scene((floor(),), emitters=(other,))))]


def test_another_sonar_is_heard_from_ahead_once_it_sounds_and_not_infinitely() -> None:
    assert levels_db((8.0, 1.0, -3.0))
    assert levels_db((-8.0, 1.0, -3.0)) == []
    assert levels_db((8.0, 1.0, -3.0), offset_s=1.0) == []
    beside = levels_db((0.01, 0.0, -3.0))
    assert all(level_db <= SOURCE_DB for level_db in beside)


@pytest.mark.parametrize(("forward_mps", "blocks"), [(0.01, 4), (500.0, 16)])
def test_a_ping_has_a_few_poses_however_slow_or_fast(forward_mps: float, blocks: int) -> None:
    physics = Physics()
    configure_motion(physics, view_of(wall(9.0), at=pose(0.0), moving=motion(forward_mps)))
    assert physics.pose_blocks == blocks


def test_an_echo_at_the_transducer_is_finite_and_absorbed_there_and_back() -> None:
    view = view_of(wall(9.0), at=pose(0.0))
    near, far = (
        SimpleNamespace(range_m=np.array([r, r]), point_m=np.zeros((2, 3))) for r in (0.0, 40.0)
    )
    assert np.isfinite(view.on_axis_power_per_m2(cast("Echoes", near))).all()
    twice = SimpleNamespace(range_m=np.array([80.0]), point_m=np.zeros((1, 3)))
    fall = (
        view.on_axis_power_per_m2(cast("Echoes", far))[0]
        / view.on_axis_power_per_m2(cast("Echoes", twice))[0]
    )
    db_per_m = view.water_db_per_m + view.sediment_db_per_m
    assert 10 * np.log10(fall) == pytest.approx(40 * np.log10(2) + 2 * 40 * db_per_m)


def test_what_is_behind_a_mirror_has_no_image() -> None:
    sea = Mirror(np.zeros(3), np.array([0.0, 0.0, -1.0]), -1.0, 0)
    image = mirrored(pose(3.0), sea)
    assert image is not None
    assert image.position_m == pytest.approx([0.0, 0.0, 3.0])
    assert mirrored(pose(-0.5), sea) is None
    assert mirrored(pose(0.0), sea) is None
