import math
from collections.abc import Callable

import msgspec
import numpy as np
import pytest

from mapperd.config.tree import (
    Config,
    FilteringConfig,
    IwloConfig,
    MappingConfig,
    MountingConfig,
    OctreeConfig,
    OrientationConfig,
)
from mapperd.errors import MapError
from mapperd.imaging.ping_image import PingImage, ping_image_of
from mapperd.mapping.core_args import rule_params
from mapperd.mapping.sonar_map import SonarMap
from oculus_driver.ping import Ping

MakePing = Callable[..., Ping]
COARSE = Config(
    octree=OctreeConfig(voxel_resolution=0.2),
    mounting=MountingConfig(orientation=OrientationConfig(pitch=0.0)),
)
HERE = np.eye(4)


def mapped(config: Config, *pings: Ping, at: np.ndarray = HERE) -> SonarMap:
    sonar_map = SonarMap(config)
    for ping in pings:
        sonar_map.integrate(ping_image_of(ping, config.sonar), at)
    return sonar_map


def with_mapping(**changes: object) -> Config:
    return msgspec.structs.replace(
        COARSE, mapping=msgspec.structs.replace(COARSE.mapping, **changes)
    )


def test_new_map_is_empty() -> None:
    empty = SonarMap(Config())
    counts = empty.counts()
    assert (counts.occupied, counts.free, counts.uncertain) == (0, 0, 0)
    assert len(empty.voxels("occupied")) == 0
    assert empty.resolution_m == 0.05
    assert empty.octomap_bt().startswith(b"# Octomap")


def test_mounting_is_the_published_one() -> None:
    base_T_sonar = SonarMap(Config()).base_T_sonar  # noqa: N806
    b, v = math.radians(30), math.radians(10)
    assert base_T_sonar @ [5 * math.cos(b), -5 * math.sin(b), 0, 1] == pytest.approx(
        [0, -2.5, -4.8301, 1], abs=1e-4
    )
    assert base_T_sonar @ [5 * math.cos(v), 0, 5 * math.sin(v), 1] == pytest.approx(
        [0.8682, 0, -5.4240, 1], abs=1e-4
    )


@pytest.mark.parametrize("integrator", ["evidence_grid", "rays"])
def test_classes_and_counts_agree(ping: MakePing, integrator: str) -> None:
    sonar_map = mapped(with_mapping(integrator=integrator), ping(1), ping(2), ping(3))
    counts = sonar_map.counts()
    occupied, free = sonar_map.voxels("occupied"), sonar_map.voxels("free")
    assert counts.occupied == len(occupied) > 0
    assert counts.free == len(free) > 0
    assert occupied.probability.min() > 0.7
    assert free.probability.max() < 0.5
    assert occupied.count.max() == 3
    assert occupied.count.min() >= 1
    for voxels in (occupied, free):
        assert np.isfinite(voxels.centres_m).all()
        assert np.isfinite(voxels.probability).all()
        cells = voxels.centres_m / 0.2 - 0.5
        assert cells == pytest.approx(np.round(cells), abs=1e-6)


def test_thresholds_divide_the_observed_voxels(ping: MakePing) -> None:
    usual = mapped(COARSE, ping()).counts()
    strict = mapped(with_mapping(occupied_threshold=0.999, free_threshold=0.001), ping()).counts()
    assert strict.occupied == strict.free == 0
    assert strict.uncertain == usual.occupied + usual.free + usual.uncertain


def test_integrators_differ_and_settings_reach_the_core(ping: MakePing) -> None:
    dark = np.zeros((50, 65), dtype=np.uint8)
    prints = {
        "evidence_grid": mapped(COARSE, ping()).sha256(),
        "detail": mapped(with_mapping(detail=4.0), ping()).sha256(),
        "rays": mapped(with_mapping(integrator="rays"), ping()).sha256(),
        "mean": mapped(with_mapping(aggregation="mean"), ping()).sha256(),
        "range": mapped(
            msgspec.structs.replace(COARSE, filtering=FilteringConfig(min_range=1.0)), ping()
        ).sha256(),
        "rule": mapped(
            msgspec.structs.replace(COARSE, iwlo=IwloConfig(L_occ=1.0)), ping()
        ).sha256(),
        "size": mapped(
            msgspec.structs.replace(COARSE, octree=OctreeConfig(voxel_resolution=0.25)), ping()
        ).sha256(),
    }
    assert len(set(prints.values())) == len(prints)
    assert mapped(COARSE, ping(image=dark)).counts().free == 0
    assert mapped(with_mapping(carve_no_return=True), ping(image=dark)).counts().free > 0


def test_threshold_is_strict_and_in_display_units(ping: MakePing) -> None:
    at_limit = np.full((50, 65), 35 * 257, dtype=np.uint16)
    assert mapped(COARSE, ping(image=at_limit)).counts().occupied == 0
    assert mapped(COARSE, ping(image=at_limit + np.uint16(200))).voxels("occupied") is not None
    bright = mapped(COARSE, ping(image=np.full((50, 65), 65535, dtype=np.uint16)))
    assert bright.counts().occupied > 0


def test_fingerprint_is_of_the_content(ping: MakePing) -> None:
    one, same = mapped(COARSE, ping(1)), mapped(COARSE, ping(2))
    assert one.sha256() == same.sha256()
    assert len(one.sha256()) == 64
    twice = mapped(COARSE, ping(1), ping(2))
    moved = np.eye(4)
    moved[0, 3] = 0.2
    assert len({one.sha256(), twice.sha256(), mapped(COARSE, ping(), at=moved).sha256()}) == 3
    assert SonarMap(COARSE).sha256() != SonarMap(Config()).sha256()


def test_fan_of_too_many_voxels_is_refused_at_once(ping: MakePing) -> None:
    fine = msgspec.structs.replace(COARSE, octree=OctreeConfig(voxel_resolution=0.001))
    with pytest.raises(MapError, match="set a larger octree") as caught:
        mapped(fine, ping())
    assert caught.value.reason == "fan_too_large"


def test_limit_of_a_ping_is_a_setting(ping: MakePing) -> None:
    small = msgspec.structs.replace(COARSE, mapping=MappingConfig(max_swath_voxels=1000))
    with pytest.raises(MapError, match=r"more than 1e\+03: .* mapping.max_swath_voxels") as caught:
        mapped(small, ping())
    assert caught.value.reason == "fan_too_large"


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_pose_that_is_no_number_is_refused(ping: MakePing, bad: float) -> None:
    sonar_map, pose = SonarMap(COARSE), np.eye(4)
    pose[0, 3] = bad
    with pytest.raises(MapError):
        sonar_map.integrate(ping_image_of(ping(), COARSE.sonar), pose)
    assert sonar_map.counts().occupied == 0


def test_echo_of_the_wrong_shape_is_refused() -> None:
    echo = PingImage(np.zeros((5, 4), dtype=np.float32), np.linspace(-1, 1, 5), 0.1)
    with pytest.raises(MapError):
        SonarMap(COARSE).integrate(echo, HERE)


def test_octomap_refuses_what_it_cannot_hold(ping: MakePing) -> None:
    far = np.eye(4)
    far[0, 3] = 10_000.0
    sonar_map = mapped(COARSE, ping(), at=far)
    assert sonar_map.counts().occupied > 0
    with pytest.raises(MapError) as caught:
        sonar_map.octomap_bt()
    assert caught.value.reason == "out_of_reach"


def test_every_allowed_extreme_of_the_rule_is_taken_by_the_core() -> None:
    for iwlo in (
        IwloConfig(L_occ=0.0, L_free=0.0, sharpness=0.0),
        IwloConfig(L_occ=127.0, L_free=-127.0, L_min=-127.0, L_max=127.0, sharpness=1000.0),
        IwloConfig(decay_rate=0.0, min_alpha=1.0),
        IwloConfig(decay_rate=1000.0, min_alpha=1e-6),
        IwloConfig(intensity_max=1e-9),
    ):
        assert rule_params(msgspec.structs.replace(Config(), iwlo=iwlo))
    assert MappingConfig(free_threshold=0.7)
