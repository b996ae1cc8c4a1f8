from pathlib import Path
from typing import Any, get_args, get_type_hints

import msgspec
import pytest

from mapperd.config.catalog import rule_text
from mapperd.config.layers import load_files
from mapperd.config.loader import load_config
from mapperd.config.tree import AdaptiveConfig, Config, IwloConfig, MappingConfig, OrientationConfig

ROOT = Path(__file__).resolve().parents[3]

PUBLISHED_DEFAULTS = {
    "sonar.horizontal_fov": 130.0,
    "filtering.min_range": 0.5,
    "filtering.intensity_threshold": 35.0,
    "mounting.position.x": 0.0,
    "mounting.position.y": 0.0,
    "mounting.position.z": -0.5,
    "mounting.orientation.roll": 0.0,
    "mounting.orientation.pitch": 90.0,
    "mounting.orientation.yaw": 0.0,
    "octree.voxel_resolution": 0.05,
    "mapping.occupied_threshold": 0.7,
    "mapping.angular_cone_width": 0.5,
    "iwlo.L_occ": 3.5,
    "iwlo.L_free": -3.0,
    "iwlo.L_min": -10.0,
    "iwlo.L_max": 10.0,
    "iwlo.sharpness": 3.0,
    "iwlo.decay_rate": 0.1,
    "iwlo.min_alpha": 0.1,
    "iwlo.intensity_max": 255.0,
    "adaptive.update": True,
    "adaptive.threshold": 0.5,
    "adaptive.max_ratio": 0.3,
    "processing.frame_skip": 1,
    "outofcore.use": False,
    "outofcore.tile_size": 10.0,
    "outofcore.cache_size": 16,
    "crosstalk.enabled": False,
    "crosstalk.morpho_enabled": True,
    "crosstalk.morpho_kernel_size": 5,
    "crosstalk.morpho_kernel_shape": "rect",
    "crosstalk.azimuth_enabled": True,
    "crosstalk.azimuth_threshold": 0.5,
    "terrain_detection.min_threshold": 80.0,
    "terrain_detection.max_threshold": 180.0,
    "robot_detection.enabled": False,
    "robot_detection.min_threshold": 180.0,
    "robot_detection.topic": "/sonar_robot_detections",
    "time_sync.max_stamp_diff_sec": 0.1,
}


def fields(section: Any = Config, prefix: str = "") -> dict[str, Any]:
    """Path to annotation of every single setting."""
    found: dict[str, Any] = {}
    for name, hint in get_type_hints(section, include_extras=True).items():
        if hasattr(hint, "__struct_fields__"):
            found |= fields(hint, f"{prefix}{name}.")
        else:
            found[prefix + name] = hint
    return found


def value_at(config: Config, path: str) -> Any:
    value: Any = config
    for part in path.split("."):
        value = getattr(value, part)
    return value


@pytest.mark.parametrize(("path", "default"), PUBLISHED_DEFAULTS.items())
def test_defaults_are_the_published_ones(path: str, default: Any) -> None:
    assert value_at(Config(), path) == default


@pytest.mark.parametrize(("path", "hint"), fields().items())
def test_every_field_reports_what_it_is(path: str, hint: Any) -> None:
    meta = hint.__metadata__[0]
    assert meta.description.endswith("."), path
    assert isinstance(meta.extra_json_schema["x-dynamic"], bool)
    assert isinstance(meta.extra_json_schema["x-unit"], str)
    rule = rule_text(f"$.{path}")
    assert rule
    if get_args(hint)[0] in (int, float):
        assert "<" in rule, f"{path} has no upper limit"
        assert ">" in rule, f"{path} has no lower limit"


@pytest.mark.parametrize("path", fields())
def test_every_default_keeps_its_own_rule(path: str) -> None:
    plain = msgspec.to_builtins(Config())
    assert msgspec.convert(plain, Config) == Config(), path


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ({"terrain_detection": {"min_threshold": 180}}, "min_threshold 180 is not below"),
        ({"robot_detection": {"enabled": True, "min_threshold": 179}}, "min_threshold 179 is"),
        (
            {"robot_detection": {"enabled": True, "keep_out": True}}
            | {"mapping": {"carve_no_return": True}},
            "shadows of robots",
        ),
        ({"outofcore": {"use": True, "tile_size": 0.39}}, "less than 8 voxels"),
        ({"crosstalk": {"morpho_kernel_size": 1}}, ">= 2"),
        ({"robot_detection": {"topic": "a b"}}, "regex"),
    ],
)
def test_filters_and_store_refuse_what_cannot_be(section: Any, words: str) -> None:
    with pytest.raises(msgspec.ValidationError, match=words):
        msgspec.convert(section, Config)


def test_what_is_off_needs_no_sense() -> None:
    assert msgspec.convert({"robot_detection": {"min_threshold": 10}}, Config)
    assert msgspec.convert({"outofcore": {"tile_size": 0.1}}, Config)


def test_config_cannot_be_changed() -> None:
    with pytest.raises(AttributeError):
        Config().octree.voxel_resolution = 1.0  # type: ignore[misc]


def test_free_threshold_stays_below_the_occupied_one() -> None:
    with pytest.raises(ValueError, match="free_threshold"):
        MappingConfig(free_threshold=0.8)


def test_rays_refuse_settings_they_do_not_know() -> None:
    with pytest.raises(ValueError, match="rays"):
        MappingConfig(integrator="rays", carve_no_return=True)


def test_rule_that_never_settles_is_refused() -> None:
    with pytest.raises(ValueError, match="65535"):
        IwloConfig(decay_rate=1e-5)
    assert IwloConfig(decay_rate=0.0)
    assert AdaptiveConfig(threshold=1.0)


def test_min_ratio_stays_below_max_ratio() -> None:
    assert AdaptiveConfig().min_ratio == 0.25
    assert AdaptiveConfig(min_ratio=0.3)
    with pytest.raises(ValueError, match=r"min_ratio 0\.4 .*max_ratio 0\.3"):
        AdaptiveConfig(min_ratio=0.4)
    with pytest.raises(ValueError, match="above max_ratio"):
        AdaptiveConfig(max_ratio=0.2)


@pytest.mark.parametrize("path", sorted((ROOT / "config").glob("*.yaml")), ids=lambda p: p.name)
def test_sample_files_load(path: Path) -> None:
    assert load_config(path)


def test_short_sample_names_what_most_users_need() -> None:
    text = (ROOT / "config" / "mapperd.yaml").read_text(encoding="utf-8")
    for name in ("position", "orientation", "voxel_resolution", "intensity_threshold"):
        assert name in text


@pytest.mark.parametrize("tilt", [30, 60, 90])
def test_preset_of_a_tilt_looks_that_way(tilt: int) -> None:
    config = load_config(ROOT / "config" / f"tilt_{tilt}.yaml")
    assert config.mounting.orientation == OrientationConfig(pitch=tilt)
    assert config.iwlo == IwloConfig()


def test_robots_can_be_reported_at_every_tilt() -> None:
    robots = ROOT / "config" / "robot_detection.yaml"
    for tilt in (30, 60, 90):
        config = load_files([ROOT / "config" / f"tilt_{tilt}.yaml", robots]).config
        assert config.robot_detection.keep_out
        assert config.mounting.orientation.pitch == tilt
        assert config.filtering.intensity_threshold < config.terrain_detection.min_threshold


def test_owners_of_the_bluerov2_are_its_sources() -> None:
    odometry = load_config(ROOT / "config" / "bluerov2.yaml").odometry
    names = {source.name for source in odometry.sources}
    assert {odometry.owners.attitude, odometry.owners.depth, odometry.owners.velocity} == names
