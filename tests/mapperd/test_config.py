from pathlib import Path
from typing import Any, get_args, get_type_hints

import msgspec
import pytest

from mapperd.config import Adaptive, Config, Iwlo, Mapping
from mapperd.config_file import load_config, rule_text

ROOT = Path(__file__).resolve().parents[2]

SEED_DEFAULTS = {
    "sonar.horizontal_fov": 130.0,
    "sonar.vertical_aperture": 20.0,
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


@pytest.mark.parametrize(("path", "default"), SEED_DEFAULTS.items())
def test_defaults_are_the_seed_documents(path: str, default: Any) -> None:
    assert value_at(Config(), path) == default


@pytest.mark.parametrize(("path", "hint"), fields().items())
def test_every_field_says_what_it_is(path: str, hint: Any) -> None:
    meta = hint.__metadata__[0]
    assert meta.description.endswith("."), path
    assert isinstance(meta.extra["dynamic"], bool)
    assert isinstance(meta.extra["unit"], str)
    rule = rule_text(f"$.{path}")
    assert rule
    if get_args(hint)[0] in (int, float):
        assert "<" in rule, f"{path} has no upper limit"
        assert ">" in rule, f"{path} has no lower limit"


@pytest.mark.parametrize("path", fields())
def test_every_default_keeps_its_own_rule(path: str) -> None:
    plain = msgspec.to_builtins(Config())
    assert msgspec.convert(plain, Config) == Config(), path


def test_config_cannot_be_changed() -> None:
    with pytest.raises(AttributeError):
        Config().octree.voxel_resolution = 1.0  # type: ignore[misc]


def test_free_threshold_stays_below_the_occupied_one() -> None:
    with pytest.raises(ValueError, match="free_threshold"):
        Mapping(free_threshold=0.8)


def test_rays_refuse_settings_they_do_not_know() -> None:
    with pytest.raises(ValueError, match="rays"):
        Mapping(integrator="rays", carve_no_return=True)


def test_rule_that_never_settles_is_refused() -> None:
    with pytest.raises(ValueError, match="65535"):
        Iwlo(decay_rate=1e-5)
    assert Iwlo(decay_rate=0.0)
    assert Adaptive(threshold=1.0)


def test_min_ratio_stays_below_max_ratio() -> None:
    assert Adaptive().min_ratio == 0.25
    assert Adaptive(min_ratio=0.3)
    with pytest.raises(ValueError, match=r"min_ratio 0\.4 is above max_ratio 0\.3"):
        Adaptive(min_ratio=0.4)
    with pytest.raises(ValueError, match="above max_ratio"):
        Adaptive(max_ratio=0.2)


@pytest.mark.parametrize("path", sorted((ROOT / "config").glob("*.yaml")), ids=lambda p: p.name)
def test_sample_files_load(path: Path) -> None:
    assert load_config(path)


def test_short_sample_names_what_most_users_need() -> None:
    text = (ROOT / "config" / "mapperd.yaml").read_text(encoding="utf-8")
    for name in ("position", "orientation", "voxel_resolution", "intensity_threshold"):
        assert name in text
