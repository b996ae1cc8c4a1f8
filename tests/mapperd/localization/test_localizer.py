from typing import Any

import msgspec
import numpy as np
import pytest

from mapperd.config.loader import config_from_text
from mapperd.config.tree import AmclConfig, Config
from mapperd.geometry.frames import Pose, pose_from_rpy
from mapperd.geometry.gaussian import Belief, PlanarGaussian
from mapperd.localization.localizer import Localizer
from mapperd.localization.maps import GridMap, LocalizationMap
from mapperd.localization.scan import Scan
from mapperd.localization.update_gate import PlanarPose

GRID = GridMap(np.zeros((3, 3), dtype=np.int8), 1.0)
HEIGHT_M = -4.0
TRACK = config_from_text("localization: {mode: track}")


class Particles:
    """Records its calls; estimates the pose it was last given plus the motion since."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.beams = 0
        self.x_m = 0.0
        self.given: bool | None = None

    def reconfigure(self, config: Config) -> None:
        self.asked.append(f"settings {config.amcl.max_beams}")

    def take_map(self, known: LocalizationMap) -> None:
        assert isinstance(known, GridMap)
        self.asked.append(f"map {len(known.occupancy)}")

    def start_at(self, pose: PlanarGaussian, *, given: bool = True) -> None:
        self.asked.append("at")
        self.given = given
        self.x_m = pose.x_m

    def start_anywhere(self) -> None:
        self.asked.append("anywhere")

    def update(
        self, before: PlanarPose, now: PlanarPose, scan: Scan, base_height_m: float
    ) -> Belief:
        assert base_height_m == HEIGHT_M
        self.asked.append("update")
        self.beams = len(scan)
        self.x_m += now.x_m - before.x_m
        there = pose(self.x_m)
        return Belief(there, there, np.ones(1), 0.0, 1.0)


def pose(x: float) -> PlanarGaussian:
    return PlanarGaussian(x, 0, 0, np.eye(3))


def odom(x: float) -> Pose:
    return pose_from_rpy((x, 0, HEIGHT_M), (0, 0, 0))


def scan(k: int, beams: int = 100) -> Scan:
    numbers = np.arange(float(beams))
    points = np.zeros((beams, 3))
    return Scan(
        k * 10**9, numbers, numbers, points, numbers, np.arange(beams), numbers, 9.0, np.eye(4)
    )


def started(config: Config = TRACK) -> tuple[Localizer, Particles]:
    particles = Particles()
    localizer = Localizer(particles, config)
    assert localizer.take_map(GRID) is None
    assert localizer.take_pose(pose(50), "map") is None
    return localizer, particles


def test_scans_are_counted_and_left_until_a_filter_runs() -> None:
    particles = Particles()
    localizer = Localizer(particles, TRACK)
    assert localizer.take_scan(scan(0), odom(0)).reason == "no_filter"
    assert particles.asked == []
    assert localizer.counts == {"no_filter": 1}


def test_update_moves_the_odometry_s_frame() -> None:
    localizer, particles = started()
    first = localizer.take_scan(scan(0), odom(3))
    assert first.transform is not None
    assert (first.transform.x_m, first.transform.stamp_ns) == (47, 10**9)
    moved = localizer.take_scan(scan(1), odom(4))
    assert moved.estimate is not None
    assert moved.estimate.x_m == 51
    assert particles.asked == ["map 3", "at", "update", "update"]
    assert particles.beams == 60


def test_transform_goes_out_with_every_scan_also_without_an_update() -> None:
    localizer, _ = started()
    localizer.take_scan(scan(0), odom(3))
    still = localizer.take_scan(scan(7), odom(3))
    assert (still.reason, still.estimate) == ("still", None)
    assert still.transform is not None
    assert (still.transform.x_m, still.transform.stamp_ns) == (47, 8 * 10**9)


def test_nothing_goes_out_between_a_new_start_and_its_first_update() -> None:
    localizer, _ = started()
    assert localizer.take_scan(scan(0), odom(3)).transform is not None
    localizer.take_pose(pose(80), "map")
    lost = Pose(np.array([0.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0, 0.0]))
    object.__setattr__(lost, "position_m", np.array([np.nan, 0.0, 0.0]))
    nothing = localizer.take_scan(scan(1), lost)
    assert (nothing.reason, nothing.transform) == ("bad_odometry", None)
    found = localizer.take_scan(scan(2), odom(5))
    assert found.transform is not None
    assert found.transform.x_m == 75


@pytest.mark.parametrize("broadcast", [True, False])
def test_broadcast_is_a_setting(broadcast: bool) -> None:  # noqa: FBT001 a parameter of the test
    amcl = AmclConfig(tf_broadcast=broadcast)
    localizer, _ = started(msgspec.structs.replace(TRACK, amcl=amcl))
    found = localizer.take_scan(scan(0), odom(0))
    assert (found.transform is not None) == broadcast
    assert found.estimate is not None


def test_update_is_forced_on_request_once() -> None:
    localizer, particles = started()
    localizer.take_scan(scan(0), odom(0))
    assert localizer.request_nomotion_update() is None
    reasons = [localizer.take_scan(scan(k), odom(0)).reason for k in (1, 2)]
    assert reasons == ["forced", "still"]
    assert particles.asked.count("update") == 2
    refused = Localizer(Particles(), TRACK).request_nomotion_update()
    assert refused is not None
    assert refused.reason == "no_filter"


def test_refusals_are_counted_and_change_nothing() -> None:
    localizer, particles = started()
    life = localizer.life
    refused = localizer.take_pose(pose(1), "odom")
    assert refused is not None
    assert refused.reason == "wrong_frame"
    assert localizer.counts == {"wrong_frame": 1}
    assert localizer.life is life
    assert particles.asked == ["map 3", "at"]


def test_services_reach_the_filter() -> None:
    localizer, particles = started()
    assert localizer.localize_globally() is None
    other = GridMap(np.zeros((5, 5), dtype=np.int8), 1.0)
    assert localizer.set_map(other, pose(2), "map") is None
    assert particles.asked == ["map 3", "at", "anywhere", "map 5", "at"]


def test_filter_that_fails_leaves_the_rules_state() -> None:
    class Failing(Particles):
        def start_at(self, pose: PlanarGaussian, *, given: bool = True) -> None:
            raise MemoryError(pose.x_m, given)

    localizer = Localizer(Failing(), TRACK)
    localizer.take_map(GRID)
    life = localizer.life
    with pytest.raises(MemoryError):
        localizer.take_pose(pose(1), "map")
    assert localizer.life is life


def test_settings_hold_from_the_next_scan_on() -> None:
    localizer, particles = started()
    changed: Any = msgspec.structs.replace(
        TRACK, amcl=AmclConfig(max_beams=7, transform_tolerance=0.0)
    )
    localizer.reconfigure(changed)
    found = localizer.take_scan(scan(3), odom(0))
    assert particles.beams == 7
    assert "settings 7" in particles.asked
    assert found.transform is not None
    assert found.transform.stamp_ns == 3 * 10**9


def test_saved_estimate_is_where_it_goes_on() -> None:
    particles = Particles()
    localizer = Localizer(particles, TRACK, saved=pose(6))
    localizer.take_map(GRID)
    assert particles.asked == ["map 3", "at"]
    assert particles.x_m == 6


def test_estimate_of_a_search_is_not_given_to_the_next_map() -> None:
    localizer, particles = started()
    assert particles.given
    localizer.take_scan(scan(1), odom(0))
    assert localizer.take_map(GRID) is None
    assert particles.given is False
    assert localizer.take_pose(pose(7), "map") is None
    assert particles.given
