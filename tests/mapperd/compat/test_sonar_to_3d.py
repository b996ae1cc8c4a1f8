import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mapperd import SonarTo3DMapper
from mapperd.config.tree import SonarConfig
from mapperd.errors import ConfigError, ExportError, MapError, StoreError
from mapperd.geometry.frames import Pose
from mapperd.imaging.ping_image import PingImage, ping_image_of_array, uniform_bearings
from mapperd.mapping.queries import FREE, OCCUPIED
from mapperd.mapping.sonar_map import SonarMap

COARSE = {"voxel_resolution": 0.2, "sonar_orientation": [0, 0, 0], "horizontal_fov": 120}
HOME = ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0])


def wall() -> np.ndarray:
    """A wall 3 m away: 50 rows of 10 cm, 65 beams."""
    image = np.zeros((50, 65), dtype=np.uint8)
    image[30:32] = 200
    return image


def mapped(config: dict[str, Any] | None = None, times: int = 1) -> SonarTo3DMapper:
    mapper = SonarTo3DMapper(COARSE | (config or {}))
    for _ in range(times):
        mapper.process_sonar_image(wall(), *HOME, max_range=5.0)
    return mapper


def test_image_becomes_voxels_as_the_map_itself_would() -> None:
    mapper = mapped(times=3)
    reference = SonarMap(mapper.config)
    echo = PingImage(wall().astype(np.float32), uniform_bearings(65, mapper.config.sonar), 0.1)
    for _ in range(3):
        reference.integrate(echo, np.eye(4) @ reference.base_T_sonar)
    cloud, occupied = mapper.get_point_cloud(), reference.voxels("occupied")
    assert cloud["num_occupied"] == len(occupied) > 0
    assert (cloud["points"] == occupied.centres_m).all()
    assert (cloud["probabilities"] == occupied.probability).all()
    assert "free_points" not in cloud


def test_map_on_disk_is_that_in_memory_with_one_tile_of_it_in_memory(tmp_path: Path) -> None:
    on_disk = {
        "use_outofcore": True,
        "outofcore_map_path": str(tmp_path / "dive.map"),
        "outofcore_tile_size": 2.0,
        "outofcore_cache_size": 1,
    }
    in_memory = SonarTo3DMapper(COARSE)
    places = [[3.0 * k, 0.5 * k, 0.0] for k in range(40)]
    with SonarTo3DMapper(COARSE | on_disk) as mapper:
        for number, place in enumerate(places):
            for one in (mapper, in_memory):
                one.process_sonar_image(wall(), place, HOME[1], max_range=5.0)
            if number == 20:
                assert mapper.flush_map()
        cloud, expected = (one.get_point_cloud(include_free=True) for one in (mapper, in_memory))
        for name in ("points", "probabilities", "free_points", "free_probabilities"):
            assert (cloud[name] == expected[name]).all()
        assert mapper.get_memory_stats()["backend"] == "outofcore"
        assert (
            mapper.get_memory_stats()["num_leaf_nodes"] < cloud["num_occupied"] + cloud["num_free"]
        )
        for one in (mapper, in_memory):
            one.update_occupied_threshold(0.9)
            one.update_occupied_threshold(0.7)
        for suffix in ("map", "bt", "ot", "ply"):
            for name, one in (("disk", mapper), ("memory", in_memory)):
                assert one.save_map(tmp_path / f"{name}.{suffix}")
            both = [(tmp_path / f"{name}.{suffix}").read_bytes() for name in ("disk", "memory")]
            assert both[0] == both[1]
        for refused in (lambda: mapper.queries, lambda: in_memory.merge(mapper)):
            with pytest.raises(MapError, match="in tiles"):
                refused()
    with SonarTo3DMapper(COARSE | on_disk) as again:
        assert (again.get_point_cloud()["points"] == expected["points"]).all()
        again.reset_map()
        assert again.get_point_cloud()["num_occupied"] == 0
    with pytest.raises(StoreError, match="voxel_resolution"):
        SonarTo3DMapper(COARSE | on_disk | {"voxel_resolution": 0.1})


def test_map_on_disk_without_a_path_is_temporary() -> None:
    with SonarTo3DMapper(COARSE | {"use_outofcore": True}) as mapper:
        mapper.process_sonar_image(wall(), *HOME, max_range=5.0)
        folder = Path(mapper._store.path).parent if mapper._store else Path()
        assert (folder / "mapperd.map").exists()
        assert len(mapper.get_point_cloud()["points"]) == len(mapped().get_point_cloud()["points"])
    assert not folder.exists()


def test_statistics_report_what_happened() -> None:
    ticks = itertools.count(0.0, 0.25)
    mapper = SonarTo3DMapper(COARSE, clock=lambda: next(ticks))
    first = mapper.process_sonar_image(wall(), *HOME, max_range=5.0)
    second = mapper.process_sonar_image(wall(), *HOME, max_range=5.0)
    assert (first["frame_count"], second["frame_count"]) == (1, 2)
    assert second["processed_count"] == 2
    assert second["processing_time"] == second["average_processing_time"] == 0.25
    assert first["num_occupied"] > 0
    assert first["num_voxels"] == first["num_occupied"] + first["num_free"]
    assert second["num_voxels"] == first["num_voxels"]


def test_free_points_are_returned() -> None:
    cloud = mapped(times=2).get_point_cloud(include_free=True)
    assert cloud["num_free"] == len(cloud["free_points"]) == len(cloud["free_probabilities"]) > 0
    assert cloud["free_probabilities"].max() < 0.5
    assert cloud["probabilities"].min() > 0.7
    for points in (cloud["points"], cloud["free_points"]):
        cells = points / 0.2 - 0.5
        assert cells == pytest.approx(np.round(cells), abs=1e-6)


def test_quaternion_is_xyzw_and_turns_the_map() -> None:
    mapper = SonarTo3DMapper(COARSE)
    half = math.sqrt(0.5)
    mapper.process_sonar_image(wall(), [10, 0, 0], [0, 0, half, half], max_range=5.0)  # to port
    pose = Pose(np.array([10.0, 0, 0]), np.array([half, 0, 0, half]))
    reference = SonarMap(mapper.config)
    echo = ping_image_of_array(wall(), 5.0, None, mapper.config.sonar)
    reference.integrate(echo, pose.map_T_base @ reference.base_T_sonar)
    assert (mapper.get_point_cloud()["points"] == reference.voxels("occupied").centres_m).all()
    assert mapper.get_point_cloud()["points"][:, 1].min() > 0
    rounded = SonarTo3DMapper(COARSE)
    rounded.process_sonar_image(wall(), [10, 0, 0], [0, 0, 0.70711, 0.70711], max_range=5.0)
    assert rounded.get_point_cloud()["num_occupied"] > 0


def test_images_of_all_depths_are_one_image() -> None:
    clouds = []
    for image in (
        wall(),
        wall().astype(np.uint16) * np.uint16(257),
        wall().astype(np.float32),
        wall().astype(np.float64),
        wall().tolist(),
    ):
        mapper = SonarTo3DMapper(COARSE)
        array = np.array(image, dtype=np.uint8) if isinstance(image, list) else image
        mapper.process_sonar_image(array, *HOME, max_range=5.0)
        clouds.append(mapper.get_point_cloud())
    for cloud in clouds[1:]:
        assert (cloud["points"] == clouds[0]["points"]).all()
        assert (cloud["probabilities"] == clouds[0]["probabilities"]).all()


def test_bearings_are_uniform_in_sine_unless_given() -> None:
    table = uniform_bearings(256, SonarConfig(horizontal_fov=60.0))
    assert np.diff(np.sin(table)) == pytest.approx(1 / 255)
    assert table[[0, -1]] == pytest.approx([-math.pi / 6, math.pi / 6])
    given, default = SonarTo3DMapper(COARSE), mapped()
    bearings = uniform_bearings(65, given.config.sonar)
    given.process_sonar_image(wall(), *HOME, max_range=5.0, bearings=bearings)
    assert (given.get_point_cloud()["points"] == default.get_point_cloud()["points"]).all()
    narrow = SonarTo3DMapper(COARSE | {"horizontal_fov": 60})
    narrow.process_sonar_image(wall(), *HOME, max_range=5.0, bearings=bearings)
    assert 0 < narrow.get_point_cloud()["num_occupied"] < default.get_point_cloud()["num_occupied"]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"polar_image": np.zeros(5, dtype=np.uint8)}, "bad_image"),
        ({"polar_image": np.zeros((0, 5), dtype=np.uint8)}, "bad_image"),
        ({"polar_image": np.full((50, 65), np.nan)}, "bad_image"),
        ({"polar_image": np.full((50, 65), 256.0)}, "bad_image"),
        ({"polar_image": np.full((50, 65), -1.0)}, "bad_image"),
        ({"polar_image": np.zeros((50, 65), dtype=np.int32)}, "bad_image"),
        ({"polar_image": np.zeros((50, 1), dtype=np.uint8)}, "refused_by_map"),
        ({"robot_position": [0, 0]}, "bad_pose"),
        ({"robot_position": [0, 0, math.nan]}, "bad_pose"),
        ({"robot_position": [1e30, 0, 0]}, "refused_by_map"),
        ({"robot_position": ["a", 0, 0]}, "bad_pose"),
        ({"robot_orientation": [0, 0, 0, 0]}, "bad_pose"),
        ({"robot_orientation": [0, 0, 0, 2]}, "bad_pose"),
        ({"robot_orientation": [0, 0, math.nan, 1]}, "bad_pose"),
        ({"robot_orientation": [0, 0, 1]}, "bad_pose"),
        ({"max_range": 0.0}, "bad_range"),
        ({"max_range": math.nan}, "bad_range"),
        ({"max_range": math.inf}, "bad_range"),
        ({"max_range": 9000.0}, "fan_too_large"),
        ({"bearings": np.zeros(65)}, "bad_bearings"),
        ({"bearings": np.linspace(-1, 1, 64)}, "bad_bearings"),
        ({"bearings": np.full(65, np.nan)}, "bad_bearings"),
        ({"bearings": np.linspace(1.2, 1.5, 65)}, "outside_fov"),
    ],
)
def test_bad_input_is_refused_by_its_reason(change: dict[str, Any], reason: str) -> None:
    mapper = SonarTo3DMapper(COARSE)
    arguments: dict[str, Any] = {
        "polar_image": wall(),
        "robot_position": HOME[0],
        "robot_orientation": HOME[1],
        "max_range": 5.0,
    }
    with pytest.raises(MapError) as caught:
        mapper.process_sonar_image(**(arguments | change))
    assert caught.value.reason == reason
    assert mapper.get_memory_stats()["num_leaf_nodes"] == 0
    assert mapper.process_sonar_image(**arguments)["processed_count"] == 1
    assert mapper.get_point_cloud()["frame_count"] == 2


def test_wrong_settings_are_refused() -> None:
    with pytest.raises(ConfigError, match="did you mean"):
        SonarTo3DMapper({"voxel_resolutin": 0.1})
    assert SonarTo3DMapper().config.octree.voxel_resolution == 0.05


def test_reset_forgets_the_map_and_keeps_the_settings() -> None:
    mapper = mapped(times=2)
    mapper.reset_map()
    cloud = mapper.get_point_cloud(include_free=True)
    assert (cloud["num_occupied"], cloud["num_free"], cloud["frame_count"]) == (0, 0, 0)
    assert mapper.process_sonar_image(wall(), *HOME, max_range=5.0)["frame_count"] == 1
    assert mapper.config.octree.voxel_resolution == 0.2


def test_memory_is_reported() -> None:
    stats = mapped().get_memory_stats()
    assert (stats["backend"], stats["resolution"]) == ("memory", 0.2)
    assert stats["memory_mb"] == stats["memory_bytes"] / 2**20 > 0
    assert stats["num_leaf_nodes"] > 0


def test_queries_know_the_settings_thresholds() -> None:
    mapper = mapped(times=3)
    cloud = mapper.get_point_cloud(include_free=True)
    assert (mapper.queries.classify(cloud["points"]) == OCCUPIED).all()
    assert (mapper.queries.classify(cloud["free_points"]) == FREE).all()
    depth = mapper.queries.ray_cast_depth([[0, 0, -0.49]], [[1, 0, 0]], 5.0)
    assert depth[0] == pytest.approx(3.0, abs=0.2)


def test_two_robots_maps_become_one() -> None:
    one, two, whole = mapped(), mapped(), SonarTo3DMapper(COARSE)
    whole.merge(one, two)
    one.merge(two)
    mine, theirs = one.get_point_cloud(), whole.get_point_cloud()
    assert (mine["points"] == theirs["points"]).all()
    assert (mine["probabilities"] == theirs["probabilities"]).all()
    with pytest.raises(ValueError, match="clamps"):
        one.merge(SonarTo3DMapper(COARSE | {"L_max": 8.0}))


def test_maps_are_saved_in_every_form(tmp_path: Path) -> None:
    mapper = mapped(times=2)
    assert mapper.save_merged_octree(tmp_path / "map.bt")
    assert (tmp_path / "map.bt").read_bytes().startswith(b"# Octomap OcTree binary")
    assert mapper.save_map(str(tmp_path / "map.ot"))
    assert (tmp_path / "map.ot").read_bytes().startswith(b"# Octomap OcTree")
    assert mapper.save_map(tmp_path / "map.ply")
    count = mapper.get_point_cloud()["num_occupied"]
    assert f"element vertex {count}\n".encode() in (tmp_path / "map.ply").read_bytes()
    assert mapper.save_map(tmp_path / "all.map")
    loaded = SonarTo3DMapper(COARSE)
    assert loaded.load_map(tmp_path / "all.map")
    assert (loaded.get_point_cloud()["points"] == mapper.get_point_cloud()["points"]).all()
    with pytest.raises(MapError, match="voxels are"):
        SonarTo3DMapper({"voxel_resolution": 0.1}).load_map(tmp_path / "all.map")
    for bad in ("map.txt", "map"):
        with pytest.raises(MapError, match="expected"):
            mapper.save_map(tmp_path / bad)
    with pytest.raises(MapError, match=r"\.bt"):
        mapper.save_merged_octree(tmp_path / "map.ot2")
    with pytest.raises(ExportError):
        mapper.save_map(tmp_path / "nowhere" / "map.bt")


def test_stripes_are_taken_out_on_request() -> None:
    image = np.zeros((50, 65), dtype=np.uint8)
    image[40:47, :20] = 120
    striped = image.copy()
    striped[30:32] = 200
    clean, filtered = mapped_image(image, {}), mapped_image(striped, {"crosstalk_enabled": True})
    assert len(clean) == len(filtered) > 0
    assert (clean == filtered).all()
    assert len(mapped_image(striped, {})) > len(clean)


def mapped_image(image: np.ndarray, config: dict[str, Any]) -> np.ndarray:
    mapper = SonarTo3DMapper(COARSE | config)
    mapper.process_sonar_image(image, *HOME, max_range=5.0)
    return np.asarray(mapper.get_point_cloud()["points"])


def test_range_is_a_setting_unless_it_comes_with_the_image() -> None:
    given, default, changed = SonarTo3DMapper(COARSE | {"max_range": 5.0}), mapped(), mapped()
    given.process_sonar_image(wall(), *HOME)
    assert (given.get_point_cloud()["points"] == default.get_point_cloud()["points"]).all()
    published = SonarTo3DMapper(COARSE)
    published.process_sonar_image(wall(), *HOME)  # its range is 10 m
    assert 5.5 < published.get_point_cloud()["points"][:, 0].max() < 6.5
    changed.reset_map()
    changed.update_max_range(np.float32(10.0))
    changed.process_sonar_image(wall(), *HOME)
    assert len(changed.get_point_cloud()["points"]) == len(published.get_point_cloud()["points"])
    for bad in (0, -1.0, math.nan, 1e6, "far"):
        with pytest.raises(ConfigError, match=r"max_range: .*allowed: above 0"):
            SonarTo3DMapper({"max_range": bad})


def test_first_of_every_few_images_is_mapped() -> None:
    mapper = SonarTo3DMapper(COARSE | {"frame_skip": 3})
    stats = [mapper.process_sonar_image(wall(), *HOME, max_range=5.0) for _ in range(7)]
    assert [one["processed_count"] for one in stats] == [1, 1, 1, 2, 2, 2, 3]
    assert [one["num_occupied"] > 0 for one in stats] == [True, False, False] * 2 + [True]
    assert (stats[1]["processing_time"], stats[1]["frame_count"]) == (0.0, 2)
    thrice = mapped(times=3).get_point_cloud()
    assert (mapper.get_point_cloud()["probabilities"] == thrice["probabilities"]).all()


def bright() -> np.ndarray:
    """A wall as dark as terrain, and a robot 1.5 m away, 0.3 of the fan to port."""
    image = wall() // 2
    image[14:16, 20:23] = 240
    return image


def test_robots_are_reported_by_their_bands_and_kept_out_on_request() -> None:
    ticks = itertools.count(100.0, 1.0)
    bands = {"robot_detection_enabled": True, "robot_detection_expire_sec": 5.0}
    mapper = SonarTo3DMapper(COARSE | bands, clock=lambda: next(ticks))
    stats = mapper.process_sonar_image(bright(), [10.0, 0, 0], HOME[1], max_range=5.0)
    assert stats["num_robots"] == 1
    (seen,) = mapper.robot_detections
    assert seen.robot.samples == 6
    assert seen.t_ns == 100 * 10**9
    assert math.dist(seen.position_m, (10.0, 0.0, -0.5)) == pytest.approx(1.5, abs=0.01)
    assert seen.position_m[1] > 0
    for _ in range(5):
        left = mapper.robot_detections
    assert left == []

    def nearest_m(config: dict[str, Any]) -> float:
        one = SonarTo3DMapper(COARSE | bands | config)
        for _ in range(3):
            one.process_sonar_image(bright(), *HOME, max_range=5.0)
        return float(np.linalg.norm(one.get_point_cloud()["points"], axis=1).min())

    assert nearest_m({}) < 2 < nearest_m({"robot_detection_keep_out": True})
    assert nearest_m({"terrain_detection_min_threshold": 150}) < 2
    nothing = SonarTo3DMapper(
        COARSE | bands | {"robot_detection_keep_out": True, "terrain_detection_min_threshold": 150}
    )
    nothing.process_sonar_image(bright(), *HOME, max_range=5.0)
    assert nothing.get_point_cloud()["num_occupied"] == 0
    nothing.reset_map()
    assert nothing.robot_detections == []


def test_settings_change_for_the_images_to_come() -> None:
    mapper = mapped()
    mapper.update_intensity(np.int64(220))
    stats = mapper.process_sonar_image(wall(), *HOME, max_range=5.0)
    assert stats["num_occupied"] == 0
    mapper.update_mounting_orientation_yaw(90)
    mapper.update_intensity(35)
    for _ in range(3):
        mapper.process_sonar_image(wall(), *HOME, max_range=5.0)
    assert mapper.get_point_cloud()["points"][:, 1].max() == pytest.approx(3.0, abs=0.3)
    before = mapper.config
    for name, value, words in (
        ("filtering.min_range", -1, "^filtering.min_range: -1 is not allowed; allowed: "),
        ("iwlo.L_occ", 2.0, "iwlo.L_occ: cannot change in a map that is there"),
        ("colour", 2.0, "colour: cannot change"),
        ("mapping.free_threshold", 0.9, "free_threshold 0.9 is above occupied_threshold"),
    ):
        with pytest.raises(ConfigError, match=words):
            mapper.update({"mapping.detail": 2.0, name: value})
        assert mapper.config == before
    mapper.update_occupied_threshold(0.3)
    assert mapper.config.mapping.free_threshold == 0.3


def test_published_example_runs() -> None:
    config = {"voxel_resolution": 0.1, "intensity_threshold": 120, "use_outofcore": False}
    mapper = SonarTo3DMapper(config)
    stats = mapper.process_sonar_image(wall(), *HOME)
    cloud = mapper.get_point_cloud()
    assert stats["num_occupied"] > 0
    assert cloud["points"].shape == (len(cloud["probabilities"]), 3)
