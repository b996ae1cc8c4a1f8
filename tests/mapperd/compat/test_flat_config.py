import math
import pickle
from typing import Any

import numpy as np
import pytest

from mapperd import SonarMapperConfig, SonarTo3DMapper
from mapperd.compat.flat_config import config_from_flat
from mapperd.compat.parameters import (
    CROSSTALK_PARAMS,
    MAPPER_PARAMS,
    ParameterManager,
    ParameterNode,
)
from mapperd.config.layers import Layered
from mapperd.config.live import ConfigStore
from mapperd.config.tree import Config
from mapperd.errors import ConfigError

PUBLISHED: dict[str, Any] = {
    "horizontal_fov": 130.0,
    "vertical_aperture": 20.0,
    "min_range": 0.5,
    "intensity_threshold": 35,
    "sonar_position": [0.0, 0.0, -0.5],
    "sonar_orientation": [0.0, 90.0, 0.0],
    "voxel_resolution": 0.05,
    "occupied_threshold": 0.7,
    "angular_cone_width": 0.5,
    "dynamic_expansion": True,
    "use_cpp_backend": True,
    "L_occ": 3.5,
    "L_free": -3.0,
    "L_min": -10.0,
    "L_max": 10.0,
    "sharpness": 3.0,
    "decay_rate": 0.1,
    "min_alpha": 0.1,
    "intensity_max": 255,
    "adaptive_update": True,
    "adaptive_threshold": 0.5,
    "adaptive_max_ratio": 0.3,
    "use_outofcore": False,
    "outofcore_map_path": "/workspace/data/map_tiles",
    "outofcore_tile_size": 10.0,
    "outofcore_cache_size": 16,
    "crosstalk_enabled": False,
    "morpho_enabled": True,
    "morpho_kernel_size": 5,
    "morpho_kernel_shape": "rect",
    "azimuth_enabled": True,
    "azimuth_threshold": 0.5,
    "frame_skip": 1,
}


def test_the_published_defaults_are_ours_but_for_the_aperture() -> None:
    ours = config_from_flat(PUBLISHED | {"vertical_aperture": 14.0, "outofcore_map_path": ""})
    assert ours == config_from_flat({}) == Config()
    assert config_from_flat(PUBLISHED).sonar.vertical_aperture == 20.0


def test_keys_reach_their_settings() -> None:
    config = config_from_flat(
        {
            "voxel_resolution": np.float32(0.25),
            "intensity_threshold": np.int64(120),
            "sonar_position": np.array([1.0, 2.0, 3.0]),
            "sonar_orientation": (10, 20, 30),
            "adaptive_update": np.array([False])[0],
            "adaptive_protect_occupied": False,
            "aggregation": "mean",
        }
    )
    assert config.octree.voxel_resolution == 0.25
    assert config.filtering.intensity_threshold == 120
    assert (config.mounting.position.x, config.mounting.position.z) == (1, 3)
    assert (config.mounting.orientation.roll, config.mounting.orientation.yaw) == (10, 30)
    assert not config.adaptive.update
    assert not config.adaptive.protect_occupied
    assert config.mapping.aggregation == "mean"


def test_low_occupied_threshold_takes_the_free_one_along() -> None:
    assert config_from_flat({"occupied_threshold": 0.4}).mapping.free_threshold == 0.4
    with pytest.raises(ConfigError, match="free_threshold"):
        config_from_flat({"occupied_threshold": 0.4, "free_threshold": 0.5})


def test_low_max_ratio_takes_the_min_ratio_along() -> None:
    assert config_from_flat({"adaptive_max_ratio": 0.1}).adaptive.min_ratio == 0.1
    assert config_from_flat({"adaptive_max_ratio": 0}).adaptive.min_ratio == 0
    assert config_from_flat({"adaptive_max_ratio": 0.9}).adaptive.min_ratio == 0.25
    assert config_from_flat({"adaptive_min_ratio": 0.0}).adaptive.min_ratio == 0
    with pytest.raises(ConfigError, match="min_ratio"):
        config_from_flat({"adaptive_max_ratio": 0.1, "adaptive_min_ratio": 0.2})


@pytest.mark.parametrize(
    ("flat", "message"),
    [
        ({"voxel_resolutoin": 0.1}, "did you mean voxel_resolution"),
        ({"colour": 1}, "no such setting; allowed: "),
        ({"voxel_resolution": -1.0}, r"voxel_resolution: .*allowed: a number >= 0\.001"),
        ({"voxel_resolution": "big"}, "voxel_resolution: .*allowed: a number"),
        ({"voxel_resolution": True}, "voxel_resolution: .*allowed: a number"),
        ({"L_occ": math.nan}, "L_occ: nan is not allowed"),
        ({"L_free": math.inf}, "L_free: inf is not allowed"),
        ({"adaptive_threshold": 2.0}, "adaptive_threshold: .*<= 1"),
        ({"adaptive_max_ratio": -1}, "adaptive_max_ratio: .*>= 0"),
        ({"adaptive_min_ratio": 0.5}, "adaptive: min_ratio 0.5 is above max_ratio 0.3"),
        ({"decay_rate": 1e-9}, "iwlo: .*settle"),
        ({"sonar_position": [0, 0]}, "sonar_position: three finite numbers"),
        ({"sonar_position": [0, 0, math.nan]}, "sonar_position: three finite numbers"),
        ({"sonar_position": [0, 0, 1e9]}, "sonar_position: position.z: .*<= 100"),
        ({"sonar_orientation": "down"}, "sonar_orientation: three finite numbers"),
        ({"use_outofcore": 1}, "use_outofcore: .*true or false"),
        ({"crosstalk_enabled": 0.0}, "crosstalk_enabled: .*true or false"),
        ({"morpho_kernel_size": 1}, "morpho_kernel_size: .*>= 2"),
        ({"morpho_kernel_shape": "star"}, "morpho_kernel_shape: .*rect or ellipse or cross"),
        ({"use_cpp_backend": False}, "use_cpp_backend: only True is allowed"),
        ({"dynamic_expansion": False}, "dynamic_expansion: only True is allowed"),
        ({"frame_skip": 0}, "frame_skip: .*>= 1"),
        (
            {"robot_detection_enabled": True, "robot_detection_min_threshold": 90},
            "robot_detection_",
        ),
        ({"outofcore_cache_size": 0}, "outofcore_cache_size: .*>= 1"),
        ({"outofcore_tile_size": 0.1, "use_outofcore": True}, "^outofcore_tile_size 0.1 is less"),
    ],
)
def test_wrong_keys_and_values_are_named(flat: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        config_from_flat(flat)
    assert "\n" not in str(caught.value)


def test_what_is_off_may_be_reported() -> None:
    assert config_from_flat({"use_outofcore": False, "frame_skip": np.int32(1)}) == Config()


def test_robots_terrain_and_frame_skip_have_their_keys() -> None:
    flat = {
        "robot_detection_enabled": True,
        "robot_detection_min_threshold": 200,
        "robot_detection_keep_out": True,
        "terrain_detection_min_threshold": 60,
        "terrain_detection_max_threshold": 190,
        "frame_skip": 3,
    }
    config = config_from_flat(flat)
    assert config.robot_detection.enabled
    assert config.robot_detection.keep_out
    assert config.robot_detection.min_threshold == 200
    terrain = config.terrain_detection
    assert (terrain.min_threshold, terrain.max_threshold) == (60, 190)
    assert config.processing.frame_skip == 3


def test_crosstalk_has_its_keys() -> None:
    flat = {"crosstalk_enabled": True, "morpho_kernel_size": 7, "azimuth_threshold": 0.6}
    crosstalk = config_from_flat(flat).crosstalk
    assert crosstalk.enabled
    assert (crosstalk.morpho_kernel_size, crosstalk.azimuth_threshold) == (7, 0.6)


class RosNode:
    """A node of ROS 2, whose values are wrapped."""

    class Parameter:
        def __init__(self, value: object) -> None:
            self.value = value

    def __init__(self, values: dict[str, object]) -> None:
        self.values = values

    def has_parameter(self, name: str) -> bool:
        return name in self.values

    def get_parameter(self, name: str) -> Parameter:
        return self.Parameter(self.values[name])


def test_mapper_configuration_has_every_published_key_and_its_default() -> None:
    defaults = SonarMapperConfig().to_mapper_dict()
    assert set(PUBLISHED) <= set(defaults)
    assert config_from_flat(defaults) == Config()
    assert SonarMapperConfig(L_occ=2.0).L_occ == 2.0
    with pytest.raises(ConfigError, match=r"min_range: .*>= 0"):
        SonarMapperConfig(min_range=-1)
    assert pickle.loads(pickle.dumps(SonarMapperConfig(L_occ=2.0))) == SonarMapperConfig(L_occ=2.0)  # noqa: S301 our own
    with pytest.raises(TypeError, match="colour"):
        SonarMapperConfig(colour=1)


def test_mapper_is_configured_from_the_parameters_of_a_node() -> None:
    store = ConfigStore(Layered(config_from_flat({"voxel_resolution": 0.2, "L_occ": 2.0})))
    node = ParameterNode(store)
    ParameterManager.declare_all(node, (*MAPPER_PARAMS, *CROSSTALK_PARAMS))
    mapper = SonarTo3DMapper(SonarMapperConfig.from_ros_params(node).to_mapper_dict())
    assert mapper.config == store.current
    ros = RosNode(
        {
            "mounting.orientation.roll": 1.0,
            "mounting.orientation.pitch": 30.0,
            "mounting.orientation.yaw": 0.0,
            "mounting.position.x": 1.0,
            "outofcore.use": False,
            "iwlo.sharpness": 2.0,
        }
    )
    config = SonarMapperConfig.from_ros_params(ros)
    assert config.sonar_orientation == (1.0, 30.0, 0.0)
    assert config.sonar_position == (0.0, 0.0, -0.5)  # not all of it is declared
    assert (config.sharpness, config.use_outofcore) == (2.0, False)
