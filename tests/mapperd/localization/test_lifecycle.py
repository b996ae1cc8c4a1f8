from typing import Any

import numpy as np
import pytest

from mapperd.config.tree import AmclConfig
from mapperd.errors import Reject
from mapperd.geometry.gaussian import PlanarGaussian
from mapperd.localization.localizer import Lifecycle, Start, parameter_pose
from mapperd.localization.maps import GridMap

GRID = GridMap(np.zeros((3, 3), dtype=np.int8), 1.0)
OTHER = GridMap(np.zeros((4, 4), dtype=np.int8), 1.0)
SOLID = GridMap(np.full((3, 3), 100, dtype=np.int8), 1.0)
AMCL = AmclConfig()
FROM_SETTINGS = AmclConfig(set_initial_pose=True, initial_pose_x=7.0, initial_cov_xx=0.5)


def pose(x: float) -> PlanarGaussian:
    return PlanarGaussian(x, 0, 0, np.eye(3))


def done(asked: Any) -> tuple[Lifecycle, Start]:
    assert not isinstance(asked, Reject), asked
    life, start = asked
    assert isinstance(life, Lifecycle)
    return life, start


def why(asked: Any) -> str:
    assert isinstance(asked, Reject)
    return asked.reason


def running(mode: Any = "track", x: float = 1.0) -> Lifecycle:
    life, _ = done(Lifecycle(mode).take_map(GRID, AMCL)) if mode == "track" else (None, None)
    if life is None:
        return done(Lifecycle("global").take_map(GRID, AMCL))[0]
    return done(life.take_pose(pose(x), "map", AMCL))[0]


def test_track_waits_for_map_and_pose() -> None:
    life = Lifecycle("track")
    assert life.name == "waiting for a map"
    life, start = done(life.take_map(GRID, AMCL))
    assert (life.name, start) == ("waiting for a pose", Start(new_map=True))
    assert not life.publishing
    life, start = done(life.take_pose(pose(1), "map", AMCL))
    assert (life.name, life.publishing) == ("localizing", True)
    assert start.at is not None
    assert start.at.x_m == 1
    assert Lifecycle("off").name == "off"


def test_global_begins_anywhere_on_the_first_map_and_publishes() -> None:
    life, start = done(Lifecycle("global").take_map(GRID, AMCL))
    assert start == Start(new_map=True, anywhere=True)
    assert (life.running, life.publishing) == (True, True)


def test_newest_pose_waits_for_the_map() -> None:
    life = Lifecycle("global")
    for x in (1, 2):
        life, start = done(life.take_pose(pose(x), "map", AMCL))
        assert not start.is_start
    life, start = done(life.take_map(GRID, FROM_SETTINGS))
    assert start.at is not None
    assert start.at.x_m == 2
    assert life.waiting is None
    assert life.publishing


def test_pose_of_the_settings_begins_where_nothing_is_known() -> None:
    life, start = done(Lifecycle("global").take_map(GRID, FROM_SETTINGS))
    assert start.at is not None
    assert (start.at.x_m, start.at.covariance[0, 0]) == (7.0, 0.5)
    assert life.publishing


@pytest.mark.parametrize(
    ("changes", "x"),
    [
        ({}, 3.0),
        ({"set_initial_pose": True}, 3.0),
        ({"always_reset_initial_pose": True}, 3.0),
        ({"set_initial_pose": True, "always_reset_initial_pose": True}, 7.0),
    ],
)
def test_new_map_begins_at_the_last_estimate_or_again(changes: dict[str, bool], x: float) -> None:
    life = running().estimated(pose(3))
    _, start = done(life.take_map(OTHER, AmclConfig(initial_pose_x=7.0, **changes)))  # type: ignore[arg-type]
    assert start.new_map
    assert start.at is not None
    assert start.at.x_m == x


def test_estimate_saved_before_a_restart_is_a_last_estimate() -> None:
    life, start = done(Lifecycle("track", last=pose(4)).take_map(GRID, AMCL))
    assert start.at is not None
    assert start.at.x_m == 4
    assert life.publishing


def test_pose_counts_as_known_before_the_first_estimate() -> None:
    _, start = done(running(x=5.0).take_map(OTHER, AMCL))
    assert start.at is not None
    assert start.at.x_m == 5


def test_first_map_only_holds_it_once_a_filter_is_there() -> None:
    amcl = AmclConfig(first_map_only=True)
    life, _ = done(Lifecycle("track").take_map(GRID, amcl))
    life, _ = done(life.take_map(OTHER, amcl))
    assert life.map is OTHER
    assert why(running().take_map(OTHER, amcl)) == "first_map_only"


def test_pose_in_another_frame_is_refused() -> None:
    assert why(Lifecycle("track").take_pose(pose(1), "odom", AMCL)) == "wrong_frame"
    assert why(running().set_map(OTHER, pose(1), "odom", AMCL)) == "wrong_frame"
    done(Lifecycle("track").take_pose(pose(1), "harbour", AmclConfig(global_frame_id="harbour")))


def test_global_localization_needs_a_map_with_free_cells() -> None:
    assert why(Lifecycle("track").localize_globally()) == "no_map"
    life, _ = done(Lifecycle("track").take_map(SOLID, AMCL))
    assert why(life.localize_globally()) == "no_free_cells"
    life, start = done(running().localize_globally())
    assert start == Start(anywhere=True)
    assert (life.publishing, life.last) == (True, None)


def test_map_without_free_cells_is_refused_where_they_are_needed_and_the_old_one_stays() -> None:
    assert why(Lifecycle("global").take_map(SOLID, AMCL)) == "no_free_cells"
    life, _ = done(running().take_map(SOLID, AMCL))
    assert life.map is SOLID


def test_new_map_in_the_midst_of_global_localization_begins_anywhere_again() -> None:
    life, _ = done(running().localize_globally())
    life, start = done(life.take_map(OTHER, AMCL))
    assert start == Start(new_map=True, anywhere=True)
    assert life.publishing


def test_set_map_is_map_and_pose_or_neither() -> None:
    assert why(Lifecycle("track").set_map(GRID, pose(1), "map", AMCL)) == "no_filter"
    life, start = done(running().set_map(OTHER, pose(9), "map", AMCL))
    assert life.map is OTHER
    assert start.new_map
    assert start.at is not None
    assert start.at.x_m == 9


def test_update_without_motion_needs_a_filter() -> None:
    assert why(Lifecycle("track").check_nomotion_update()) == "no_filter"
    assert running().check_nomotion_update() is None


def test_pose_of_the_settings_has_their_covariance() -> None:
    found = parameter_pose(
        AmclConfig(
            initial_pose_y=2.0,
            initial_pose_a=1.0,
            initial_cov_xx=1.0,
            initial_cov_yy=2.0,
            initial_cov_aa=3.0,
            initial_cov_xy=0.1,
            initial_cov_xa=0.2,
            initial_cov_ya=0.3,
        )
    )
    assert (found.x_m, found.y_m, found.yaw_rad) == (0, 2, 1)
    assert found.covariance.tolist() == [[1, 0.1, 0.2], [0.1, 2, 0.3], [0.2, 0.3, 3]]
