import math
from typing import Any

import numpy as np
import pytest

from mapperd.compat.flat_config import config_from_flat
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
        ({"frame_skip": 5}, "frame_skip: only 1"),
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


def test_crosstalk_has_its_keys() -> None:
    flat = {"crosstalk_enabled": True, "morpho_kernel_size": 7, "azimuth_threshold": 0.6}
    crosstalk = config_from_flat(flat).crosstalk
    assert crosstalk.enabled
    assert (crosstalk.morpho_kernel_size, crosstalk.azimuth_threshold) == (7, 0.6)
