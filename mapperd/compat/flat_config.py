"""sonar_3d_reconstruction's flat dictionary of settings, and `SonarMapperConfig`.

Every key is one setting of `mapperd.config.tree` under its own name (those of `PREFIXED` carry
their section: `adaptive_threshold`), so that ranges and defaults stand in one place. A key without
effect takes only the value that describes the behaviour: no setting is silently ignored.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, make_dataclass
from typing import TYPE_CHECKING, Any, Protocol, Self

import msgspec
import numpy as np

from mapperd.config.catalog import rule_text
from mapperd.config.daemon import OutOfCoreConfig
from mapperd.config.tree import (
    AdaptiveConfig,
    Config,
    CrosstalkConfig,
    FilteringConfig,
    IwloConfig,
    MappingConfig,
    OctreeConfig,
    ProcessingConfig,
    RobotDetectionConfig,
    SonarConfig,
    TerrainDetectionConfig,
)
from mapperd.errors import ConfigError
from oculus_driver.command_line import hint_at_name

__all__ = ["SonarMapperConfig", "config_from_flat"]

_SECTIONS: dict[str, type[msgspec.Struct]] = {
    "sonar": SonarConfig,
    "filtering": FilteringConfig,
    "octree": OctreeConfig,
    "mapping": MappingConfig,
    "iwlo": IwloConfig,
    "adaptive": AdaptiveConfig,
    "crosstalk": CrosstalkConfig,
    "terrain_detection": TerrainDetectionConfig,
    "robot_detection": RobotDetectionConfig,
    "outofcore": OutOfCoreConfig,
    "processing": ProcessingConfig,
}

PREFIXED = ("adaptive", "terrain_detection", "robot_detection", "outofcore")

_OWN_KEYS = {
    (section, name): f"{section}_{name}"
    for section in PREFIXED
    for name in _SECTIONS[section].__struct_fields__
} | {("crosstalk", "enabled"): "crosstalk_enabled", ("outofcore", "use"): "use_outofcore"}
"""Keys that are not the field's name."""

_PLACES = {
    _OWN_KEYS.get((section, name), name): (section, name)
    for section, kind in _SECTIONS.items()
    for name in kind.__struct_fields__
}

_VECTORS = {
    "sonar_position": ("position", ("x", "y", "z")),
    "sonar_orientation": ("orientation", ("roll", "pitch", "yaw")),
}
"""Metres, and degrees."""

_ONLY = {
    "dynamic_expansion": (True, "the map always grows"),
    "use_cpp_backend": (True, "the core is in C++"),
}
"""The only accepted value, which describes the behaviour, and why there is no other."""


def config_from_flat(flat: Mapping[str, Any]) -> Config:
    """Settings from sonar_3d_reconstruction's flat keys; what is not named has its default.

    An `occupied_threshold` below 0.5 takes `free_threshold` down with it, and a low
    `adaptive_max_ratio` `adaptive_min_ratio`, unless those are named.

    Args:
        flat: keys and values, NumPy's numbers as good as Python's.

    Raises:
        ConfigError: a key that is unknown or has a value that is not allowed; its `path` is the
            key.
    """
    tree: dict[str, Any] = {}
    for key, given in flat.items():
        value = given.item() if isinstance(given, np.generic) else given
        if key in _PLACES:
            section, field = _PLACES[key]
            tree.setdefault(section, {})[field] = _finite(key, value)
        elif key in _VECTORS:
            part, names = _VECTORS[key]
            numbers = _vector(key, value)
            tree.setdefault("mounting", {})[part] = dict(zip(names, numbers, strict=True))
        else:
            _check_fixed(key, value)
    _lower(tree, "mapping", "free_threshold", "occupied_threshold")
    _lower(tree, "adaptive", "min_ratio", "max_ratio")
    try:
        return msgspec.convert(tree, Config)
    except msgspec.ValidationError as error:
        raise _explained(str(error)) from error


def _finite(key: str, value: object) -> object:
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f"{key}: {value} is not allowed; a finite number was expected", key)
    return value


def _vector(key: str, value: object) -> list[float]:
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if numbers.shape != (3,) or not np.isfinite(numbers).all():
        names = ", ".join(_VECTORS[key][1])
        raise ConfigError(f"{key}: three finite numbers were expected: {names}", key)
    return [float(number) for number in numbers]


def _check_fixed(key: str, value: object) -> None:
    """Accept a key without effect only with its neutral value."""
    if key in _ONLY:
        only, reason = _ONLY[key]
        if value is not only and not (type(value) is int and value == only):
            raise ConfigError(f"{key}: only {only} is allowed: {reason}", key)
        return
    known = [*_PLACES, *_VECTORS, *_ONLY]
    hint = hint_at_name(str(key), known, f"allowed: {', '.join(known)}")
    raise ConfigError(f"{key}: there is no such setting; {hint}", str(key))


def _lower(tree: dict[str, Any], section: str, field: str, limit: str) -> None:
    """Keep a field that is not named at most as high as the one that limits it."""
    named = tree.get(section, {})
    highest = named.get(limit)
    if type(highest) in (int, float) and field not in named:
        named[field] = min(highest, getattr(_SECTIONS[section](), field))


def _explained(message: str) -> ConfigError:
    """Turn msgspec's sentence, with its place in the tree, into one about the flat key."""
    what, _, at = message.partition(" - at `")
    path = at.rstrip("`")
    section, _, field = path.removeprefix("$.").partition(".")
    keys = {place: key for key, place in _PLACES.items()}
    for key, (part, _) in _VECTORS.items():
        if section == "mounting" and field.startswith(part):
            return ConfigError(f"{key}: {field}: {what}; allowed: {rule_text(path)}", key)
    if not section:  # settings that contradict each other
        for (part, field), key in keys.items():
            what = what.replace(f"{part}.{field}", key)
        return ConfigError(what, "")
    named = keys.get((section, field))
    if named is None:
        return ConfigError(f"{section}: {what}", section)
    return ConfigError(f"{named}: {what}; allowed: {rule_text(path)}", named)


class _Node(Protocol):
    """What has declared parameters: a `ParameterNode`, or a node of ROS 2."""

    def has_parameter(self, name: str) -> bool: ...
    def get_parameter(self, name: str) -> Any: ...  # noqa: ANN401 any setting


class _MapperConfig:
    """All settings of `SonarTo3DMapper` as attributes, under its flat keys.

    `sonar_position` is (x, y, z) in metres, `sonar_orientation` (roll, pitch, yaw) in degrees.
    """

    if TYPE_CHECKING:

        def __init__(self, **flat: Any) -> None: ...  # noqa: ANN401
        def __getattr__(self, key: str) -> Any: ...  # noqa: ANN401

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ConfigError: one is not allowed.
        """
        config_from_flat(self.to_mapper_dict())

    @classmethod
    def from_ros_params(cls, node: _Node) -> Self:
        """Read the parameters of a node; those that it has not declared have their defaults.

        Args:
            node: has the settings by their full names, such as `iwlo.sharpness`; values may be
                wrapped in an object with a `value`.

        Raises:
            ConfigError: a value that is not allowed.
        """
        places = {key: (".".join(place),) for key, place in _PLACES.items()} | {
            key: tuple(f"mounting.{part}.{name}" for name in names)
            for key, (part, names) in _VECTORS.items()
        }
        flat = {}
        for key, names in places.items():
            if all(map(node.has_parameter, names)):
                found = [node.get_parameter(name) for name in names]
                values = [getattr(one, "value", one) for one in found]
                flat[key] = tuple(values) if key in _VECTORS else values[0]
        return cls(**flat)

    def to_mapper_dict(self) -> dict[str, Any]:
        """Return the argument of `SonarTo3DMapper`: every key with its value."""
        return asdict(self)  # type: ignore[call-overload,no-any-return] # a dataclass, below


def _fields() -> list[tuple[str, type, Any]]:
    """Name, type and default of each flat key."""
    defaults = {key: getattr(getattr(Config(), a), b) for key, (a, b) in _PLACES.items()}
    for key, (part, names) in _VECTORS.items():
        vector = getattr(Config().mounting, part)
        defaults[key] = tuple(getattr(vector, name) for name in names)
    defaults |= {key: only for key, (only, _) in _ONLY.items()}
    return [(key, type(value), value) for key, value in defaults.items()]


SonarMapperConfig: type[_MapperConfig] = make_dataclass(
    "SonarMapperConfig",
    _fields(),
    bases=(_MapperConfig,),
    namespace={"__doc__": _MapperConfig.__doc__, "__module__": __name__},
)
